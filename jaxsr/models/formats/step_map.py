"""Step functions ``file.py:step``: discrete maps ``step(x, u, p) -> x_next`` of any library.

Where the map is Euler's method, plain or with new rates first, along a law that is a formula, that
law stands for it, and how far the steps are from it is said. Else the map is taken for the flow of
a vector field (`native.worker.rates_of_steps`), which passes through its steps.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxsr._result import InputError
from jaxsr.expressions import evaluate
from jaxsr.models.formats.fmu import Unit, step_check
from jaxsr.models.model import FREE, Model
from jaxsr.models.native.field import native_field
from jaxsr.models.native.process import Native
from jaxsr.models.reading import read_model
from jaxsr.models.simulation import start_on, time_column
from jaxsr.models.simulator import Simulator
from jaxsr.recordings import Recording, read_recording

BACKEND = Path(__file__).parents[1] / "native" / "backends" / "python_steps.py"


def arguments_of(text: str) -> int | None:
    """Return how many arguments a function ``file.py:name`` takes, without running the file.

    None where the file does not define it in so many words.
    """
    path, _, name = text.rpartition(":")
    try:
        tree = ast.parse(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, SyntaxError):
        return None
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and node.name == name:
            own = node.args
            return None if own.vararg else len(own.posonlyargs) + len(own.args)
    return None


def is_step(text: str) -> bool:
    """Return whether ``file.py:name`` is a step function: of two or three arguments, not four.

    One that the file does not define in so many words is one if it is called ``step``.
    """
    if ".py:" not in text:
        return False
    count = arguments_of(text)
    return count in (2, 3) if count is not None else text.endswith(":step")


def read_steps(
    text: str,
    table: str | Path | None = None,
    recordings: Sequence[str | Path | Recording] = (),
) -> Unit:
    """Load a step function in a process of its own, with its table.

    Parameters
    ----------
    text : str
        ``path/file.py:step``.
    table : path, optional
        Model file that stands on it, ``path/file.toml`` by default. ``sample_time`` under [model]
        is the length of a step in s; without it a step is a sample of the recordings.
    recordings : sequence of path or Recording
        Those to learn from.

    Raises
    ------
    InputError
        The file, its table or the function is missing, or the function cannot be run.
    """
    path_text, _, name = text.rpartition(":")
    path = Path(path_text)
    if not path.is_file():
        raise InputError("no such Python file", str(path), "Check the path")
    table = path.with_suffix(".toml") if table is None else Path(table)
    if not table.is_file():
        remedy = f'Write it: [model] base = "{path.name}:{name}", states, inputs, outputs'
        raise InputError("no table of states and parameters", str(table), remedy)
    model = read_model(table)
    if model.base != f"{path.name}:{name}":
        raise InputError(
            f"base is {model.base!r}", f"{table} [model]", f'Write base = "{path.name}:{name}"'
        )
    opened = [
        r
        if isinstance(r, Recording)
        else read_recording(r, time=model.columns.get(model.time), sample_time=model.sample_time)
        for r in recordings
    ]
    states = [s for s in model.states if s not in model.equations]
    count = arguments_of(text) or 3
    options = {
        "function": name,
        "arguments": count,
        "step": _step(model, opened, table),
        "states": states,
        "inputs": list(model.inputs),
        "parameters": list(model.parameters),
        "start": [
            *(_number(model.initial.get(s, FREE)) for s in states),
            *(0.0 for _ in model.inputs),
            *(p.value for p in model.parameters.values()),
        ],
    }
    native = Native(BACKEND, path, options)
    variables = {n: n for n in (*states, *model.inputs, *model.parameters)}
    field, apart = native_field(model, native, variables, opened, float(options["step"]))
    made = Simulator(replace(model, vector_field=field))
    step = float(options["step"])
    checks = step_check(path.name, step, apart)
    return Unit(path, made, native, variables, checks, step=step, arguments=count)


def steps_to_csv(unit: Unit, recording: Recording) -> pd.DataFrame | None:
    """Return the table that ``jaxsr simulate`` writes, by the simulator's own steps.

    None where a sidecar adds to them, or samples lie between steps: then the flow is run.

    Raises
    ------
    InputError
        The run diverges.
    """
    model = unit.simulator.model
    if not unit.step or model.additions or model.equations or model.delays or model.clock:
        return None
    counts = np.diff(recording.time) / unit.step
    if np.abs(counts - np.round(counts)).max() > 0.01 or counts.min() < 0.5:
        return None
    item, start = start_on(unit.simulator, recording)
    values = [p.value for n, p in model.parameters.items() if n in unit.variables]
    rows = np.column_stack(
        [
            item.time,
            np.tile(start, (item.time.size, 1)),
            item.inputs,
            np.tile(values, (item.time.size, 1)),
        ]
    )
    states = unit.native.run(rows)
    if not np.isfinite(states).all():
        at = item.time[int(np.argmax(~np.isfinite(states).all(axis=1)))]
        raise InputError(f"its run diverges at {at:.4g} s", unit.path.name, "Run a shorter time")
    env = {model.time: item.time, **{n: p.value for n, p in model.parameters.items()}}
    env |= dict(zip(model.states, states.T, strict=True))
    env |= dict(zip(model.inputs, item.inputs.T, strict=True))
    table = time_column(model, item.time)
    table |= {model.column(u): item.inputs[:, k] for k, u in enumerate(model.inputs)}
    for y in model.outputs:
        found = evaluate(model.reading_terms[y], env)
        table[model.column(y)] = np.broadcast_to(found, item.time.shape)
    for k, state in enumerate(model.states):
        table.setdefault(state, states[:, k])
    return pd.DataFrame(table)


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else 0.0


def _step(model: Model, opened: Sequence[Recording], table: Path) -> float:
    if model.sample_time is not None:
        return model.sample_time
    if not opened:
        remedy = "Write sample_time under [model], the length of a step in s"
        raise InputError("does not say how long a step is", str(table), remedy)
    gaps = np.diff(opened[0].time)
    step = float(np.median(gaps))
    if np.abs(gaps - step).max() > 0.01 * step * max(1, round(float(gaps.max()) / step)):
        remedy = "Write sample_time under [model], the length of a step in s"
        raise InputError("samples are uneven, so that none is a step", opened[0].name, remedy)
    return step
