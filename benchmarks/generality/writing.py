"""The files of a case."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd

from benchmarks.generality.plant import LEAD
from benchmarks.generality.planting import LEARNING, Case, free_constants
from benchmarks.generality.system import Array
from jaxsr._files import atomic_write_text, dump_json

ROOM = 3.0
"""Bounds of a free parameter: its true value divided and multiplied by about this."""


def written(case: Case, folder: Path, seed: int) -> None:
    """Write ``model.toml``, the recordings and ``case.json`` of a case."""
    ticket, ground = case.ticket, case.ground
    rng = ticket.rng(seed + 1)
    outputs = [f"y{k + 1}" for k in range(len(ground.gauges))]
    texts = {y: g.expression for y, g in zip(outputs, ground.gauges, strict=True)}
    bounds = {}
    for name in free_constants(ground.system):
        reach = ROOM * rng.uniform(0.8, 1.3)
        value = ground.constants[name]
        bounds[name] = float(f"{value / reach:.2g}"), float(f"{value * reach:.2g}")
    text = ground.system.model_text(case.given, bounds, texts)
    steps = {y: c.step for y, c in zip(outputs, ground.channels, strict=True) if c.step}
    if steps and rng.uniform() < 0.5:  # the data sheet is at hand
        text += "\n[resolution]\n" + "".join(f"{y} = {step!r}\n" for y, step in steps.items())
    atomic_write_text(folder / "model.toml", text)
    names: list[str] = []
    for number, (signal, (_, y)) in enumerate(zip(ground.signals, case.moved, strict=True)):
        noise = ticket.rng(seed + 2 + number)
        columns: dict[str, Array] = {"t": signal.time[LEAD:]}
        for u, row in zip(ground.system.drives, signal.values, strict=True):
            columns[u] = row[LEAD:]
        for name, channel, row in zip(outputs, ground.channels, y, strict=True):
            columns[name] = channel.read(noise, row)
        held = number >= LEARNING
        names.append(f"{'held' if held else 'run'}{number + 1}.csv")
        table = pd.DataFrame(columns)
        atomic_write_text(folder / names[-1], table.to_csv(index=False, float_format="%.10g"))
    arguments = {
        "case": ticket.name,
        "model": "model.toml",
        "data": names[:LEARNING],
        "held_out": names[LEARNING:],
        "seed": 0,
    }
    atomic_write_text(folder / "case.json", json.dumps(arguments, indent=1) + "\n")
    atomic_write_text(folder / "truth.json", dump_json(case.truth))
