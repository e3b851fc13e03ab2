"""A generator of forms: models times recordings, each a folder that a command reads.

``form(number)`` is the same on every machine. Its kind of model and its kind of recording follow
from the number alone; 40 kinds of models and 39 of recordings have no common factor, so that
1,560 numbers meet every pair, and any 40 in a row every kind. Data come from the true system by
plain code, with or without an effect that the model lacks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import form_models
import form_recordings
import numpy as np
from form_plants import NAMES, Plant, excitation, simulate
from form_recordings import Channels, Plan, Table, file_text
from hypothesis import strategies
from model_forms import ModelForm

ENOUGH = 50
"""Present samples of a file's best sensor below which a refusal is right too."""
_ARRAYS = {"sin": np.sin, "cos": np.cos, "sqrt": np.sqrt, "exp": np.exp, "Abs": np.abs}


@dataclass(frozen=True)
class Form:
    """A model, its recordings, and what the command may answer.

    Attributes
    ----------
    number : int
    model, recording : str
        The kinds.
    missing : str
        The effect that the model lacks; empty where it lacks none.
    files : dict of str to str
        Name to text.
    simulator : str
        First argument of ``jaxsr diagnose``.
    data, held_out : tuple of str
    may_refuse : str
        Why exit status 2 with one line would be right; empty where the form is sound.
    wild : bool
        Whether the explained model need not follow the whole recording.
    """

    number: int
    model: str
    recording: str
    missing: str
    files: Mapping[str, str]
    simulator: str
    data: tuple[str, ...]
    held_out: tuple[str, ...]
    may_refuse: str
    wild: bool

    @property
    def sound(self) -> bool:
        """Whether only a diagnosis is right."""
        return not self.may_refuse

    @property
    def label(self) -> str:
        """Number and kinds."""
        return f"form {self.number}: {self.model}, {self.recording}"

    def write(self, folder: Path) -> Path:
        """Write the files."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in self.files.items():
            (folder / name).write_text(text, encoding="utf-8")
        return folder

    def arguments(self, out: str = "out") -> list[str]:
        """Arguments of the command, to be run inside the folder."""
        held = ["--held-out", *self.held_out] if self.held_out else []
        return ["diagnose", self.simulator, *self.data, *held, "--out", out]


def form(number: int, small: bool = False) -> Form:
    """Return the form of this number; `small` ones have at most a few hundred samples."""
    rng = np.random.default_rng([number, int(small)])
    turn = number // len(form_models.KINDS)
    make = form_models.KINDS[number % len(form_models.KINDS)]
    names = tuple(form_recordings.KINDS)
    recording = names[number % len(names)]
    model, plan = make(rng, turn), form_recordings.KINDS[recording](rng, small)
    plan = _files_for(model, plan)
    missing = str(rng.choice(["", *model.plant.effects])) if model.plant.effects else ""
    files, refused = _recordings(model, plan, missing, rng)
    data, held = tuple(files)[: len(plan.sizes)], tuple(files)[len(plan.sizes) :]
    texts = {name: file_text(table, plan) for name, table in files.items()}
    table = "m.toml"
    texts[table] = _model_text(model, plan, data, rng)
    if model.python:
        texts["m.py"] = model.python
    return Form(
        number=number,
        model=make.__name__.replace("_", " "),
        recording=recording,
        missing=missing,
        files=texts,
        simulator="m.py:f" if model.python else table,
        data=data,
        held_out=held,
        may_refuse=model.may_refuse or plan.may_refuse or refused,
        wild=model.wild,
    )


def forms(small: bool = True) -> strategies.SearchStrategy[Form]:
    """Draw forms by their numbers."""
    return strategies.integers(0, 10**6).map(lambda number: form(number, small))


def _files_for(model: ModelForm, plan: Plan) -> Plan:
    """Give models whose parameters differ by file two files."""
    if model.per_recording and len(plan.sizes) == 1:
        return Plan(**{**vars(plan), "sizes": plan.sizes * 2})
    return plan


def _model_text(model: ModelForm, plan: Plan, data: tuple[str, ...], rng: np.random.Generator):
    """Return the model file; free values are off by up to a fifth, in half of the forms."""
    wrong = rng.random() < 0.5
    given = {}
    for name, value in model.parameters.items():
        free = model.free is None or name in model.free
        factor = rng.uniform(0.8, 1.2) if wrong and free else 1.0
        given[name] = float(f"{value * factor:.5g}")
    columns = f'[columns]\nt = "{plan.time}"\n' if plan.time != "t" else ""
    if plan.scale == 1.0:
        return model.text(given, data, columns)
    first = next(iter(model.sensors))
    reading = {**model.sensors, **model.readings}[first]
    scaled = {**model.readings, first: f"{plan.scale!r}*({reading})"}
    units = {**model.units, first: "mm"} if model.units.get(first) == "m" else model.units
    if units is not model.units:
        scaled[first], units = f"{plan.scale!r}*({reading})", {}
    return ModelForm(**{**vars(model), "readings": scaled, "units": units}).text(
        given, data, columns
    )


def _recordings(
    model: ModelForm, plan: Plan, missing: str, rng: np.random.Generator
) -> tuple[dict[str, Table], str]:
    """Return tables by file, those of DATA first, and why they may be refused."""
    channels = Channels(tuple(model.sensors), tuple(model.recorded))
    tables, refused = {}, ""
    for number, size in enumerate([*plan.sizes, *plan.held]):
        held = number >= len(plan.sizes)
        name = f"h{number - len(plan.sizes)}.csv" if held else f"{'abcdefgh'[number]}.csv"
        clean = _samples(model, plan, missing, (number, size), rng)
        table = clean if held else plan.spoil(clean, channels, rng, number)
        tables[name] = table
        refused = refused or ("" if held else _too_little(table, channels, name))
    return tables, refused


def _too_little(table: Table, channels: Channels, name: str) -> str:
    """Say why a table may be refused: hardly any samples, or none that move."""
    present = [table[s][np.isfinite(table[s])] for s in channels.sensors if s in table]
    if max((column.size for column in present), default=0) < ENOUGH:
        return f"{name} has few samples"
    if any(column.size and np.ptp(column) == 0.0 for column in present):
        return f"{name} has a constant sensor"
    return ""


def _samples(
    model: ModelForm, plan: Plan, missing: str, place: tuple[int, int], rng: np.random.Generator
) -> Table:
    """Run the true system and return one clean table; `place` is the file's number and size."""
    number, size = place
    plant: Plant = model.plant
    step = model.head.get("sample_time")
    if not isinstance(step, float):
        step = plant.step * float(rng.choice([2, 4])) * plan.rates[number % len(plan.rates)]
        step = min(step, plant.longest / size)
    times = np.arange(size) * step
    if plan.jitter and "sample_time" not in model.head:
        times[1:] += plan.jitter * step * rng.uniform(-1.0, 1.0, size - 1)
    inputs = excitation(plant, rng, plan.still)
    start = tuple(s * rng.uniform(0.8, 1.2) for s in plant.start)
    path = simulate(plant, times, inputs, missing, start)
    known = _true_channels(plant, times, path, inputs, missing)
    table: Table = {}
    if "sample_time" not in model.head:
        table[plan.time] = (plan.origin + times) / plan.unit
    for k, (name, text) in enumerate(model.sensors.items()):
        clean = _values(text, known, size) * (plan.scale if k == 0 else 1.0)
        table[name] = clean + plan.noise * np.std(clean) * rng.standard_normal(size)
    return table | {name: _values(text, known, size) for name, text in model.recorded.items()}


def _true_channels(
    plant: Plant, times: np.ndarray, path: np.ndarray, inputs, missing: str
) -> dict[str, np.ndarray]:
    """Return time, states, inputs and the rates ``d_STATE``."""
    u = np.array([inputs(t) for t in times]).reshape(times.size, -1)
    names = plant.states.split()
    known = {"t": times, **dict(zip(names, path.T, strict=True))}
    known |= dict(zip(plant.inputs.split(), u.T, strict=True))
    f = plant.rate(missing)
    rates = np.array([f(t, x, v) for t, x, v in zip(times, path.tolist(), u.tolist(), strict=True)])
    return known | {f"d_{n}": rates[:, k] for k, n in enumerate(names)}


def _values(text: str, known: Mapping[str, np.ndarray], size: int) -> np.ndarray:
    """Evaluate one of this module's own texts on the true channels."""
    space = {**NAMES, **_ARRAYS, **known, **_constants()}
    return np.broadcast_to(np.asarray(eval(text, space), dtype=float), size).copy()


def _constants() -> dict[str, float]:
    from form_systems import LEAN

    return {k: LEAN.values[k] for k in ("kp", "kd")}
