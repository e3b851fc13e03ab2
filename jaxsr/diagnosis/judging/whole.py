"""Estimates over whole recordings, where the search worked on a part of them.

Chunk by chunk: each is estimated from where the search ended, and counts by what it tells.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from jaxsr._deadline import OutOfTime, limited
from jaxsr.diagnosis.judging.refine import Estimate
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import Arena, build_arena
from jaxsr.diagnosis.shooting.blocks import column_sizes
from jaxsr.diagnosis.shooting.converters import correlated
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.uncertainty import (
    RANK,
    covariance_of,
    half_widths,
    half_widths_of,
    untold,
)
from jaxsr.diagnosis.thinning import MOST, Whole
from jaxsr.models.segments import Prepared

ITERATIONS = 8
"""Iterations for a chunk: it begins where the search ended."""
PARTS = 12
"""Parts of all recordings whose spread widens the intervals, as many as there are chunks to fill
them."""
GOLDEN = 0.5 * (5.0**0.5 - 1.0)


@dataclass(frozen=True, eq=False)
class Told:
    """What one chunk tells about the active parameters.

    Attributes
    ----------
    hessian : ndarray, shape (parts, active, active)
        Starts projected out.
    gradient : ndarray, shape (parts, active)
    step : ndarray, shape (active,)
        From where the search ended to the chunk's own estimate.
    cost : float
    used, unknowns : int
        Readings, and starts estimated on them.
    length : float
        Neighbouring samples that carry one independent residual.
    """

    hessian: np.ndarray
    gradient: np.ndarray
    step: np.ndarray
    cost: float
    used: int
    unknowns: int
    length: float


@dataclass(frozen=True)
class Piece:
    """Consecutive samples of one recording.

    Attributes
    ----------
    recording : int
    first, last : int
        Its first sample and the one after its last.
    """

    recording: int
    first: int
    last: int

    def __len__(self) -> int:
        return self.last - self.first


Chunk = tuple[Piece, ...]
"""Pieces that are worked on at once: one of a long recording, or several short recordings."""


def prepared_chunk(whole: Whole, chunk: Chunk) -> tuple[Prepared, ...]:
    """Read inputs and outputs of a chunk's pieces and estimate their states."""
    return tuple(
        Prepared.build(
            whole.model,
            whole.recordings[p.recording].select(slice(p.first, p.last)),
            begins=p.first == 0,
        )
        for p in chunk
    )


def chunks(whole: Whole) -> list[Chunk]:
    """Cut and gather all recordings, in an order that is spread over them from the first on.

    Whatever time ends, what was done until then lies evenly over the recordings.
    """
    most, found, filled = max(MOST // len(whole.model.states), 2), list[list[Piece]](), np.inf
    for r, recording in enumerate(whole.recordings):
        count = max(-(-len(recording) // most), 1)
        edges = np.linspace(0, len(recording), count + 1).astype(int)
        for piece in (Piece(r, int(a), int(b)) for a, b in pairwise(edges)):
            filled += len(piece)
            if filled > most:
                found.append([])
                filled = len(piece)
            found[-1].append(piece)
    order = np.argsort((np.arange(len(found)) * GOLDEN) % 1.0)
    return [tuple(found[i]) for i in order]


def over_all(whole: Whole, estimate: Estimate, stop: Callable[[], bool]) -> Estimate:
    """Return an estimate over all recordings, as far as there is time.

    With H_c the Hessian of chunk c and d_c its own step from where the search ended, the step is
    (sum H_c)^-1 sum H_c d_c. What the search took an estimate to lie beside its fit (smoothed
    jumps, other horizons) is kept.
    """
    told, samples = [], 0
    for chunk, found in _told(whole, estimate, stop):
        samples += sum(len(piece) for piece in chunk)
        if found is not None:
            told.append(found)
    active = estimate.entry.fit.active
    if not told or not active.size:
        return estimate
    total = np.sum([t.hessian.sum(0) for t in told], axis=0)
    moment = np.sum([t.hessian.sum(0) @ t.step for t in told], axis=0)
    step = _solved(total, moment)
    used = sum(t.used for t in told)
    cost, unknowns = sum(t.cost for t in told), sum(t.unknowns for t in told)
    length = sum(t.length * t.used for t in told) / used
    variance = cost / max(used - unknowns - active.size, 1.0) * length
    parts = np.concatenate([t.hessian for t in told])
    pulls = np.concatenate(
        [t.gradient + np.einsum("bij,j->bi", t.hessian, t.step - step) for t in told]
    )
    own = half_widths_of(covariance_of(total, variance, (parts, pulls)), len(parts))
    before = half_widths(estimate.arena, estimate.entry.fit)
    low, high = (bound[active] for bound in estimate.arena.bounds)
    theta, half, data = estimate.theta.copy(), estimate.half.copy(), estimate.told.copy()
    theta[active] = np.clip(theta[active] + step, low, high)
    data[active] = np.sqrt(np.maximum(data[active] ** 2 - before**2, 0.0) + own**2)
    half[active] = np.hypot(data[active], untold(estimate.arena, estimate.entry.fit))
    share = samples / whole.samples
    return replace(estimate, theta=theta, half=half, told=data, share=share)


def _told(
    whole: Whole, estimate: Estimate, stop: Callable[[], bool]
) -> Iterator[tuple[Chunk, Told | None]]:
    every, own = chunks(whole), _Own.of(estimate)
    parts = -(-PARTS // len(every))
    for chunk in every:
        if stop():
            return
        try:
            with limited(stop):
                items = prepared_chunk(whole, chunk)
        except OutOfTime:
            return
        place = own.arena(items)
        entry = enter(place, own.members, own.theta, None, stop, ITERATIONS)
        yield chunk, _of(place, entry, own, parts)


@dataclass(frozen=True, eq=False)
class _Own:
    """An estimate in the model of its own mechanisms alone.

    Attributes
    ----------
    estimate : Estimate
    super_model : SuperModel
    members : tuple of int
    theta : ndarray, shape (parameters,)
        Where the search ended.
    order : ndarray of int, shape (active,)
        Where the estimate's active parameters stand.
    """

    estimate: Estimate
    super_model: SuperModel
    members: tuple[int, ...]
    theta: np.ndarray
    order: np.ndarray

    @staticmethod
    def of(estimate: Estimate) -> _Own:
        """Leave out all other mechanisms."""
        old, members, lean = estimate.arena.super_model, estimate.entry.members, estimate.lean
        theta = old.switched(members, estimate.entry.fit.theta)[lean.parameters]
        order = lean.active(estimate.entry.fit.active)
        if len(lean.parameters) == len(old.model.parameters):
            return _Own(estimate, old, members, theta, order)
        alone = SuperModel.build(old.given, [old.candidates[i] for i in members])
        return _Own(estimate, alone, tuple(range(len(members))), theta, order)

    def arena(self, items: tuple[Prepared, ...]) -> Arena:
        """Cut a chunk into segments like those of the search."""
        lean, arena = self.estimate.lean, self.estimate.arena
        seconds = arena.seconds
        if not np.isfinite(seconds):
            seconds = max(float(p.time[-1] - p.time[0]) for p in arena.prepared)
        setting = lean.stepping, seconds, arena.problem.scale, lean.simulator
        return build_arena(self.super_model, items, *setting)


def _of(arena: Arena, entry: Entry, own: _Own, parts: int) -> Told | None:
    """Return what an entry of a chunk tells; None where it could not be estimated."""
    fit = entry.fit
    if not fit.usable:
        return None
    place = {int(j): k for k, j in enumerate(fit.active)}
    order = np.array([place[int(j)] for j in own.order], dtype=int)
    hessian, gradient = fit.normal_equations()
    hessian, gradient = hessian[:, order][:, :, order], gradient[:, order]
    if not (np.isfinite(hessian).all() and np.isfinite(gradient).all()):
        return None
    edges = np.linspace(0, len(hessian), min(parts, len(hessian)) + 1).astype(int)[:-1]
    return Told(
        np.add.reduceat(hessian, edges, axis=0),
        np.add.reduceat(gradient, edges, axis=0),
        (fit.theta - own.theta)[own.order],
        fit.cost,
        int(arena.problem.segments.weights.sum()),
        int(arena.problem.segments.free_start.sum()),
        correlated(fit.residual, arena.converters),
    )


def _solved(total: np.ndarray, moment: np.ndarray) -> np.ndarray:
    """Return the step in the directions of the parameters that leave a trace."""
    size = column_sizes(total)
    scaled = total / size / size[:, None]
    return np.linalg.pinv(scaled, rcond=RANK, hermitian=True) @ (moment / size) / size


__all__ = ["Chunk", "Piece", "chunks", "over_all", "prepared_chunk"]
