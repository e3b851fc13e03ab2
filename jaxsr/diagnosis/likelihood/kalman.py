"""Kalman filter and smoother of linearised models, many lanes side by side.

A lane is a piece of a recording under one choice of the unknown: pieces, scales of the latent
force and hypotheses are all lanes, so that one pass in time serves all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr._cores import cores, side_by_side, spans
from jaxsr._machine_code import compiled
from jaxsr.diagnosis.likelihood.local import LocalModel
from jaxsr.diagnosis.likelihood.recursions import Choices, filtered, returned
from jaxsr.diagnosis.likelihood.sensor_noise import Noise

FEW = 2
"""Readings up to which one after the other is faster than all at once."""


@dataclass(frozen=True, eq=False)
class Latent:
    """Forces that nobody knows: Ornstein-Uhlenbeck processes on some equations.

    Attributes
    ----------
    entering : ndarray, shape (steps, pieces, states, forces)
        How each of them enters the step map.
    scale : ndarray, shape (forces,)
        Standard deviations; 0 is a model without error.
    decay : float
        Correlation from one sample to the next.
    read : ndarray, shape (samples, pieces, outputs, forces), optional
        How a sensor reads each of them at once, as accelerometers do; not at all by default.
    """

    entering: np.ndarray
    scale: np.ndarray
    decay: float
    read: np.ndarray | None = None

    def of(self, pieces: Sequence[int]) -> Latent:
        """Return the forces of some of the pieces."""
        at = list(pieces)
        read = None if self.read is None else self.read[:, at]
        return replace(self, entering=self.entering[:, at], read=read)

    def first(self, samples: int) -> Latent:
        """Return the forces along the first samples of every piece; at least two."""
        read = None if self.read is None else self.read[:samples]
        return replace(self, entering=self.entering[: samples - 1], read=read)


@dataclass(frozen=True, eq=False)
class Whitened:
    """Innovations of unit variance and their derivatives by the constants.

    Attributes
    ----------
    rows : ndarray, shape (lanes, rows, 1 + constants)
        Innovations at the path's constants, then their derivatives; zero where missing.
    log_determinant : ndarray, shape (lanes,)
        Sum of the logarithms of the innovations' variances.
    count : int
        Samples measured, over the pieces.
    """

    rows: np.ndarray
    log_determinant: np.ndarray
    count: int


@dataclass(frozen=True, eq=False)
class System:
    """State space of one local model with its latent forces; what `whitened` and `smoothed` ask.

    Lanes are choices of scales and noise times pieces; what no choice changes is kept once.

    Attributes
    ----------
    transition : ndarray, shape (steps, pieces, size, size)
        But for the decay of latent forces and coloured noise.
    entering : ndarray, shape (steps, pieces, size, 1 + constants)
    reading : ndarray, shape (samples, pieces, outputs, size)
    measured : ndarray, shape (samples, pieces, outputs, 1 + constants)
    seen : ndarray of bool, shape (samples, pieces, outputs)
    decay : ndarray, shape (choices, 1, size)
        By which states shrink from sample to sample beside the transition.
    start, process : ndarray, shape (choices, 1, size)
        Variances.
    noise : ndarray, shape (choices, 1, outputs)
    """

    transition: np.ndarray
    entering: np.ndarray
    reading: np.ndarray
    measured: np.ndarray
    seen: np.ndarray
    decay: np.ndarray
    start: np.ndarray
    process: np.ndarray
    noise: np.ndarray

    @staticmethod
    def of(
        local: LocalModel, latent: Sequence[Latent], noise: Sequence[Noise], start: np.ndarray
    ) -> System:
        """Join a local model, its latent forces and coloured noise: all are states of one system.

        Parameters
        ----------
        latent : sequence of Latent
            One a choice; they differ by their scales and decays alone.
        noise : sequence of Noise
            One a choice.
        start : ndarray, shape (states,)
            Variances of the states at the start of a piece, about the path.
        """
        steps, pieces, n, p = local.by_constant.shape
        outputs, m, choices = local.innovation.shape[2], len(latent[0].scale), len(noise)
        coloured = np.flatnonzero(np.any([v.coloured for v in noise], axis=0))
        smoothed = np.flatnonzero(np.any([v.poles[1] * v.coloured for v in noise], axis=0))
        known, last = n + m, n + m + len(coloured)
        whole = last + len(smoothed)
        transition = np.zeros((steps, pieces, whole, whole))
        transition[..., :n, :n] = local.by_state
        transition[..., :n, n:known] = latent[0].entering
        transition[..., range(n, whole), range(n, whole)] = 1.0
        entering = np.zeros((steps, pieces, whole, 1 + p))
        entering[..., :n, 0], entering[..., :n, 1:] = local.defect, local.by_constant
        measured = np.zeros((steps + 1, pieces, outputs, 1 + p))
        measured[..., 0], measured[..., 1:] = local.innovation, -local.reading_by_constant
        seen = np.isfinite(local.innovation)
        measured[~seen] = 0.0
        reading = np.zeros((steps + 1, pieces, outputs, whole))
        reading[..., :n] = local.reading
        if latent[0].read is not None:
            reading[..., n:known] = latent[0].read
        reading[..., coloured, range(known, last)] = 1.0
        places = known + np.searchsorted(coloured, smoothed)
        transition[..., places, range(last, whole)] = 1.0
        decay, begun, process = np.ones((choices, whole)), np.zeros((choices, whole)), []
        for k, (force, sensor) in enumerate(zip(latent, noise, strict=True)):
            # A filter starts beside what drives it: their covariance, at rest, fades with its pole.
            first, second = sensor.poles
            inner = np.where(second > 0.0, second, first)[coloured]
            kept = np.concatenate([np.full(m, force.decay), inner, first[smoothed]])
            driven = np.where(second > 0.0, sensor.driving, 0.0)[smoothed]
            variance = np.concatenate([force.scale**2, sensor.coloured[coloured], driven])
            decay[k, n:], begun[k, :n], begun[k, n:] = kept, start, variance
            new = variance * (1.0 - kept**2)
            new[m : m + len(coloured)][second[coloured] > 0.0] = 0.0
            process.append(np.concatenate([np.zeros(n), new]))
        return System(
            transition,
            entering,
            reading,
            measured,
            seen,
            decay[:, None],
            begun[:, None],
            np.array(process)[:, None],
            np.array([v.white for v in noise])[:, None],
        )

    @property
    def plain(self) -> tuple[np.ndarray, ...]:
        """The arrays in the order of the attributes, contiguous; of choices without their axis."""
        shared = self.transition, self.entering, self.reading, self.measured, self.seen
        own = (v[:, 0] for v in (self.decay, self.start, self.process, self.noise))
        return tuple(np.ascontiguousarray(v) for v in (*shared, *own))


def whitened(system: System) -> Whitened:
    r"""Turn residuals and derivatives into independent innovations.

    The gains of the filter do not depend on the constants, so that innovations are linear in
    them: v(c) = v(0) + W c.

    References
    ----------
    Harvey, Forecasting, Structural Time Series Models and the Kalman Filter (1989), 3.4.
    """
    recursion = compiled(filtered)
    if recursion is None:
        return _stepped(system)
    times, pieces, outputs, width = system.measured.shape
    choices = len(system.start)
    rows = np.zeros((choices * pieces, times * outputs, width))
    determinants = np.zeros((choices, pieces))
    by_lane = rows.reshape(choices, pieces, times, outputs, width)
    *shared, decay, start, process, noise = system.plain
    chosen = Choices(decay, start, process, noise)

    def run(span: tuple[int, int]) -> None:
        recursion(*shared, chosen, span, by_lane, determinants)

    side_by_side(run, spans(pieces, cores()))
    return Whitened(rows, determinants.reshape(-1), int(system.seen.sum()))


def _stepped(system: System) -> Whitened:
    """Whiten sample by sample, all lanes at once.

    Few readings of a sample are taken in one after the other, many at once. Spread and mean lie
    side by side in one array, `both`: what reads the one reads the other.
    """
    times, pieces, outputs, width = system.measured.shape
    choices, size = len(system.start), system.start.shape[2]
    both = np.zeros((choices, pieces, size, size + width))
    both[..., :size] = _diagonal(system.start)
    process = _diagonal(system.process)
    shrinking = bool((system.decay != 1.0).any())
    shrunk = np.ones((choices, 1, size, size + width))
    shrunk[..., :size] = system.decay[..., :, None] * system.decay[..., None, :]
    shrunk[..., size:] = system.decay[..., :, None]
    taken = np.zeros((times, pieces, outputs, size + width))
    taken[..., size:] = system.measured
    seen = system.seen.astype(float)
    rows = np.zeros((times, outputs, choices, pieces, width))
    variances = np.ones((times, outputs, choices, pieces))
    for t in range(times):
        taken_in = _at_once if outputs > FEW else _one_by_one
        args = system.reading[t], taken[t], seen[t], system.noise
        try:
            rows[t], variances[t] = taken_in(both, *args)
        except np.linalg.LinAlgError:  # digits were lost in some lane
            rows[t], variances[t] = _one_by_one(both, *args)
        if t + 1 < times:
            move = system.transition[t]
            both = move @ both
            spread = both[..., :size] @ move.swapaxes(-1, -2)
            if shrinking:
                both *= shrunk
                spread *= shrunk[..., :size]
            both[..., size:] += system.entering[t]
            both[..., :size] = 0.5 * (spread + spread.swapaxes(-1, -2)) + process
    shown = system.seen.transpose(0, 2, 1)[:, :, None]
    variances = np.where(shown, variances, 1.0)
    variances = np.where(variances > 0.0, variances, np.nan)  # digits were lost: no answer
    rows *= -(shown / np.sqrt(variances))[..., None]
    return Whitened(
        rows.transpose(2, 3, 0, 1, 4).reshape(choices * pieces, times * outputs, width),
        np.log(variances).sum(axis=(0, 1)).reshape(-1),
        int(system.seen.sum()),
    )


def _one_by_one(
    both: np.ndarray, reading: np.ndarray, taken: np.ndarray, seen: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Take in the readings of a sample one after the other; changes `both`.

    Returns
    -------
    rows : ndarray, shape (outputs, choices, pieces, width)
        What is read less what was measured.
    variances : ndarray, shape (outputs, choices, pieces)
    """
    size, rows, variances = both.shape[2], [], []
    for k in range(reading.shape[1]):
        h = reading[:, k]
        read = h[:, None] @ both
        cross = read[..., 0, :size]
        variance = (cross * h).sum(-1) + noise[..., k]
        read = read - taken[:, None, k]
        gain = cross * (seen[:, k] / variance)[..., None]
        both -= gain[..., None] * read
        rows.append(read[..., 0, size:])
        variances.append(variance)
    return np.stack(rows), np.stack(variances)


def _at_once(
    both: np.ndarray, reading: np.ndarray, taken: np.ndarray, seen: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Take in all readings of a sample by one Cholesky factor; else as `_one_by_one`.

    The factor of the readings' covariance holds on its diagonal the deviations that they have one
    after the other.

    Raises
    ------
    LinAlgError
        Where a covariance has lost its digits.
    """
    size = both.shape[2]
    h = reading * seen[..., None]
    read = h @ both
    own = np.where(seen > 0.0, noise, 1.0)
    factor = np.linalg.cholesky(read[..., :size] @ h.swapaxes(-1, -2) + _diagonal(own))
    white = np.linalg.solve(factor, read - taken)
    both -= white[..., :size].swapaxes(-1, -2) @ white
    deviation = np.diagonal(factor, axis1=-2, axis2=-1)
    rows = white[..., size:] * deviation[..., None]
    return np.moveaxis(rows, 2, 0), np.moveaxis(deviation**2, 2, 0)


def smoothed(system: System, states: int) -> np.ndarray:
    """Return the smoothed deviations from the path, shape (states, samples, pieces).

    Of a system of one choice: the state at every sample given all samples of a piece, by the
    backward recursion of the score: d_t|all = d_t|t-1 + P_t|t-1 r_t.

    References
    ----------
    Durbin and Koopman, Time Series Analysis by State Space Methods (2012), 4.4 and 6.4.
    """
    recursion = compiled(returned)
    if recursion is None:
        return _returned(system, states)
    times, pieces = system.measured.shape[:2]
    result = np.zeros((states, times, pieces))
    *shared, decay, start, process, noise = system.plain
    chosen = Choices(decay, start, process, noise)

    def run(span: tuple[int, int]) -> None:
        recursion(*shared, chosen, span, result)

    side_by_side(run, spans(pieces, cores()))
    return result


def _returned(system: System, states: int) -> np.ndarray:
    """Smooth sample by sample, all pieces at once."""
    times, lanes, outputs, _ = system.measured.shape
    size = system.start.shape[2]
    mean, spread = np.zeros((lanes, size)), np.repeat(_diagonal(system.start[0]), lanes, axis=0)
    process, noise = _diagonal(system.process[0]), system.noise[0]
    moves = system.transition * system.decay[0, 0][:, None]
    means = np.zeros((times, lanes, size))
    spreads = np.zeros((times, lanes, size, size))
    lefts = np.zeros((times, lanes, outputs))
    gains = np.zeros((times, lanes, outputs, size))
    seen = system.seen
    reading = system.reading * seen[..., None]
    own = _diagonal(np.where(seen, noise, 1.0))
    for t in range(times):
        means[t], spreads[t] = mean, spread
        h = reading[t]
        cross = h @ spread
        left = np.where(seen[t], system.measured[t, ..., 0] - (h @ mean[..., None])[..., 0], 0.0)
        right = np.concatenate([cross, left[..., None]], axis=-1)
        solved = np.linalg.solve(cross @ h.swapaxes(-1, -2) + own[t], right)
        gains[t], lefts[t] = solved[..., :-1], solved[..., -1]
        mean = mean + (left[:, None] @ gains[t])[:, 0]
        spread = spread - cross.swapaxes(-1, -2) @ gains[t]
        if t + 1 < times:
            move = moves[t]
            mean = (move @ mean[..., None])[..., 0] + system.entering[t, ..., 0]
            spread = move @ spread @ move.swapaxes(-1, -2) + process
            spread = 0.5 * (spread + spread.swapaxes(-1, -2))
    result = np.zeros((times, lanes, size))
    score = np.zeros((lanes, size))
    for t in reversed(range(times)):
        if t + 1 < times:
            score = (score[:, None] @ moves[t])[:, 0]
        pulled = lefts[t] - (gains[t] @ score[..., None])[..., 0]
        score = score + (pulled[:, None] @ reading[t])[:, 0]
        result[t] = means[t] + (spreads[t] @ score[..., None])[..., 0]
    return result[..., :states].transpose(2, 0, 1)


def _diagonal(values: np.ndarray) -> np.ndarray:
    """Return diagonal matrices, shape (lanes, size, size)."""
    return values[..., None] * np.eye(values.shape[-1])
