"""Kalman filter and smoother of linearised models, many lanes side by side.

A lane is a piece of a recording under one choice of the unknown: pieces, scales of the latent
force and hypotheses are all lanes, so that one pass in time serves all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxsr.diagnosis.likelihood.local import LocalModel


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


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise of the sensors: white, and correlated from sample to sample.

    Attributes
    ----------
    white, coloured : ndarray, shape (outputs,)
        Variances of the two parts.
    correlation : ndarray, shape (outputs,)
        Of the coloured part, from one sample to the next.
    """

    white: np.ndarray
    coloured: np.ndarray
    correlation: np.ndarray

    def scaled(self, factor: float) -> Noise:
        """Return the noise with all variances multiplied."""
        return Noise(factor * self.white, factor * self.coloured, self.correlation)


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
    """State space of one local model with its latent forces; what `whitened` and `smoothed` ask."""

    transition: np.ndarray
    entering: np.ndarray
    reading: np.ndarray
    measured: np.ndarray
    seen: np.ndarray
    start: np.ndarray
    process: np.ndarray
    noise: np.ndarray

    @staticmethod
    def of(local: LocalModel, latent: Latent, noise: Noise, start: np.ndarray) -> System:
        """Join a local model, its latent forces and coloured noise: all are states of one system.

        Parameters
        ----------
        start : ndarray, shape (states,)
            Variances of the states at the start of a piece, about the path.
        """
        steps, pieces, n, p = local.by_constant.shape
        outputs, m = local.innovation.shape[2], len(latent.scale)
        coloured = np.flatnonzero(noise.coloured)
        known, whole = n + m, n + m + len(coloured)
        decay = np.concatenate([np.full(m, latent.decay), noise.correlation[coloured]])
        variance = np.concatenate([latent.scale**2, noise.coloured[coloured]])
        transition = np.zeros((steps, pieces, whole, whole))
        transition[..., :n, :n] = local.by_state
        transition[..., :n, n:known] = latent.entering
        transition[..., range(n, whole), range(n, whole)] = decay
        entering = np.zeros((steps, pieces, whole, 1 + p))
        entering[..., :n, 0], entering[..., :n, 1:] = local.defect, local.by_constant
        measured = np.zeros((steps + 1, pieces, outputs, 1 + p))
        measured[..., 0], measured[..., 1:] = local.innovation, -local.reading_by_constant
        seen = np.isfinite(local.innovation)
        measured[~seen] = 0.0
        reading = np.zeros((steps + 1, pieces, outputs, whole))
        reading[..., :n] = local.reading
        if latent.read is not None:
            reading[..., n:known] = latent.read
        reading[..., coloured, range(known, whole)] = 1.0
        process = np.concatenate([np.zeros(n), variance * (1.0 - decay**2)])
        return System(
            transition,
            entering,
            reading,
            measured,
            seen,
            np.broadcast_to(np.concatenate([start, variance]), (pieces, whole)),
            np.broadcast_to(process, (pieces, whole)),
            np.broadcast_to(noise.white, (pieces, outputs)),
        )

    @staticmethod
    def joined(systems: list[System]) -> System:
        """Put systems of one shape side by side as further lanes."""

        def together(name: str, axis: int) -> np.ndarray:
            return np.concatenate([getattr(s, name) for s in systems], axis=axis)

        timed = ("transition", "entering", "reading", "measured", "seen")
        return System(
            *(together(name, 1) for name in timed),
            *(together(name, 0) for name in ("start", "process", "noise")),
        )


def whitened(system: System) -> Whitened:
    r"""Turn residuals and derivatives into independent innovations.

    The gains of the filter do not depend on the constants, so that innovations are linear in
    them: v(c) = v(0) + W c. Readings of a sample are taken in one after the other.

    References
    ----------
    Harvey, Forecasting, Structural Time Series Models and the Kalman Filter (1989), 3.4.
    """
    times, lanes, outputs, width = system.measured.shape
    mean = np.zeros((lanes, system.start.shape[1], width))
    spread = _diagonal(system.start)
    process = _diagonal(system.process)
    rows = np.zeros((times, outputs, lanes, width))
    variances = np.ones((times, outputs, lanes))
    for t in range(times):
        for k in range(outputs):
            h, seen = system.reading[t, :, k], system.seen[t, :, k]
            cross = (spread @ h[..., None])[..., 0]
            variance = (cross * h).sum(-1) + system.noise[:, k]
            left = system.measured[t, :, k] - (h[:, None] @ mean)[:, 0]
            rows[t, k] = left * seen[:, None]
            variances[t, k] = np.where(seen, variance, 1.0)
            gain = cross * (seen / variance)[:, None]
            mean = mean + gain[..., None] * left[:, None]
            spread = spread - gain[..., None] * cross[:, None]
        if t + 1 < times:
            move = system.transition[t]
            mean = move @ mean + system.entering[t]
            spread = move @ spread @ move.swapaxes(-1, -2) + process
            spread = 0.5 * (spread + spread.swapaxes(-1, -2))
    variances = np.where(variances > 0.0, variances, np.nan)  # digits were lost: no answer
    rows /= np.sqrt(variances)[..., None]
    return Whitened(
        rows.transpose(2, 0, 1, 3).reshape(lanes, times * outputs, width),
        np.log(variances).sum(axis=(0, 1)),
        int(system.seen.sum()),
    )


def smoothed(system: System, states: int) -> np.ndarray:
    """Return the smoothed deviations from the path, shape (states, samples, lanes).

    The state at every sample given all of a lane's samples, by the backward recursion of the
    score: d_t|all = d_t|t-1 + P_t|t-1 r_t.

    References
    ----------
    Durbin and Koopman, Time Series Analysis by State Space Methods (2012), 4.4 and 6.4.
    """
    times, lanes, outputs, _ = system.measured.shape
    size = system.start.shape[1]
    mean, spread = np.zeros((lanes, size)), _diagonal(system.start)
    process = _diagonal(system.process)
    means = np.zeros((times, lanes, size))
    spreads = np.zeros((times, lanes, size, size))
    lefts = np.zeros((times, outputs, lanes))
    gains = np.zeros((times, outputs, lanes, size))
    for t in range(times):
        means[t], spreads[t] = mean, spread
        for k in range(outputs):
            h, seen = system.reading[t, :, k], system.seen[t, :, k]
            cross = (spread @ h[..., None])[..., 0]
            variance = (cross * h).sum(-1) + system.noise[:, k]
            left = system.measured[t, :, k, 0] - (h * mean).sum(-1)
            gain = cross * (seen / variance)[:, None]
            lefts[t, k], gains[t, k] = np.where(seen, left / variance, 0.0), gain
            mean = mean + gain * left[:, None]
            spread = spread - gain[..., None] * cross[:, None]
        if t + 1 < times:
            move = system.transition[t]
            mean = (move @ mean[..., None])[..., 0] + system.entering[t, ..., 0]
            spread = move @ spread @ move.swapaxes(-1, -2) + process
            spread = 0.5 * (spread + spread.swapaxes(-1, -2))
    result = np.zeros((times, lanes, size))
    score = np.zeros((lanes, size))
    for t in reversed(range(times)):
        if t + 1 < times:
            score = (score[:, None] @ system.transition[t])[:, 0]
        for k in reversed(range(outputs)):
            h = system.reading[t, :, k] * system.seen[t, :, k, None]
            pulled = lefts[t, k] - (gains[t, k] * score).sum(-1)
            score = score + h * pulled[:, None]
        result[t] = means[t] + (spreads[t] @ score[..., None])[..., 0]
    return result[..., :states].transpose(2, 0, 1)


def _diagonal(values: np.ndarray) -> np.ndarray:
    """Return diagonal matrices, shape (lanes, size, size)."""
    return values[..., None] * np.eye(values.shape[-1])
