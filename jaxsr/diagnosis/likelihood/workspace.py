"""What every hypothesis of a diagnosis shares: pieces of recordings, noise, beliefs, scales."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from jaxsr.diagnosis.contest.integration import choose_stepping
from jaxsr.diagnosis.likelihood.estimate import Belief, Scales, grams
from jaxsr.diagnosis.likelihood.evidence import Gram, Prior
from jaxsr.diagnosis.likelihood.kalman import Noise
from jaxsr.diagnosis.likelihood.local import LocalModel, linearised
from jaxsr.diagnosis.likelihood.switched import switched
from jaxsr.diagnosis.mechanisms.candidate import UNLIMITED, Candidate
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.models.least_squares import Problem
from jaxsr.models.segments import Prepared, build_segments, unbroken
from jaxsr.models.simulator import Simulator
from jaxsr.models.states import spread
from jaxsr.recordings import noise_level

LENGTH = 512
"""Samples of a piece: as many passes in time as that, whatever the length of the recordings."""
SHARES = (0.0, *np.geomspace(1e-3, 1.0, 7))
"""Of the net force that the latent force may be."""
START = 4.0
"""Variance of a start about the path, in that of the state over the recordings."""


@dataclass(frozen=True, eq=False)
class Workspace:
    """Candidates, data and beliefs.

    Attributes
    ----------
    super_model : SuperModel
        All candidates.
    columns : SuperModel
        Those whose effect, to first order, is a column: without states of their own.
    place : tuple of int
        Where the candidates of `columns` stand in `super_model`.
    problem : Problem
        Of `super_model`.
    narrow : Problem
        Of `columns`.
    theta : ndarray, shape (parameters of `super_model`,)
    scales : Scales
        `forces` are parameters of `columns`.
    force_states : tuple of int
    """

    super_model: SuperModel
    columns: SuperModel
    place: tuple[int, ...]
    problem: Problem
    narrow: Problem
    theta: np.ndarray
    scales: Scales
    force_states: tuple[int, ...]

    @property
    def helpers(self) -> list[int]:
        """Candidates of the super-model that push along an equation, one each."""
        every = enumerate(self.columns.candidates)
        return [self.place[i] for i, c in every if c.mechanism == "constant_force"]

    @staticmethod
    def build(super_model: SuperModel, prepared: Sequence[Prepared], seconds: float) -> Workspace:
        """Cut recordings into pieces and measure noise and forces.

        Parameters
        ----------
        seconds : float
            How long a force that nobody knows keeps its sign.
        """
        given = super_model.given
        simple = [i for i, c in enumerate(super_model.candidates) if _is_column(c)]
        columns = SuperModel.build(given, [super_model.candidates[i] for i in simple])
        rows = _pieces(prepared)
        outputs = np.concatenate([p.outputs for p in prepared])

        def problem(of: SuperModel) -> Problem:
            simulator = Simulator(of.model)
            values = np.array([p.value for p in of.model.parameters.values()])
            stepping = choose_stepping(simulator, prepared, values)
            segments = build_segments(of.model, prepared, rows, stepping.substeps)
            return Problem(simulator, stepping, segments, spread(outputs))

        whole, narrow = problem(super_model), problem(columns)
        values = np.array([p.value for p in columns.model.parameters.values()])
        narrow = switched(narrow, values, narrow.stepping.substeps) or narrow
        noise = [
            np.median([noise_level(p.time, p.outputs[:, k]) for p in prepared])
            for k in range(outputs.shape[1])
        ]
        white = np.square(np.maximum(noise, 1e-9 * spread(outputs)))
        interval = float(np.median([p.recording.sample_time for p in prepared]))
        forces = [i for i, c in enumerate(columns.candidates) if c.mechanism == "constant_force"]
        places = tuple(columns.index(i, coefficients_only=True)[0] for i in forces)
        states = tuple(given.states.index(columns.candidates[i].terms[0][0]) for i in forces)
        path = whole.segments.course
        scales = Scales(
            places,
            np.ones(len(places)),
            np.array(SHARES),
            float(np.exp(-interval / seconds)),
            Noise(white, np.zeros_like(white), np.zeros_like(white)),
            START * path.var(axis=(1, 2)) + 1e-24,
        )
        theta = np.array([p.value for p in super_model.model.parameters.values()])
        return Workspace(super_model, columns, tuple(simple), whole, narrow, theta, scales, states)


def in_columns(work: Workspace, theta: np.ndarray) -> np.ndarray:
    """Return parameters of the super-model in the order of the columns' model."""
    there = {n: k for k, n in enumerate(work.super_model.model.parameters)}
    names = {}
    for i, place in enumerate(work.place):
        mine, theirs = work.columns.names[i], work.super_model.names[place]
        names |= {mine[own]: theirs[own] for own in mine}
    values = [p.value for p in work.columns.model.parameters.values()]
    for k, name in enumerate(work.columns.model.parameters):
        position = there.get(names.get(name, name))
        if position is not None:  # a switch stays off
            values[k] = theta[position]
    return np.array(values, dtype=float)


def _is_column(candidate: Candidate) -> bool:
    return not candidate.states


def _pieces(prepared: Sequence[Prepared]) -> list[tuple[int, int, int]]:
    """Cut unbroken stretches into pieces of about equal length, at most `LENGTH` samples."""
    rows = []
    for r, item in enumerate(prepared):
        for first, last in unbroken(item.time):
            count = -(-(last - first) // LENGTH)
            edges = np.linspace(first, last, count + 1).astype(int)
            rows += [(r, int(a), int(b)) for a, b in pairwise(edges)]
    return rows


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of all simple candidates about one path, and what is believed of them.

    Attributes
    ----------
    grams : list of Gram
        By size of the latent force.
    active : tuple of int
        Parameters of the columns' model, in the order of the Gram matrices.
    belief : Belief
    own : dict of int to tuple of int
        Candidate of `columns` to its places among the columns: those of `active`, then trials.
    """

    grams: list[Gram]
    active: tuple[int, ...]
    belief: Belief
    own: dict[int, tuple[int, ...]]
    scales: Scales

    def prior(self, chosen: Sequence[int], theta: np.ndarray) -> Prior:
        """Return the priors of changes of some columns from values of the columns' model."""
        values = np.zeros(len(self.belief.mean))  # a trial is on or off, and was off
        values[: len(self.active)] = theta[list(self.active)]
        return self.belief.about(values).of(chosen)

    def best(self, chosen: Sequence[int], theta: np.ndarray) -> float:
        """Return the log evidence of a set of columns, the latent force of its best size."""
        at, prior = list(chosen), self.prior(chosen, theta)
        try:
            modes = [g.evidence(at, prior) for g in self.grams]
        except np.linalg.LinAlgError:  # columns that are no numbers
            return -np.inf
        return max(m.log_evidence if np.isfinite(m.log_evidence) else -np.inf for m in modes)


def tabled(work: Workspace, theta: np.ndarray, path: np.ndarray) -> Table:
    """Linearise about a path by the constants of all simple candidates at once.

    Parameters
    ----------
    theta : ndarray, shape (parameters of the columns' model,)
    path : ndarray, shape (states of the given model, samples, pieces)
    """
    model, problem = work.columns, work.narrow
    active = list(model.base_index())
    own: dict[int, tuple[int, ...]] = {}
    for i, candidate in enumerate(model.candidates):
        fixed = candidate.fixed_parameter is not None
        indices = model.index(i, coefficients_only=not fixed)
        active += [j for j in indices if j not in active]
        own[i] = tuple(active.index(j) for j in indices)
    local = linearised(problem.simulator, problem.stepping, problem.segments, theta, path, active)
    places = tuple(active.index(j) for j in work.scales.forces)
    size, belief = _beliefs(work, local, active, places, path)
    local, belief, own = _with_trials(work, local, belief, own, theta, path)
    start = work.scales.start[: len(path)]
    scales = replace(work.scales, forces=places, size=size, start=start)
    return Table(grams(local, scales, scales.shares), tuple(active), belief, own, scales)


def _with_trials(
    work: Workspace,
    local: LocalModel,
    belief: Belief,
    own: dict[int, tuple[int, ...]],
    theta: np.ndarray,
    path: np.ndarray,
) -> tuple[LocalModel, Belief, dict[int, tuple[int, ...]]]:
    """Add a column for candidates that have no tangent where they do nothing: limits, dead zones.

    It is what they do at their seed, all or nothing: one is believed as much as the other.
    """
    effect = np.abs(local.by_constant).max((0, 1, 2)) + np.abs(local.reading_by_constant).max(
        (0, 1, 2)
    )
    silent = [i for i, at in own.items() if at and not effect[list(at)].any()]
    silent = [i for i in silent if work.columns.candidates[i].fixed_parameter is None]
    problem, added, read = work.narrow, [], []
    own = dict(own)
    for i in silent:
        seeded = work.columns.switched([i], work.columns.seeded([i], theta))
        args = problem.simulator, problem.stepping, problem.segments, seeded, path
        other = linearised(*args, ())
        change = np.nan_to_num(local.innovation - other.innovation)
        if np.isfinite(other.defect).all():
            own[i] = (len(belief.mean) + len(added),)
            added.append(other.defect - local.defect)
            read.append(change)
    if not added:
        return local, belief, own
    local = replace(
        local,
        by_constant=np.concatenate([local.by_constant, np.stack(added, -1)], axis=-1),
        reading_by_constant=np.concatenate(
            [local.reading_by_constant, np.stack(read, -1)], axis=-1
        ),
    )
    none, one = np.zeros(len(added)), np.ones(len(added))
    belief = Belief(
        np.concatenate([belief.mean, none]),
        np.concatenate([belief.deviation, one]),
        np.concatenate([belief.low, none]),
        np.concatenate([belief.high, UNLIMITED * one]),
    )
    return local, belief, own


def _beliefs(
    work: Workspace,
    local: LocalModel,
    active: Sequence[int],
    places: Sequence[int],
    path: np.ndarray,
) -> tuple[np.ndarray, Belief]:
    """Net forces along the path, and beliefs scaled by them.

    A coefficient is believed to be as large as brings a force as large as the net force, or a
    reading as far away as it varies.
    """
    inside = np.arange(1, path.shape[1])[:, None] < work.narrow.segments.count
    moved = np.sqrt(np.mean(np.diff(path, axis=1)[:, inside] ** 2, axis=1)) + 1e-300
    effect = np.sqrt(np.mean(local.by_constant**2, axis=(0, 1)))
    read = np.sqrt(np.mean(local.reading_by_constant**2, axis=(0, 1)))
    rows = list(work.force_states)
    size = moved[rows] / (effect[rows, list(places)] + 1e-300)
    share = np.sum((effect[rows] / moved[rows, None]) ** 2, axis=0)
    share += np.sum((read / work.narrow.scale[:, None]) ** 2, axis=0)
    deviation = np.where(share > 0.0, 1.0 / np.sqrt(share + 1e-300), 1.0)
    parameters = list(work.columns.model.parameters.values())
    given = set(work.columns.given.free_parameters)
    names = list(work.columns.model.parameters)
    mean, low, high = np.empty((3, len(active)))
    for k, j in enumerate(active):
        value, bounds = parameters[j].value, parameters[j].bounds
        mean[k] = value
        low[k], high[k] = bounds or (-UNLIMITED, UNLIMITED)
        if names[j] in given:
            deviation[k] = (high[k] - low[k]) / np.sqrt(12.0)
        elif bounds is None:  # a fixed value of the given model
            deviation[k] = 0.5 * abs(value) + 1e-12
    return size, Belief(mean, deviation, low, high)
