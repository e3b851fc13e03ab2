"""pysindy on the tool's own residual and library: STLSQ in the weak view.

The library holds a column for every coefficient of every mechanism that the tool considers, inner
constants at the tool's first values: forces, actuators, memories, wrong values and modes, and
sensors and timing by what a small fault of theirs does to the residual. The free parameters of the
given model stay, and are estimated with the terms.
"""

from __future__ import annotations

import contextlib
import io
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.concealed.weak_columns import WeakColumns, with_candidates
from jaxsr._result import InputError
from jaxsr.diagnosis.mechanisms import sensor_candidates
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.mechanisms.timing import timing_candidates
from jaxsr.diagnosis.setup import sample_step, seen_by
from jaxsr.diagnosis.weak.weak_grid import WeakGrid
from jaxsr.diagnosis.weak.weak_system import weak_system
from jaxsr.models import Model, Simulator
from jaxsr.models.edits import apply_edit
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

THRESHOLDS = (0.01, 0.03, 0.1, 0.3)
RIDGES = (1e-8, 1e-3, 1e-1)
"""The ridge is searched as well: variants of one mechanism are nearly collinear."""
COLLINEAR = 0.02
"""Relative norm of a column that the free parameters leave, below which it is no evidence."""
GAIN = 0.98
"""Held-back mean square, relative to the best so far, from which more terms stand."""
FAULT = 1e-3
"""Size of a sensor's fault by which its column is taken, in its natural scale."""


@dataclass(frozen=True, eq=False)
class Library:
    """Rows of all equations, weighted alike, and what may explain them.

    `columns` has a column for each coefficient; `owner` the candidate it belongs to, and `name`
    that candidate's own name of it. `base` has those of the model's free parameters.
    """

    target: np.ndarray
    columns: np.ndarray
    base: np.ndarray
    owner: tuple[Candidate, ...]
    name: tuple[str, ...]
    offset: np.ndarray  # neutral values of the coefficients
    unit: np.ndarray  # change of the parameter for a coefficient of 1
    check: np.ndarray  # rows of the recording held back
    free: tuple[str, ...]


@dataclass(frozen=True)
class Term:
    """A chosen candidate, its values, and the rms of what it contributes to the residual."""

    candidate: Candidate
    values: Mapping[str, float]
    share: float


def library(model: Model, data: Sequence[Prepared]) -> Library | None:
    """Return the library of a re-calibrated model; None where a state hides.

    Parameters
    ----------
    model : Model
        With the calibrated values.
    data : sequence of Prepared
        The last recording is held back.
    """
    seen = seen_by(Simulator(model), data)
    if seen is None:
        return None
    super_model = SuperModel.build(model, seen.candidates)
    given = weak_system(Simulator(model), seen.grid, np.array(_values(model)))
    system = with_candidates(WeakColumns(seen.grid), given, super_model)
    order = list(super_model.model.parameters)
    scale = np.ones(len(model.states))
    for state in np.unique(system.state):
        scale[state] = np.sqrt(np.mean(system.residual[system.state == state] ** 2)) + 1e-300
    weight = 1.0 / scale[system.state]
    columns, owner, name, offset, unit = [], [], [], [], []
    for number, candidate in enumerate(super_model.candidates):
        for j in super_model.index(number, coefficients_only=True):
            columns.append(-weight * system.jacobian[:, j])
            owner.append(candidate)
            name.append(_own(super_model, number, order[j]))
            offset.append(system.theta[j])
            unit.append(1.0)
    duration = max(float(p.time[-1]) for p in data)
    faults = sensor_candidates(model) + timing_candidates(model, sample_step(data), duration)
    for candidate in faults:
        moved = _with_fault(model, data, candidate)
        if moved is None:
            continue
        size, items = moved
        grid = WeakGrid.build(model, items, system.half_width)
        other = weak_system(Simulator(model), grid, np.array(_values(model)))
        if other.residual.shape == system.residual.shape:
            columns.append(weight * (other.residual - system.residual) / FAULT)
            owner.append(candidate)
            name.append(candidate.parameters[0].name)
            offset.append(candidate.parameters[0].neutral)
            unit.append(size)
    base = -weight[:, None] * system.jacobian[:, super_model.base_index()]
    return Library(
        target=weight * system.residual,
        columns=np.nan_to_num(np.stack(columns, axis=1)),
        base=base,
        owner=tuple(owner),
        name=tuple(name),
        offset=np.array(offset),
        unit=np.array(unit),
        check=system.recording == len(data) - 1,
        free=tuple(model.free_parameters),
    )


def _values(model: Model) -> list[float]:
    return [p.value for p in model.parameters.values()]


def _own(super_model: SuperModel, number: int, full: str) -> str:
    """Return a candidate's own name of a parameter; that of a switch is itself."""
    return next((own for own, n in super_model.names[number].items() if n == full), "switch")


def _with_fault(
    model: Model, data: Sequence[Prepared], candidate: Candidate
) -> tuple[float, list[Prepared]] | None:
    """Return the size of a unit fault, and the recordings freed of a small one.

    The column is what freeing the sensor of `FAULT` units changes in the residual.
    """
    signal = candidate.site.partition(":")[2]
    channel = model.columns.get(signal, signal)
    step, items = sample_step(data), []
    spread = float(np.nanstd(np.concatenate([p.recording.channels[channel] for p in data])))
    size = {
        "sensor_gain": 1.0,
        "sensor_bias": spread,
        "sensor_delay": step,
        "input_delay": step,
        "clock_skew": step / max(float(p.time[-1]) for p in data),
    }.get(candidate.mechanism)
    if size is None or not spread > 0:
        return None
    for item in data:
        y, t = item.recording.channels[channel], item.time
        slope = np.gradient(y, t)
        change = {
            "sensor_gain": -y,
            "sensor_bias": -np.ones_like(y),
            "sensor_delay": slope,
            "input_delay": -slope,
            "clock_skew": -t * slope,
        }[candidate.mechanism]
        freed = {**item.recording.channels, channel: y + FAULT * size * change}
        items.append(Prepared.build(model, Recording(item.recording.name, t, freed)))
    return size, items


def select(found: Library) -> tuple[list[Term], dict[str, float]]:
    """Choose terms by STLSQ, its settings by the recording held back.

    Returns
    -------
    terms : list of Term
        The largest contribution first; empty where none helps on the recording held back.
    shifts : dict
        Changes of the free parameters that go with them.
    """
    train, check = ~found.check, found.check
    picked = _support(found, train, check)
    error = null = _error(found, [], train, check)[0]
    xi, beta = np.zeros(0), np.zeros(0)
    while picked.size:
        error, xi, beta = _error(found, picked, train, check)
        inside = [_possible(found, j, x) for j, x in zip(picked, xi, strict=True)]
        if all(inside):
            break
        # as in the tool's screening, nothing stands that breaks its sign
        picked = picked[np.array(inside)]
    if picked.size == 0 or error >= GAIN * null:
        return [], {}
    return _terms(found, picked, xi), dict(zip(found.free, beta, strict=True))


def _support(found: Library, train: np.ndarray, check: np.ndarray) -> np.ndarray:
    """Return the columns that STLSQ keeps at the settings that do best on the rows held back."""
    import pysindy

    size = np.sqrt((found.base**2).sum(0)) + 1e-300
    basis = np.linalg.qr((found.base / size)[train])[0]

    def left(a: np.ndarray) -> np.ndarray:
        return a - basis @ (basis.T @ a)

    norms = np.sqrt((found.columns[train] ** 2).sum(0))
    rest = left(found.columns[train])
    strength = np.sqrt((rest**2).sum(0))
    usable = np.flatnonzero(strength > np.maximum(COLLINEAR * norms, 1e-12))
    theta, target = rest[:, usable] / strength[usable], left(found.target[train])
    spread = np.linalg.norm(target) or 1.0
    best, picked = _error(found, [], train, check)[0], np.zeros(0, int)
    for ridge in RIDGES:
        for threshold in THRESHOLDS:
            with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
                warnings.simplefilter("ignore")
                model = pysindy.STLSQ(threshold=threshold, alpha=ridge, max_iter=20)
                model.fit(theta, target[:, None] / spread)
            support = usable[np.flatnonzero(np.asarray(model.coef_)[0])]
            if support.size == 0 or support.size > train.sum() // 3:
                continue
            error = _error(found, support, train, check)[0]
            if error < GAIN * best:
                best, picked = error, support
    return picked


def _terms(found: Library, picked: np.ndarray, xi: np.ndarray) -> list[Term]:
    """Return the candidates of the chosen columns, the largest contribution first."""
    values: dict[Candidate, dict[str, float]] = {}
    share: dict[Candidate, float] = {}
    for j, coefficient in zip(picked, xi, strict=True):
        candidate = found.owner[j]
        own = values.setdefault(candidate, {p.name: p.neutral for p in candidate.parameters})
        if found.name[j] in own:
            own[found.name[j]] = _value(found, j, coefficient)
        part = abs(coefficient) * float(np.sqrt(np.mean(found.columns[:, j] ** 2)))
        share[candidate] = share.get(candidate, 0.0) + part
    return [Term(c, values[c], share[c]) for c in sorted(share, key=lambda c: -share[c])]


def _value(found: Library, j: int, coefficient: float) -> float:
    return float(found.offset[j] + found.unit[j] * coefficient)


def _possible(found: Library, j: int, coefficient: float) -> bool:
    """Tell whether a coefficient keeps to its bounds."""
    spec = next((p for p in found.owner[j].parameters if p.name == found.name[j]), None)
    return spec is None or spec.low <= _value(found, j, coefficient) <= spec.high


def _error(
    found: Library, support: Any, train: np.ndarray, check: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Estimate the terms of a support with the free parameters; the error on rows held back."""
    support = np.asarray(support, int)
    a = np.hstack([found.base, found.columns[:, support]])
    size = np.sqrt((a[train] ** 2).sum(0)) + 1e-300
    solved = np.linalg.lstsq((a / size)[train], found.target[train], rcond=1e-9)[0] / size
    error = float(np.mean((found.target[check] - a[check] @ solved) ** 2))
    return error, solved[found.base.shape[1] :], solved[: found.base.shape[1]]


def edited(model: Model, terms: Sequence[Term], shifts: Mapping[str, float]) -> Model | None:
    """Return the model with the terms written in; None where they do not go together."""
    parameters = {
        n: replace(p, value=p.value + shifts.get(n, 0.0), bounds=None)
        for n, p in model.parameters.items()
    }
    model = replace(model, parameters=parameters)
    try:
        for number, term in enumerate(terms):
            taken = set(model.parameters) | set(model.symbols)
            names = term.candidate.names(taken, f"__{number}")
            model = apply_edit(model, term.candidate.edit(model, names, term.values))
    except (InputError, ValueError, KeyError):
        return None
    return model
