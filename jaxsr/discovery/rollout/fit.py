"""Constants of a system by least squares on its roll-outs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.special import stdtrit

from jaxsr._deadline import OutOfTime, never
from jaxsr.discovery.rollout.segments import Segments
from jaxsr.discovery.rollout.simulate import simulate
from jaxsr.discovery.rollout.system import System

_STEP = 1e-6  # of forward differences, relative
_ZERO = 1e-3  # of a constant's natural size: below it a step relative to itself is too short
_ITERATIONS = 20
_SMALL_GAIN = 1e-4  # a step that lowers the loss by less is the last


@dataclass(frozen=True, eq=False)
class RolloutFit:
    """Constants and segment starts at a minimum of the roll-out error.

    Attributes
    ----------
    constants : ndarray, (constants,)
    starts : ndarray, (states, segments)
    loss : float
        Mean square of the error over the noise: about one where only noise is left.
    held_back : ndarray, (segments,)
        Sum of squares of every segment with the constants that the others give, to first order.
    covariance : ndarray, (constants, constants)
        Of the constants, scaled by the loss.
    count : int
        Measured samples.
    """

    constants: np.ndarray
    starts: np.ndarray
    loss: float
    held_back: np.ndarray
    covariance: np.ndarray
    count: int

    def ci95(self) -> np.ndarray:
        """Return 95 % intervals (constants, 2)."""
        free = max(self.count - len(self.constants) - self.starts.size, 1)
        half = stdtrit(free, 0.975) * np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return np.column_stack([self.constants - half, self.constants + half])


@dataclass(frozen=True, eq=False)
class _Point:
    constants: np.ndarray
    starts: np.ndarray
    residual: np.ndarray  # (segments, rows)
    by_constant: np.ndarray  # (segments, rows, constants)
    by_start: np.ndarray  # (segments, rows, states)

    @property
    def loss(self) -> float:
        return float(np.sum(self.residual**2))


def fit_rollout(
    system: System,
    segments: Segments,
    constants: np.ndarray,
    *,
    time: str,
    starts: np.ndarray | None = None,
    substeps: int = 1,
    iterations: int = _ITERATIONS,
    expired: Callable[[], bool] = never,
) -> RolloutFit | None:
    """Estimate constants and every segment's start; None where the system cannot be followed.

    Levenberg-Marquardt; the starts are eliminated segment by segment (Schur complement), so that
    many segments cost no more than one.
    """
    rates = system.function()
    if starts is None:
        starts = np.stack([segments.values[s][0] for s in system.states])

    def at(constants: np.ndarray, starts: np.ndarray) -> _Point | None:
        way = partial(simulate, rates, system.states, time, segments, expired=expired)
        try:
            return _point(way, system.states, segments, constants, starts, substeps, floors)
        except OutOfTime:
            return None

    constants = np.asarray(constants, dtype=np.float64)
    floors = _floors(system, segments, constants, time)
    point = at(constants, starts)
    if point is None:
        return None
    damping = 1e-3
    for _ in range(iterations):
        if expired():
            break
        step = _solved(point, damping)
        after = None if step is None else at(point.constants + step[0], point.starts + step[1])
        if after is None or not after.loss < point.loss:
            damping *= 10.0
            if damping > 1e5:
                break
            continue
        fall = 1.0 - after.loss / point.loss
        point, damping = after, max(damping / 10.0, 1e-9)
        if fall < _SMALL_GAIN:
            break
    return _finished(point, segments, system.states)


def fine_enough(
    system: System,
    segments: Segments,
    fitted: RolloutFit,
    *,
    time: str,
    most: int = 16,
    expired: Callable[[], bool] = never,
) -> int:
    """Return the steps between samples at which the method's error is no part of the misfit.

    Steps are doubled until halving them once more changes the path by less than a tenth of the
    fit's own error.

    Raises
    ------
    OutOfTime
        Once ``expired()``.
    """
    rates = system.function()
    constants, starts = fitted.constants[None], fitted.starts[:, None, :]

    def path(steps: int) -> np.ndarray:
        whole = simulate(
            rates, system.states, time, segments, constants, starts, steps, expired=expired
        )
        return whole[:, :, 0]

    steps, coarse = 1, path(1)
    while steps < most:
        fine = path(2 * steps)
        apart = [
            (fine[:, k] - coarse[:, k]) / segments.noise[s]
            for k, s in enumerate(system.states)
            if s in segments.noise
        ]
        if np.nanmean(np.square(apart)) <= 0.01 * fitted.loss:
            break
        steps, coarse = 2 * steps, fine
    return steps


def _floors(system: System, segments: Segments, constants: np.ndarray, time: str) -> np.ndarray:
    """Return the sizes below which constants count as zero for a forward difference.

    A coefficient's is a thousandth of that with which its term alone would make up the state's
    change from sample to sample: in SI units of a cell count or a pressure, 1e-9 may be a lot.
    """
    floors = np.full(len(constants), _ZERO)
    rates = system.function()
    values = {**segments.values, time: segments.time}
    step = np.diff(segments.time, axis=0)
    parts = system.unpacked(constants)
    for row, state in enumerate(system.states):
        change = _rms(np.diff(values[state], axis=0) / step)
        for _, _, place in parts[state]:
            alone, none = constants.copy(), constants.copy()
            alone[place.start], none[place.start] = 1.0, 0.0
            with np.errstate(all="ignore"):
                term = np.asarray(rates(values, alone)[row]) - np.asarray(rates(values, none)[row])
                size = _rms(term)
            floor = _ZERO * change / size if size > 0.0 else np.nan
            if np.isfinite(floor) and floor > 0.0:
                floors[place.start] = floor
    return floors


def _rms(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else np.nan


def _point(
    simulated: Callable[..., np.ndarray],
    states: Sequence[str],
    segments: Segments,
    constants: np.ndarray,
    starts: np.ndarray,
    substeps: int,
    floors: np.ndarray,
) -> _Point | None:
    """Simulate the base and one copy for every constant and start; None if the base diverges."""
    count, width = len(constants), len(states)
    copies = 1 + count + width
    moved = np.repeat(constants[None], copies, axis=0)
    steps = _STEP * np.maximum(np.abs(constants), floors)
    moved[1 + np.arange(count), np.arange(count)] += steps
    begin = np.repeat(starts[:, None, :], copies, axis=1)
    least = 1e-6 * np.array([segments.size(s) for s in states])
    shifts = _STEP * np.maximum(np.max(np.abs(starts), axis=1), least)
    begin[np.arange(width), 1 + count + np.arange(width)] += shifts[:, None]
    out = simulated(moved, begin, substeps)
    rows, slopes = [], []
    for place, state in enumerate(states):
        if state not in segments.measured:
            continue
        measured, noise = segments.measured[state], segments.noise[state]
        known = np.isfinite(measured)
        path = out[:, place]  # (samples, copies, segments)
        if not np.all(np.isfinite(path[:, 0][known])):
            return None
        error = np.where(known, (path[:, 0] - np.nan_to_num(measured)) / noise, 0.0)
        slope = np.where(known[:, None], (path - path[:, :1]) / noise[:, None], 0.0)[:, 1:]
        rows.append(error.T)
        slopes.append(np.nan_to_num(slope, posinf=0.0, neginf=0.0).transpose(2, 0, 1))
    slope = np.concatenate(slopes, axis=1)
    by_constant = slope[:, :, :count] / steps
    by_start = slope[:, :, count:] / shifts
    return _Point(constants, starts, np.concatenate(rows, axis=1), by_constant, by_start)


def _solved(point: _Point, damping: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the damped Gauss-Newton steps of the constants and of the starts."""
    a, b, r = point.by_start, point.by_constant, point.residual
    own = np.einsum("sri,srj->sij", a, a)
    own += _diagonal(own, damping)
    cross = np.einsum("sri,srk->sik", a, b)
    gradient = np.einsum("sri,sr->si", a, r)
    whole = np.einsum("srk,srl->kl", b, b)
    whole += np.diag(damping * np.diag(whole) + 1e-300)
    right = np.einsum("srk,sr->k", b, r)
    try:
        solved = np.linalg.solve(own, np.concatenate([cross, gradient[:, :, None]], axis=2))
        schur = whole - np.einsum("sik,sil->kl", cross, solved[:, :, :-1])
        move = np.linalg.solve(schur, right - np.einsum("sik,si->k", cross, solved[:, :, -1]))
    except np.linalg.LinAlgError:
        return None
    starts = solved[:, :, -1] - solved[:, :, :-1] @ move
    if not (np.all(np.isfinite(move)) and np.all(np.isfinite(starts))):
        return None
    return -move, -starts.T


def _diagonal(matrices: np.ndarray, damping: float) -> np.ndarray:
    size = matrices.shape[-1]
    return np.eye(size) * (damping * np.einsum("sii->si", matrices) + 1e-12)[:, :, None]


def _widened(covariance: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Scale the covariance up to what the constants vary by from stretch to stretch.

    ``moves`` (constants, segments): what each stretch pulls the constants by. Errors that are
    alike all through a stretch, an input's between samples or a missing term's, are no noise.
    """
    count = moves.shape[1]
    if count < 4:
        return covariance
    between = np.sum(moves**2, axis=1) * count / (count - 1.0)
    within = np.maximum(np.diag(covariance), 1e-300)
    scale = np.sqrt(np.maximum(between / within, 1.0))
    return covariance * np.outer(scale, scale)


def _finished(point: _Point, segments: Segments, states: Sequence[str]) -> RolloutFit:
    a, b, r = point.by_start, point.by_constant, point.residual
    basis = np.linalg.qr(a)[0]
    b = b - basis @ np.einsum("sri,srk->sik", basis, b)
    r = r - np.einsum("sri,si->sr", basis, np.einsum("sri,sr->si", basis, r))
    information = np.einsum("srk,srl->kl", b, b)
    inverse = np.linalg.pinv(information, rcond=1e-12, hermitian=True)
    held = np.empty(segments.count)
    for k in range(segments.count):  # r without this segment: (I - B N^-1 B')^-1 r
        smaller = b[k].T @ b[k]
        lead = np.eye(len(smaller)) - inverse @ smaller
        try:
            change = np.linalg.solve(lead, inverse @ (b[k].T @ r[k]))
        except np.linalg.LinAlgError:
            change = np.zeros(len(smaller))
        held[k] = float(np.sum((r[k] + b[k] @ change) ** 2))
    count = sum(
        int(np.count_nonzero(np.isfinite(segments.measured[s])))
        for s in states
        if s in segments.measured
    )
    free = max(count - len(point.constants) - point.starts.size, 1)
    covariance = inverse * max(point.loss / free, 0.0)
    covariance = _widened(covariance, inverse @ np.einsum("srk,sr->sk", b, r).T)
    return RolloutFit(point.constants, point.starts, point.loss / free, held, covariance, count)
