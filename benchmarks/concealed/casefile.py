"""What a case gives away: a model file, recordings and the command's arguments, in opaque names."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.concealed.control import Gains
from benchmarks.concealed.excitation import Design
from benchmarks.concealed.recording import Recorded
from benchmarks.concealed.sensing import Sensor
from benchmarks.concealed.systems import System
from benchmarks.concealed.units import Units

DECOYS = 50
FINE = 0.1
"""Resolution of a sensor whose steps do not show, in its noise."""
LAW = "u = u0 + kp*e + ki*integral(e) + kd*filtered(de/dt), e = reference - output"


@dataclass(frozen=True, eq=False)
class Disguise:
    """Opaque names, units and scales of a case.

    Attributes
    ----------
    names : mapping
        From q1, v1, u1, y1, t and the constants' names.
    units : Units
    scales : tuple of float
        Column value of every input per its value in SI.
    told : bool
        Whether the model file states units.
    """

    names: Mapping[str, str]
    units: Units
    scales: tuple[float, ...]
    told: bool

    @staticmethod
    def draw(rng: np.random.Generator, system: System, sensors: int) -> Disguise:
        """Draw names, units, and scales and signs of the inputs."""
        n = system.size
        roles = ["time", *(f"q{i + 1}" for i in range(n))]
        roles += [f"v{i + 1}" for i in range(n)] if system.order == 2 else []
        roles += [d.name for d in system.drives] + [f"y{i + 1}" for i in range(sensors)]
        numbers = rng.permutation(np.arange(1, 100))
        names = {role: f"x{k}" for role, k in zip(roles, numbers, strict=False)}
        more = rng.permutation(np.arange(1, 100))
        names |= {c: f"p{k}" for c, k in zip(system.constants, more, strict=False)}
        scales = tuple(
            float(f"{rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.05), np.log(50))):.3g}")
            for _ in system.drives
        )
        return Disguise(names, Units.draw(rng), scales, bool(rng.uniform() < 0.5))

    def text(self, expression: str, system: System) -> str:
        """Return an expression of the system in the case's names."""
        factors = {
            d.name: f"({self.units.number(1.0 / s, d.dims)!r}*{self.names[d.name]})"
            for d, s in zip(system.drives, self.scales, strict=True)
        }

        def rename(match: re.Match[str]) -> str:
            word = match.group(0)
            return factors.get(word) or self.names.get(word, word)

        return re.sub(r"[A-Za-z_]\w*", rename, expression)


def model_text(
    system: System,
    disguise: Disguise,
    sensors: Sequence[Sensor],
    given: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]],
    hold: str,
    title: str,
) -> str:
    """Return the model file: the simulator as it is given, without the effect."""
    names, units, n = disguise.names, disguise.units, system.size
    q = [names[f"q{i + 1}"] for i in range(n)]
    v = [names[f"v{i + 1}"] for i in range(n)] if system.order == 2 else []
    inputs = [names[d.name] for d in system.drives]
    outputs = [names[f"y{i + 1}"] for i in range(len(sensors))]
    driven = v or q
    lines = ["[model]", f'name = "{title}"', f"states = {json.dumps(q + v)}"]
    lines += [f"inputs = {json.dumps(inputs)}", f"outputs = {json.dumps(outputs)}"]
    lines += [f'input_hold = "{hold}"', "", "[equations]"]
    lines += [f'{a} = "{b}"' for a, b in zip(q, v, strict=False)]
    lines += [
        f'{s} = "{disguise.text(f, system)}"' for s, f in zip(driven, system.forces, strict=True)
    ]
    lines += ["", "[inertia]"]
    for i, row in system.inertia.items():
        entries = ", ".join(f'{driven[j]} = "{disguise.text(e, system)}"' for j, e in row.items())
        lines.append(f"{driven[i]} = {{ {entries} }}")
    lines += ["", "[readings]"]
    for name, sensor in zip(outputs, sensors, strict=True):
        state = (v if sensor.rate else q)[sensor.coordinate]
        # column = gain * SI value, and the state is a number in the case's units
        lines.append(f'{name} = "{sensor.gain / units.number(1.0, sensor.dims)!r}*{state}"')
    lines += ["", "[resolution]"]  # as data sheets state it: a planted step is another one
    for name, sensor in zip(outputs, sensors, strict=True):
        if step := abs(sensor.gain) * (sensor.step or FINE * sensor.sigma):
            lines.append(f"{name} = {step:.6g}")
    lines += ["", "[parameters]"]
    for c, constant in system.constants.items():
        unit = f', unit = "{units.text(constant.dims)}"' if disguise.told else ""
        value = units.number(given[c], constant.dims)
        entry = f"value = {value!r}{unit}"
        if c in bounds:
            low, high = (units.number(b, constant.dims) for b in bounds[c])
            entry += f", bounds = [{low!r}, {high!r}]"
        lines.append(f"{names[c]} = {{ {entry} }}")
    if disguise.told:
        lines += ["", "[units]"]
        for i in range(n):
            lines.append(f'{q[i]} = "{units.text(system.coordinates[i])}"')
            if v:
                lines.append(f'{v[i]} = "{units.text(system.rate_dims(i))}"')
    lines += ["", "[columns]", f't = "{names["time"]}"', ""]
    return "\n".join(lines)


def table(
    recorded: Recorded,
    experiment: int,
    system: System,
    disguise: Disguise,
    sensors: Sequence[Sensor],
    design: Design,
    gains: Sequence[Gains],
) -> pd.DataFrame:
    """Return a recording: time, inputs, readings and, where a loop was closed, references."""
    names = disguise.names
    columns: dict[str, Any] = {names["time"]: design.dt * np.arange(design.samples)}
    for i, (drive, scale) in enumerate(zip(system.drives, disguise.scales, strict=True)):
        columns[names[drive.name]] = recorded.u[i, :, experiment] * scale
    for i, sensor in enumerate(sensors):
        columns[names[f"y{i + 1}"]] = recorded.y[i, :, experiment] * sensor.gain
    for i, g in enumerate(gains):
        sensor = _sensor_of(sensors, g.coordinate)
        columns[reference_name(i)] = design.signal[i, :, experiment] * sensor.gain
    return pd.DataFrame(columns)


def reference_name(loop: int) -> str:
    """Column of a loop's reference."""
    return f"r{loop + 1}"


def _sensor_of(sensors: Sequence[Sensor], coordinate: int) -> Sensor:
    return next(s for s in sensors if s.coordinate == coordinate and not s.rate)


def controller_notes(
    gains: Sequence[Gains], disguise: Disguise, sensors: Sequence[Sensor], system: System
) -> list[dict[str, Any]]:
    """Return what an engineer knows of the controllers, in the columns' scales."""
    notes = []
    for i, g in enumerate(gains):
        number = next(
            k for k, s in enumerate(sensors) if s.coordinate == g.coordinate and not s.rate
        )
        ratio = disguise.scales[g.drive] / sensors[number].gain
        notes.append(
            {
                "input": disguise.names[system.drives[g.drive].name],
                "output": disguise.names[f"y{number + 1}"],
                "reference": reference_name(i),
                "law": LAW,
                "u0": g.u0 * disguise.scales[g.drive],
                **{name: getattr(g, name) * ratio for name in ("kp", "ki", "kd")},
                "filter_time": g.tau,
            }
        )
    return notes


def decoys(rng: np.random.Generator, system: System, disguise: Disguise) -> list[dict[str, str]]:
    """Draw candidate terms that have nothing to do with the plant."""
    names, n = disguise.names, system.size
    states = [names[f"{x}{i + 1}"] for x in ("q", "v")[: system.order] for i in range(n)]
    rows = [names[f"{'v' if system.order == 2 else 'q'}{i + 1}"] for i in range(n)]
    forms = (
        "sin({k}*{a})",
        "cos({k}*{a})*{b}",
        "{a}*{b}",
        "{a}**3*{b}",
        "exp(-Abs({a})/{k})",
        "tanh({k}*{a})*{b}**2",
        "Abs({a})*{b}",
        "{a}**4",
        "sin({k}*t)*{a}",
        "{a}/(1 + {k}*{b}**2)",
    )
    out = []
    for i in range(DECOYS):
        a, b = rng.choice(states, 2)
        form = forms[i % len(forms)]
        term = form.format(a=a, b=b, k=f"{rng.uniform(0.3, 8.0):.3g}")
        out.append({"name": f"decoy_{i + 1}", "site": f"equation:{rng.choice(rows)}", "term": term})
    return out


@dataclass(frozen=True)
class Arguments:
    """Arguments of ``jaxsr diagnose`` for a case (``case.json``)."""

    case: str
    model: str
    data: tuple[str, ...]
    held_out: tuple[str, ...]
    seed: int
    candidates: str | None
    controllers: tuple[dict[str, Any], ...]

    def write(self, folder: Path) -> None:
        """Write ``case.json``."""
        (folder / "case.json").write_text(json.dumps(asdict(self), indent=1) + "\n")


def truth_values(
    effect: Any, disguise: Disguise, system: System, sensors: Sequence[Sensor]
) -> dict[str, float]:
    """Return an effect's constants as the case's model file would have them."""
    out = {}
    for name, value in effect.values.items():
        number = disguise.units.number(value, effect.dimension(name))
        if effect.kind == "input" and effect.dimension(name) == system.drives[effect.index].dims:
            if name not in ("tau", "g"):
                number = abs(value * disguise.scales[effect.index])
        elif effect.kind == "output" and name in ("y0", "ymax", "step"):
            number = value * sensors[effect.index].gain
            number = number if name == "y0" else abs(number)
        out[name] = float(number)
    return out


def site_of(effect: Any, disguise: Disguise, system: System, row: int | None = None) -> str:
    """Return an effect's site as docs/files.md writes it."""
    names = disguise.names
    index = effect.index if row is None else row
    state = f"{'v' if system.order == 2 else 'q'}{index + 1}"
    if effect.kind == "input":
        return f"input:{names[system.drives[index].name]}"
    if effect.kind == "output":
        return f"output:{names[f'y{index + 1}']}"
    if effect.kind == "parameter":
        return f"parameter:{names[effect.replaces]}"
    return f"{effect.kind}:{names[state]}"


__all__ = [
    "Arguments",
    "Disguise",
    "controller_notes",
    "decoys",
    "model_text",
    "site_of",
    "table",
    "truth_values",
]
