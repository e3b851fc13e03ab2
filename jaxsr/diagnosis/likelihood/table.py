"""The table of additions: columns of all candidates about one path, and one Gram matrix."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.likelihood.estimate import Belief
from jaxsr.diagnosis.likelihood.evidence import Gram, Prior, modes
from jaxsr.diagnosis.likelihood.local import LocalModel, linearised
from jaxsr.diagnosis.likelihood.scales import Scales, grams
from jaxsr.diagnosis.likelihood.sensor_noise import Noise
from jaxsr.diagnosis.likelihood.steps import as_fine, resolved
from jaxsr.diagnosis.likelihood.switched import rounded, switched
from jaxsr.diagnosis.likelihood.workspace import Workspace, along, in_columns
from jaxsr.diagnosis.mechanisms.candidate import UNLIMITED
from jaxsr.diagnosis.mechanisms.site import Threshold
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.reduced import lean
from jaxsr.models.least_squares import Problem
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import build_segments

TOGETHER = 4
"""Memories that are integrated in one model: each adds states to all of its derivatives."""


SAME = 1e-9
"""Cosine, less than 1, from which two effects in the sensors are one: rounding."""
_STILL = 1e-300


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of all candidates about one path, and what is believed of them.

    Attributes
    ----------
    grams : list of Gram
        By size of the latent force.
    base : tuple of int
        Columns of the given model's free parameters.
    value : ndarray, shape (columns,)
        Where the constants stand; 0 for columns of what is off.
    belief : Belief
    own : dict of int to tuple of int
        Candidate of the super-model to its columns.
    names : dict of str to int
        Parameter of the super-model to its column.
    scales : Scales
    """

    grams: list[Gram]
    base: tuple[int, ...]
    value: np.ndarray
    belief: Belief
    own: Mapping[int, tuple[int, ...]]
    names: Mapping[str, int]
    scales: Scales

    def prior(self, chosen: Sequence[int]) -> Prior:
        """Return the priors of changes of some columns."""
        return self.belief.about(self.value).of(chosen)

    def best(self, chosen: Sequence[int]) -> float:
        """Return the log evidence of a set of columns, the latent force of its best size."""
        at, prior = list(chosen), self.prior(chosen)
        try:
            found = modes(self.grams, at, prior)
        except np.linalg.LinAlgError:  # columns that are no numbers
            return -np.inf
        return max(m.log_evidence if np.isfinite(m.log_evidence) else -np.inf for m in found)


@dataclass(frozen=True, eq=False)
class _Columns:
    """Columns under construction, by name of the super-model's parameters.

    Attributes
    ----------
    steps : list of ndarray, shape (steps, pieces, states)
    readings : list of ndarray, shape (samples, pieces, outputs)
    rows : list of (value, mean, deviation, low, high)
    """

    steps: list[np.ndarray]
    readings: list[np.ndarray]
    rows: list[tuple[float, float, float, float, float]]

    def put(self, step: np.ndarray, reading: np.ndarray, row: Sequence[float]) -> int:
        """Append a column and return its place."""
        self.steps.append(step)
        self.readings.append(reading)
        self.rows.append((row[0], row[1], row[2], row[3], row[4]))
        return len(self.rows) - 1


def tabled(
    work: Workspace,
    theta: np.ndarray,
    path: np.ndarray,
    noise: Noise | None = None,
    decay: float | None = None,
    width: float | None = None,
    steps: Stepping | None = None,
) -> Table:
    """Linearise about a path by the constants of all candidates at once.

    Parameters
    ----------
    theta : ndarray, shape (parameters of the super-model,)
    path : ndarray, shape (states of the given model, samples, pieces)
    noise : Noise, optional
        Of the sensors; that of the workspace by default.
    decay : float, optional
        Of the latent force, from sample to sample; that of the workspace by default.
    width : float, optional
        Of the jumps along the path, in the sharpest that the data can tell; exact by default. A
        path with rounded jumps is no motion of a model with exact ones.
    steps : Stepping, optional
        By which that path was found; with rounded jumps found anew by default.
    """
    model, values = work.columns, in_columns(work, theta)
    active = list(model.base_index())
    own: dict[int, tuple[int, ...]] = {}
    for i, candidate in enumerate(model.candidates):
        fixed = candidate.fixed_parameter is not None
        indices = model.index(i, coefficients_only=not fixed)
        active += [j for j in indices if j not in active]
        own[work.place[i]] = tuple(active.index(j) for j in indices)
    if width:
        problem = rounded(work.narrow, width, values)
        if steps is None:
            args = values, path, noise or work.scales.noise, work.scales.start[: len(path)], active
            problem = resolved(problem, *args)
        else:
            problem = as_fine(problem, values, steps)
    else:
        problem = switched(work.narrow, values, work.narrow.stepping.substeps) or work.narrow
    args = problem.simulator, problem.stepping, problem.segments, values, path
    local = linearised(*args, active)
    places = tuple(active.index(j) for j in work.scales.forces)
    if not local.by_constant[..., list(places)].any(axis=(0, 1, 2)).all():
        # Where a speed is zero at a sample, the switch of a law that is off has no derivative.
        problem = work.narrow
        args = problem.simulator, problem.stepping, problem.segments, values, path
        local = linearised(*args, active)
    usual = _Usual.of(work, local, path, places)
    names = {name: k for name, k in _names(work, active).items()}
    columns = _Columns(
        list(np.moveaxis(local.by_constant, -1, 0)),
        list(np.moveaxis(local.reading_by_constant, -1, 0)),
        _rows(work, active, values, usual.deviations(local.by_constant, local.reading_by_constant)),
    )
    own = _with_trials(work, problem, local, columns, own, values, path)
    _with_memories(work, columns, own, names, theta, path, usual)
    local = replace(
        local,
        by_constant=np.stack(columns.steps, -1),
        reading_by_constant=np.stack(columns.readings, -1),
    )
    value, mean, deviation, low, high = np.array(columns.rows, dtype=float).reshape(-1, 5).T
    belief = Belief(mean, deviation, low, high)
    scales = replace(
        work.scales,
        forces=places,
        size=usual.force,
        start=work.scales.start[: len(path)],
        noise=noise or work.scales.noise,
        decay=work.scales.decay if decay is None else decay,
    )
    base = tuple(range(len(model.base_index())))
    table = grams(local, scales, scales.shares)
    own = _without_duplicates(work.super_model, table[0], own)
    return Table(table, base, value, belief, own, names, scales)


def _without_duplicates(
    model: SuperModel, gram: Gram, own: dict[int, tuple[int, ...]]
) -> dict[int, tuple[int, ...]]:
    """Leave out candidates whose effect a wrong value has as well: nothing new has to be there."""
    products = gram.products[1:, 1:]
    size = np.sqrt(np.diag(products)) + 1e-300
    values = [
        at[0]
        for i, at in own.items()
        if model.candidates[i].fixed_parameter is not None and len(at) == 1
    ]

    def doubled(i: int, at: tuple[int, ...]) -> bool:
        if model.candidates[i].fixed_parameter is not None or len(at) != 1 or not values:
            return False
        (k,) = at
        alike = np.abs(products[k, values]) / (size[k] * size[values])
        return bool(np.max(alike) > 1.0 - SAME)

    return {i: at for i, at in own.items() if not doubled(i, at)}


@dataclass(frozen=True, eq=False)
class _Usual:
    """How far states go in a step, and readings at all, and the rms of the net forces.

    A coefficient is believed to be as large as brings a force as large as the net force, or a
    reading as far away as it varies.
    """

    moved: np.ndarray
    read: np.ndarray
    force: np.ndarray
    states: tuple[int, ...]

    @staticmethod
    def of(work: Workspace, local: LocalModel, path: np.ndarray, places: Sequence[int]) -> _Usual:
        inside = np.arange(1, path.shape[1])[:, None] < work.narrow.segments.count
        moved = np.sqrt(np.mean(np.diff(path, axis=1)[:, inside] ** 2, axis=1)) + _STILL
        rows = list(work.force_states)
        effect = np.sqrt(np.mean(local.by_constant[..., list(places)] ** 2, axis=(0, 1)))
        own = effect[rows, range(len(rows))]
        # A force that changes nothing is none.
        size = np.divide(moved[rows], own, out=np.zeros(len(rows)), where=own > 0.0)
        return _Usual(moved, work.narrow.scale, size, work.force_states)

    def deviations(self, step: np.ndarray, reading: np.ndarray) -> np.ndarray:
        """Return the sizes that coefficients are believed to have, shape (columns,).

        A state that stands still says of no coefficient how large it is.
        """
        effect = np.sqrt(np.mean(step**2, axis=(0, 1)))
        read = np.sqrt(np.mean(reading**2, axis=(0, 1)))
        rows = [row for row in self.states if self.moved[row] > _STILL]
        share = np.sum((effect[rows] / self.moved[rows, None]) ** 2, axis=0)
        share += np.sum((read / self.read[:, None]) ** 2, axis=0)
        return np.where(share > 0.0, 1.0 / np.sqrt(share + 1e-300), 1.0)


def _rows(
    work: Workspace, active: Sequence[int], values: np.ndarray, deviation: np.ndarray
) -> list[tuple[float, float, float, float, float]]:
    """Return value and belief of constants of the columns' model."""
    parameters = list(work.columns.model.parameters.values())
    given, seeds = set(work.columns.given.free_parameters), _seeds(work.columns)
    names, rows = list(work.columns.model.parameters), []
    for k, j in enumerate(active):
        mean, bounds = parameters[j].value, parameters[j].bounds
        low, high = bounds or (-UNLIMITED, UNLIMITED)
        size = deviation[k]
        if names[j] in given:
            size = (high - low) / np.sqrt(12.0)
        elif bounds is None:  # a fixed value of the given model
            size = 0.5 * abs(mean) + 1e-12
        if names[j] in seeds:  # where it does nothing says nothing of its size
            mean, size = seeds[names[j]], abs(seeds[names[j]]) + 1e-12
        rows.append((values[j], mean, size, low, high))
    return rows


def _seeds(model: SuperModel) -> dict[str, float]:
    """Return what thresholds start from, by their names in a super-model."""
    return {
        names[spec.name]: spec.seed
        for candidate, names in zip(model.candidates, model.names, strict=True)
        for spec in candidate.parameters
        if isinstance(spec, Threshold)
    }


def _names(work: Workspace, active: Sequence[int]) -> dict[str, int]:
    """Names of the super-model's parameters to their places among the active ones."""
    here = list(work.columns.model.parameters)
    place = {here[j]: k for k, j in enumerate(active)}
    found = {n: place[n] for n in work.super_model.given.parameters if n in place}
    for i, there in enumerate(work.place):
        mine, theirs = work.columns.names[i], work.super_model.names[there]
        found |= {theirs[own]: place[mine[own]] for own in mine if mine[own] in place}
    return found


def _with_trials(
    work: Workspace,
    problem: Problem,
    local: LocalModel,
    columns: _Columns,
    own: dict[int, tuple[int, ...]],
    values: np.ndarray,
    path: np.ndarray,
) -> dict[int, tuple[int, ...]]:
    """Add a column for candidates that have no tangent where they do nothing: limits, dead zones.

    It is what they do at their seed, all or nothing: one is believed as much as the other.
    """
    effect = np.abs(local.by_constant).max((0, 1, 2)) + np.abs(local.reading_by_constant).max(
        (0, 1, 2)
    )
    own = dict(own)
    for i, there in enumerate(work.place):
        at = own[there]
        fixed = work.columns.candidates[i].fixed_parameter is not None
        if fixed or not at or effect[list(at)].any():
            continue
        seeded = work.columns.switched([i], work.columns.seeded([i], values))
        args = problem.simulator, problem.stepping, problem.segments, seeded, path
        other = linearised(*args, ())
        change = np.nan_to_num(local.innovation - other.innovation)
        if np.isfinite(other.defect).all():
            trial = other.defect - local.defect, change, (0.0, 0.0, 1.0, 0.0, UNLIMITED)
            own[there] = (columns.put(*trial),)
    return own


def _with_memories(
    work: Workspace,
    columns: _Columns,
    own: dict[int, tuple[int, ...]],
    names: dict[str, int],
    theta: np.ndarray,
    path: np.ndarray,
    usual: _Usual,
) -> None:
    """Add columns of candidates with states of their own, which run along the path.

    Their coefficients, or the switch of a lag, are then linear as in any other mechanism; inner
    constants stand where `theta` has them.
    """
    model = work.super_model
    numbers = [i for i, c in enumerate(model.candidates) if c.states]
    prepared, n = along(work, path), len(path)
    order = list(model.model.parameters)
    for first in range(0, len(numbers), TOGETHER):
        few = numbers[first : first + TOGETHER]
        small = lean(model, work.narrow.simulator, work.narrow.stepping, few)
        indices = [j for i in few for j in model.index(i, coefficients_only=True)]
        values = model.switched((), theta)
        values[[j for j in indices]] = work.theta[indices]
        values = values[small.parameters]
        segments = build_segments(
            small.simulator.model, prepared, work.rows, small.stepping.substeps, theta=values
        )
        course = segments.course.copy()
        course[:n] = path
        active = small.active(np.array(indices, int)).tolist()
        local = linearised(small.simulator, small.stepping, segments, values, course, active)
        steps, readings = local.by_constant[:, :, :n], local.reading_by_constant
        sizes = usual.deviations(steps, readings)
        for k, j in enumerate(indices):
            i = next(i for i in few if j in model.index(i, coefficients_only=True))
            switch, spec = bool(model.candidates[i].replaced), model.model.parameters[order[j]]
            low, high = spec.bounds or (-UNLIMITED, UNLIMITED)
            row = (0.0, 0.0, 1.0 if switch else float(sizes[k]), low, high)
            if not np.isfinite(steps[..., k]).all():
                continue
            at = columns.put(steps[..., k], readings[..., k], row)
            own[i] = (*own.get(i, ()), at)
            if not switch:
                names[order[j]] = at
