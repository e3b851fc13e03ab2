"""The motion that re-calibration follows beside forces that nobody knows.

It tells what candidates are made from, whether or not a sensor reads every state: how far states
go, and what is missing along every equation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis, hypothesis
from jaxsr.diagnosis.likelihood.kalman import System, smoothed
from jaxsr.diagnosis.likelihood.limits import censored
from jaxsr.diagnosis.likelihood.local import LocalModel, linearised
from jaxsr.diagnosis.likelihood.response import Response
from jaxsr.diagnosis.likelihood.table import Table, tabled
from jaxsr.diagnosis.likelihood.workspace import Workspace, along, in_columns
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.inertial import inertial
from jaxsr.diagnosis.mechanisms.motion import Motion
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import NARROWEST, half_width_of, sample_step, state_scale
from jaxsr.diagnosis.weak.weak_grid import WeakGrid
from jaxsr.models import Model
from jaxsr.models.segments import Prepared

UNSEEN = 10.0
"""Samples for which a force that nobody knows keeps its sign, where the sensors do not tell."""


@dataclass(frozen=True, eq=False)
class Course:
    """What re-calibration shows.

    Attributes
    ----------
    prepared : tuple of Prepared
        Recordings with the states that re-calibration follows, hidden ones included.
    null : Hypothesis
        Re-calibration alone.
    motion : Motion
        Signals, and the force that is missing along every equation.
    size : dict of str to float
        State to the rms of its net force.
    seconds : float
        How long a force that nobody knows keeps its sign.
    response : callable
        Makes what forces along the equations do to the readings: for many candidates alone.
    """

    prepared: tuple[Prepared, ...]
    null: Hypothesis
    motion: Motion
    size: dict[str, float]
    seconds: float
    response: Callable[[], Response]


def followed(
    model: Model, prepared: Sequence[Prepared], stop: Callable[[], bool] = lambda: False
) -> Course | None:
    """Re-calibrate beside unknown forces; None where nothing finite comes of it, or not in time.

    Parameters
    ----------
    stop : callable
        Whether time is over.
    """
    width = half_width_of(prepared)
    seconds = UNSEEN * sample_step(prepared) if width is None else 0.5 * width
    forces = SuperModel.build(model, _forces(model, prepared))
    work = Workspace.build(forces, prepared, seconds, stop=stop)
    null = hypothesis(work, tabled(work, work.theta, work.narrow.segments.course), ())
    if null is None or stop():
        return None
    known = along(work, null.path)
    table = tabled(work, null.theta, null.path, null.noise, null.decay)
    sizes = zip(work.force_states, table.scales.size, strict=True)
    size = {model.states[s]: max(float(v), 1e-300) for s, v in sizes}
    motion = _motion(work, null, table, known, width or 0.0)
    return Course(known, null, motion, size, seconds, partial(_response, work, null, table))


def _response(work: Workspace, null: Hypothesis, table: Table) -> Response:
    """Return what forces along the equations do about re-calibration's path."""
    local, count = _by_forces(work, null), len(work.scales.forces)
    scales = replace(table.scales, forces=tuple(range(count)), noise=null.noise, decay=null.decay)
    states = tuple(work.columns.given.states[s] for s in work.force_states)
    edges = np.cumsum([0, *(p.time.size for p in work.prepared)])
    deviation = table.belief.deviation[list(table.base)]
    return Response(local, scales, null.share, states, work.rows, edges, deviation)


def _by_forces(work: Workspace, found: Hypothesis) -> LocalModel:
    """Linearise by a force along each equation, then by the free parameters."""
    problem, theta = work.narrow, in_columns(work, found.theta)
    active = [*work.scales.forces, *work.columns.base_index()]
    args = problem.simulator, problem.stepping, problem.segments, theta, found.path
    return linearised(*args, active)


def _forces(model: Model, prepared: Sequence[Prepared]) -> list[Candidate]:
    """Return a constant force along every equation of motion."""
    sites = sites_of(model, state_scale(model, prepared))
    return [c for s in sites for c in inertial(s) if c.mechanism == "constant_force"]


def _motion(
    work: Workspace, null: Hypothesis, table: Table, prepared: Sequence[Prepared], width: float
) -> Motion:
    """Return signals along the course, and the smoothed forces, seen through narrow windows."""
    model = work.columns.given
    forces, columns = left_over(work, null, table)
    narrow = max(width / 3.0, NARROWEST * max(float(np.median(np.diff(p.time))) for p in prepared))
    grid = WeakGrid.build(model, prepared, narrow)
    names = [model.time, *model.states, *model.inputs]
    rows = [[p.time, *p.states.values.T, *p.inputs.T] for p in prepared]
    signals = {
        n: np.concatenate(parts) for n, parts in zip(names, zip(*rows, strict=True), strict=True)
    }
    residual, basis = {}, {}
    for k, index in enumerate(work.force_states):
        state = model.states[index]
        residual[state] = grid.integrate(whole(work, prepared, forces[k]))
        told = np.zeros((len(residual[state]), len(columns[k])))
        if told.size:
            told = grid.integrate(np.stack([whole(work, prepared, c) for c in columns[k]], -1))
        basis[state] = _orthonormal(told)
    return Motion(
        signals={**signals, "t": signals[model.time]},
        recordings=tuple(p.recording.name for p in prepared),
        edges=grid.edges,
        integrate=grid.integrate,
        centre=grid.centre,
        spacing=narrow / 4.0,
        residual=residual,
        basis=basis,
    )


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of columns."""
    if not columns.size:
        return columns[:, :0]
    left, strength, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, strength > 1e-9 * strength.max(initial=1e-300)]


def left_over(work: Workspace, found: Hypothesis, table: Table) -> tuple[np.ndarray, np.ndarray]:
    """Return the forces that a set leaves, smoothed, and what re-calibration can do beside them.

    Parameters
    ----------
    found : Hypothesis
        Of members without states of their own.
    table : Table
        About it.

    Returns
    -------
    forces : ndarray, shape (forces, samples, pieces)
    columns : ndarray, shape (forces, free parameters, samples, pieces)
    """
    work = censored(work, found.members, found.theta, found.path)
    problem, free = work.narrow, list(work.columns.base_index())
    local, m = _by_forces(work, found), len(work.scales.forces)
    scales = replace(table.scales, forces=tuple(range(m)))
    share = found.share or float(scales.shares[1])
    latent = scales.latent(local, share)
    moved = local.moved(np.zeros(m + len(free)))
    system = System.of(moved, [latent], [scales.noise], scales.start)
    n = len(found.path)
    forces = smoothed(system, n + m)[n:]
    own = [local.by_constant[:, :, s, k] for k, s in enumerate(work.force_states)]
    columns = np.zeros((m, len(free), *found.path.shape[1:]))
    for k, s in enumerate(work.force_states):
        size = np.where(own[k] == 0.0, np.inf, own[k])
        columns[k, :, :-1] = np.moveaxis(local.by_constant[:, :, s, m:], -1, 0) / size
    count = problem.segments.count
    return _at_samples(forces, count), _at_samples(columns, count)


def _at_samples(held: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return at the samples what acts in the steps from each to the next.

    Parameters
    ----------
    held : ndarray, shape (..., samples, pieces)
        A step's value in the place of its first sample.
    count : ndarray, shape (pieces,)
        Samples of the pieces.
    """
    found = held.copy()
    found[..., 1:, :] = 0.5 * (held[..., 1:, :] + held[..., :-1, :])
    pieces = np.arange(len(count))
    found[..., count - 1, pieces] = held[..., count - 2, pieces]  # no step leaves the last
    return found


def whole(work: Workspace, prepared: Sequence[Prepared], pieces: np.ndarray) -> np.ndarray:
    """Return a signal of the pieces, shape (samples, pieces), along all recordings; else zero."""
    found = [np.zeros(p.time.size) for p in prepared]
    segments = work.narrow.segments
    for k, (r, start, count) in enumerate(
        zip(segments.recording, segments.start, segments.count, strict=True)
    ):
        found[r][start : start + count] = pieces[:count, k]
    return np.concatenate(found)
