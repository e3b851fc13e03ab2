"""Functional Mock-up Units: what their description says, as the tables of a model.

The states, inputs and parameters of an FMU have its own names, as far as they are symbols; the
model stands on the FMU (``[model] base = "plant.fmu"``) and its sidecar says the rest.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from jaxsr._files import atomic_write_text
from jaxsr._result import InputError
from jaxsr.expressions.unit_text import factors_of
from jaxsr.models.formats.asked_columns import Quantity, matched
from jaxsr.models.formats.columns import POSITION, RATE, SENSOR
from jaxsr.models.formats.names import symbols_for
from jaxsr.models.formats.sidecar import HOLDS
from jaxsr.models.model import Model
from jaxsr.models.native.field import native_field
from jaxsr.models.native.process import Native
from jaxsr.models.reading import build_model, read_model
from jaxsr.models.simulator import Simulator
from jaxsr.models.writing import model_text
from jaxsr.recordings import Recording, read_recording

BACKEND = Path(__file__).parents[1] / "native" / "backends" / "fmi.py"
NEAR = 10.0
"""Factor by which a parameter may differ from its value, where the FMU states no range."""
MOST_FREE = 12
"""Parameters that are free in a draft; more of them cannot be told apart by a few recordings."""
DRAFT = """\
# Drafted by jaxsr: how recordings go with {base}, and what a diagnosis may re-calibrate.
# [readings]    output = expression of states, inputs and time
# [parameters]  those with bounds are free inside them; of {base} there are also
#               {others}
# [columns]     output or input = column of a recording
# Assumed, change it where it is wrong: between two samples an input {hold}.
# (input_hold "zero" as steps hold it, "linear" for a force that a sensor measures.)
"""


@dataclass(frozen=True, eq=False)
class Unit:
    """An FMU or a step function, read into a model.

    Attributes
    ----------
    path : Path
    simulator : Simulator
    native : Native
    variables : mapping
        Symbol of a state, an input or a parameter to the FMU's own name.
    checks : list of dict
        What was assumed, in the form of ``data_checks``.
    drafted : str
        Text of the sidecar that was drafted, empty where there was one.
    step : float
        Of a simulator that takes steps, in s; 0 where it has rates.
    arguments : int
        Of a step function; 0 for an FMU.
    """

    path: Path
    simulator: Simulator
    native: Native
    variables: Mapping[str, str]
    checks: list[dict[str, Any]] = field(default_factory=list)
    drafted: str = ""
    step: float = 0.0
    arguments: int = 0

    @property
    def step_function(self) -> bool:
        """Whether it is a Python step function."""
        return self.arguments > 0


def read_fmu(
    path: str | Path,
    sidecar: str | Path | None = None,
    recordings: Sequence[str | Path | Recording] = (),
) -> Unit:
    """Open an FMU in a process of its own, and read it with its sidecar.

    Parameters
    ----------
    path : path
        ``plant.fmu``, FMI 2 or 3.
    sidecar : path, optional
        ``plant.toml`` beside it by default; without one it is drafted from the recordings.
    recordings : sequence of path or Recording
        Those to learn from.

    Raises
    ------
    InputError
        The FMU or its sidecar cannot be read or run, or recordings do not go with it.
    """
    path = Path(path)
    table = Path(sidecar) if sidecar is not None else path.with_suffix(".toml")
    if sidecar is not None and not table.is_file():
        raise InputError("no such file", str(table), "Check the path of the sidecar")
    given = read_model(table) if table.is_file() else None
    if given is not None and given.base != path.name:
        raise InputError(
            f"[model] base is not {path.name}", table.name, f'Write base = "{path.name}"'
        )
    opened = _opened(recordings, given)
    native = Native(BACKEND, path, {"step": _step(given, opened)})
    told = Described.of(native.about)
    checks: list[dict[str, Any]] = []
    drafted = ""
    if given is None:
        if not opened:
            raise InputError(
                "no sidecar, and no recordings to draft it from", str(table), "Write it"
            )
        given, unknown = _drafted(path, told, opened[0], bool(native.about.get("step")))
        others = ", ".join(p for p in told.parameters if p not in given.parameters) or "no others"
        hold = HOLDS[given.input_hold]
        drafted = DRAFT.format(base=path.name, others=others, hold=hold) + "\n" + model_text(given)
        checks += _assumed(table, given, opened[0], unknown)
    _check(given, told, path)
    step = float(native.about.get("step") or 0.0)
    asked, apart = native_field(given, native, told.variables(given), opened, step)
    checks += step_check(path.name, step, apart)
    model = replace(given, vector_field=asked)
    return Unit(path, Simulator(model), native, told.variables(given), checks, drafted, step)


@dataclass(frozen=True)
class Described:
    """What an FMU has, by symbol.

    Attributes
    ----------
    states, inputs, outputs, parameters : dict
        Symbol to the entry of the description.
    rates : dict
        State to the state whose derivative it is, as the description says.
    name : str
    """

    states: dict[str, dict[str, Any]]
    inputs: dict[str, dict[str, Any]]
    outputs: dict[str, dict[str, Any]]
    parameters: dict[str, dict[str, Any]]
    rates: dict[str, str]
    name: str

    @staticmethod
    def of(about: Mapping[str, Any]) -> Described:
        """Give every variable a symbol; an output that is a state too has ``_meas`` behind."""
        taken: set[str] = set()

        def named(kind: str) -> dict[str, dict[str, Any]]:
            entries = about[kind]
            symbols = symbols_for([e["name"] for e in entries], taken)
            return dict(zip(symbols, entries, strict=True))

        states, inputs, parameters = named("states"), named("inputs"), named("parameters")
        own = {e["name"]: s for s, e in states.items()}
        texts = [f"{e['name']}_meas" if e["name"] in own else e["name"] for e in about["outputs"]]
        symbols = symbols_for(texts, taken)
        outputs = dict(zip(symbols, about["outputs"], strict=True))
        rates = {own[v]: own[q] for v, q in about["rates"].items() if v in own and q in own}
        return Described(states, inputs, outputs, parameters, rates, str(about["name"]))

    def variables(self, model: Model) -> dict[str, str]:
        """Return the FMU's names of the symbols that a model has."""
        every = {**self.states, **self.inputs, **self.parameters}
        symbols = (*model.states, *model.inputs, *model.parameters)
        return {s: every[s]["name"] for s in symbols if s in every}


def unit_text(text: str) -> str | None:
    """Return a unit of Modelica's way of writing, such as ``kg.m2`` or ``N.m.s/rad``, as ours.

    None where it is no unit that is known.
    """
    plain = re.sub(r"\.(?=[A-Za-z(])", "*", text.strip())
    plain = re.sub(r"(?<=[A-Za-z])(-?\d)", r"^\1", plain)
    if not plain:
        return None
    try:
        factors_of(plain)
        return plain
    except InputError:
        return None


def _opened(recordings: Sequence[str | Path | Recording], given: Model | None) -> list[Recording]:
    time = given.columns.get(given.time) if given is not None else None
    step = given.sample_time if given is not None else None
    return [
        r if isinstance(r, Recording) else read_recording(r, time=time, sample_time=step)
        for r in recordings
    ]


def _step(given: Model | None, opened: Sequence[Recording]) -> float | None:
    """Return the step of a co-simulation: what the sidecar says, else that of a recording."""
    if given is not None and given.sample_time is not None:
        return given.sample_time
    if not opened:
        return None
    import numpy as np

    return float(np.median(np.diff(opened[0].time)))


def _drafted(
    path: Path, told: Described, recording: Recording, steps: bool
) -> tuple[Model, list[str]]:
    """Return the model that a sidecar would be written from, and columns that nothing is."""
    quantities = _quantities(told)
    found, unknown = matched(quantities, tuple(recording.channels), recording.name, path)
    inputs = [u for u in told.inputs if u in found]
    outputs = {q.role: q for q in quantities if q.reading and q.role in found}
    parameters = dict(_parameters(told.parameters))
    every = {**told.states, **told.inputs}
    units = {s: u for s, e in every.items() if (u := unit_text(e["unit"])) is not None}
    units = {s: u for s, u in units.items() if s in told.states or s in inputs}
    units |= {y: q.unit for y, q in outputs.items() if q.unit}
    free = [p for p, e in parameters.items() if "bounds" in e]
    document = {
        "model": {
            "name": path.stem,
            "base": path.name,
            "states": list(told.states),
            "inputs": inputs,
            "outputs": list(outputs),
            "input_hold": "zero" if steps else "linear",
        },
        "readings": {y: q.reading for y, q in outputs.items()},
        "parameters": {
            p: e if p in free[:MOST_FREE] else {k: v for k, v in e.items() if k != "bounds"}
            for p, e in parameters.items()
        },
        "units": units,
        "columns": {role: column for role, column in found.items() if role != column},
    }
    return build_model(document, path.with_suffix(".toml").name), unknown


def _quantities(told: Described) -> list[Quantity]:
    """Return what a column may hold: outputs and states, and inputs."""
    positions = set(told.rates.values())

    def kind(state: str) -> str:
        return POSITION if state in positions else RATE if state in told.rates else SENSOR

    by_name = {e["name"]: s for s, e in told.states.items()}
    found = []
    for symbol, entry in told.outputs.items():
        state = by_name.get(entry["name"])
        if state is not None:
            unit = unit_text(entry["unit"]) or ""
            found.append(
                Quantity(
                    symbol, kind(state), (entry["name"],), f"output {entry['name']!r}", state, unit
                )
            )
    shown = {q.reading for q in found}
    for state, entry in told.states.items():
        if state not in shown:
            unit = unit_text(entry["unit"]) or ""
            name = entry["name"]
            found.append(
                Quantity(f"{state}_meas", kind(state), (name,), f"state {name!r}", state, unit)
            )
    for symbol, entry in told.inputs.items():
        unit = unit_text(entry["unit"]) or ""
        found.append(
            Quantity(symbol, "control", (entry["name"],), f"input {entry['name']!r}", unit=unit)
        )
    return found


def _parameters(entries: Mapping[str, Mapping[str, Any]]) -> Mapping[str, dict[str, Any]]:
    """Return the parameters; free are those that can be tuned, or have a range, and are not 0."""
    found = {}
    for name, entry in entries.items():
        value = entry["start"]
        if value is None:
            continue
        own: dict[str, Any] = {"value": value}
        unit = unit_text(entry["unit"])
        if unit is not None:
            own["unit"] = unit
        low, high = entry["min"], entry["max"]
        ranged = low is not None and high is not None and low < value < high
        if ranged:
            own["bounds"] = [low, high]
        elif entry["variability"] == "tunable" and value != 0.0:
            ends = sorted((value / NEAR, value * NEAR))
            own["bounds"] = [
                max(ends[0], low) if low is not None else ends[0],
                min(ends[1], high) if high is not None else ends[1],
            ]
        found[name] = own
    return found


def _check(model: Model, told: Described, path: Path) -> None:
    """Raise unless a sidecar names what the FMU has."""
    own = tuple(s for s in model.states if s not in model.equations)
    if set(own) != set(told.states):
        what = f"states are {', '.join(own)}; {path.name} has {', '.join(told.states)}"
        raise InputError(what[:200], path.with_suffix(".toml").name, "Name these in [model] states")
    if own != tuple(told.states):
        what, remedy = "states stand in another order", f"Write {', '.join(told.states)}"
        raise InputError(what, path.with_suffix(".toml").name, remedy)
    for u in model.inputs:
        if u not in told.inputs:
            what = f"{path.name} has no input {u!r}; it has {', '.join(told.inputs) or 'none'}"
            raise InputError(what[:200], path.with_suffix(".toml").name, "Name one of these")


def _assumed(
    table: Path, model: Model, recording: Recording, unknown: Sequence[str]
) -> list[dict[str, Any]]:
    free = ", ".join(model.free_parameters) or "nothing"
    message = (
        f"{table.name} was drafted: columns by their names, input_hold {model.input_hold!r}, "
        f"free are {free}"
    )
    rows = [_row(table.name, "drafted", message)]
    if unknown:
        names = ", ".join(unknown[:12])
        message = f"columns that match no variable are not used: {names}"
        rows.append(_row(recording.name, "columns", message))
    return rows


def step_check(file: str, step: float, apart: float) -> list[dict[str, Any]]:
    """Say how far steps are from the law that they go along."""
    if not (step and apart):
        return []
    message = (
        f"steps of {step:g} s differ from the law that they go along by up to {apart:.2g} of its "
        "rates. The diagnosis compares the law, not the steps"
    )
    return [_row(file, "time_step", message)]


def _row(file: str, check: str, message: str) -> dict[str, Any]:
    return {"file": file, "channel": "", "check": check, "message": message}


def write_sidecar(table: Path, text: str, elsewhere: Path | None = None) -> Path | None:
    """Write a drafted sidecar beside its simulator, or `elsewhere` where that cannot be."""
    if not text:
        return None
    try:
        if table.exists():  # written meanwhile
            return None
        atomic_write_text(table, text)
        return table
    except InputError:
        if elsewhere is None:
            return None
        atomic_write_text(elsewhere / table.name, text)
        return elsewhere / table.name
