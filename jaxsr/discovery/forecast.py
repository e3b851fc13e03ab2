"""Free runs of a written model over windows of recordings, beside the trivial predictions.

A window's start is estimated on its first third; the rest is predicted. Its length is a few of the
correlation times of the output that is judged: long enough that standing still is a bad prediction,
short enough that chaos has not forgotten the start.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from jaxsr._deadline import never
from jaxsr._result import InputError
from jaxsr.models.least_squares import Problem
from jaxsr.models.model import Model
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, build_segments, unbroken
from jaxsr.models.shooting import fit, simulate
from jaxsr.models.simulator import Simulator, width_scales
from jaxsr.models.states import spread
from jaxsr.recordings import Recording

DIVERGED = 10.0
"""Error of a run that diverged, in standard deviations of the output."""
_MEMORY = 6.0  # correlation times of a window, of which two thirds are predicted
_START = 1.0 / 3.0
_SHORTEST = 9  # samples of a window by which a law is judged
_MOST, _MOST_SAMPLES = 300, 6000  # windows of one length, and their samples together
_LONGEST = 1500  # samples of a window
_ITERATIONS = 8  # of the fit of a start
_STEPPINGS = (Stepping("rk4", 1), Stepping("rk4", 4), Stepping("rodas3", 4))
_AGREEMENT = 0.1  # difference of two step sizes' mean squares up to which either is fine enough
_ROUNDING = 1e-18  # mean square relative to an output's variance

Row = tuple[int, int, int]
"""Number of the recording, first sample, end."""


@dataclass(frozen=True, eq=False)
class Forecast:
    """Errors of predictions of one output, window by window.

    Attributes
    ----------
    law, still, mean : ndarray, (samples, windows)
        Error of the model, of the window's last known level and of the recording's mean, in
        standard deviations of the output; NaN where nothing is predicted or measured.
    noise : ndarray, (samples, windows)
        Standard deviation of the sensor's noise, in the same unit.
    rows : tuple of Row
        The windows.
    course : ndarray, (samples, windows)
        What the model simulates from the start of each window, in the output's unit.
    """

    law: np.ndarray
    still: np.ndarray
    mean: np.ndarray
    noise: np.ndarray
    rows: tuple[Row, ...]
    course: np.ndarray

    @property
    def count(self) -> int:
        """Return the number of samples that are predicted."""
        return int(np.count_nonzero(np.isfinite(self.law)))

    @property
    def mse(self) -> float:
        """Return the mean square of the model's error."""
        return mean_square(self.law)

    @property
    def trivial(self) -> float:
        """Return the mean square that the better of the trivial predictions leaves."""
        return min(mean_square(self.still), mean_square(self.mean))

    @property
    def floor(self) -> float:
        """Return the mean square that the sensor's noise leaves of any law."""
        return mean_square(np.where(np.isfinite(self.law), self.noise, np.nan))

    @property
    def independent(self) -> float:
        """Return how many independent samples the model's errors are worth: AR(1) within windows.

        At least one a window, at most one a sample.
        """
        e = np.clip(self.law, -DIVERGED, DIVERGED)
        pairs = np.isfinite(e[1:]) & np.isfinite(e[:-1])
        square = 0.5 * float(np.sum(e[1:][pairs] ** 2 + e[:-1][pairs] ** 2))
        product = float(np.sum(e[1:][pairs] * e[:-1][pairs]))
        memory = float(np.clip(product / square, 0.0, 1.0)) if square > 0.0 else 0.0
        windows = int(np.count_nonzero(np.any(np.isfinite(e), axis=0)))
        return max(self.count * (1.0 - memory) / (1.0 + memory), float(windows))


def mean_square(error: np.ndarray) -> float:
    """Return the mean square of known errors, each at most that of a run that diverged."""
    known = np.isfinite(error)
    if not np.any(known):
        return 0.0
    return float(np.mean(np.clip(error[known], -DIVERGED, DIVERGED) ** 2))


@dataclass(frozen=True, eq=False)
class Readings:
    """Recordings read with a model's roles, and the noise of its outputs.

    Attributes
    ----------
    items : tuple of Prepared
    noise : tuple of ndarray, each (samples, outputs)
    scale : ndarray, (outputs,)
        Standard deviation of every output over all recordings.
    """

    items: tuple[Prepared, ...]
    noise: tuple[np.ndarray, ...]
    scale: np.ndarray

    @staticmethod
    def of(
        model: Model, recordings: Sequence[Recording], noise: Sequence[Mapping[str, np.ndarray]]
    ) -> Readings:
        """Read recordings; ``noise`` holds the levels (samples,) by state of each."""
        items = tuple(Prepared.build(model, r) for r in recordings)
        levels = tuple(
            np.stack(
                [
                    np.broadcast_to(own.get(model.readings[y], np.zeros(1)), (len(r),))
                    for y in model.outputs
                ],
                axis=1,
            )
            for r, own in zip(recordings, noise, strict=True)
        )
        together = np.concatenate([item.outputs for item in items])
        return Readings(items, levels, spread(together))


def window_length(readings: Readings, output: int) -> int:
    """Return the samples of a window: a few times the lag at which the output forgets itself.

    The lag at which the autocorrelation falls below 1/e; the median over recordings.
    """
    lags = [_memory(item.outputs[:, output]) for item in readings.items]
    known = [lag for lag in lags if lag is not None]
    lag = float(np.median(known)) if known else float(_SHORTEST)
    return int(np.clip(round(_MEMORY * lag), _SHORTEST, _LONGEST))


def _memory(y: np.ndarray) -> int | None:
    y = y[np.isfinite(y)]
    if len(y) < 3 or not np.ptp(y) > 0.0:
        return None
    y = y - np.mean(y)
    size = 2 * len(y)
    power = np.abs(np.fft.rfft(y, size)) ** 2
    correlation = np.fft.irfft(power, size)[: len(y)]
    below = np.flatnonzero(correlation < np.exp(-1.0) * correlation[0])
    return int(below[0]) if len(below) else len(y)


def windows(items: Sequence[Prepared], length: int) -> list[Row]:
    """Cut recordings into consecutive windows of nearly ``length`` samples, none across a break."""
    rows = []
    for number, item in enumerate(items):
        for first, last in unbroken(item.time):
            size = last - first
            if size < 3:
                continue
            parts = max(1, size // length)
            edges = np.linspace(first, last, parts + 1).round().astype(int).tolist()
            rows += [(number, a, b) for a, b in pairwise(edges)]
    most = max(1, min(_MOST, _MOST_SAMPLES // length))
    if len(rows) > most:
        rows = [rows[k] for k in np.linspace(0, len(rows) - 1, most).round().astype(int)]
    return rows


def forecast(
    model: Model,
    readings: Readings,
    output: int,
    rows: Sequence[Row],
    expired: Callable[[], bool] = never,
) -> Forecast | None:
    """Run a model over windows and compare one output; None where time ended or nothing runs."""
    simulator = Simulator(model)
    before, found = None, None
    for stepping in _STEPPINGS:
        if expired():
            return found
        run = _run(simulator, readings, rows, stepping, expired)
        if run is None:
            continue
        after = _compared(readings, output, rows, run)
        if before is not None and _agree(before, after):
            return after
        before = after
        if found is None or after.mse < found.mse:
            found = after
    return found


def _agree(before: Forecast, after: Forecast) -> bool:
    return abs(before.mse - after.mse) <= _AGREEMENT * max(after.mse, after.floor, _ROUNDING)


def _run(
    simulator: Simulator,
    readings: Readings,
    rows: Sequence[Row],
    stepping: Stepping,
    expired: Callable[[], bool],
) -> np.ndarray | None:
    """Return the outputs of the windows (outputs, samples, windows), each from its own start."""
    model, none = simulator.model, np.zeros(0, dtype=int)
    theta = np.array(simulator.values(), dtype=float)
    try:
        if simulator.smoothed_arguments:
            stepping = replace(stepping, widths=_widths(simulator, readings, theta))
        segments = build_segments(model, readings.items, rows, stepping.substeps, theta=theta)
        segments = replace(segments, free_start=np.ones_like(segments.free_start))
        known = segments.outputs.copy()
        for place, (_, first, last) in enumerate(rows):
            known[:, _start(last - first) :, place] = np.nan
        begin = Problem(simulator, stepping, replace(segments, outputs=known), readings.scale)
        start = fit(begin, theta, none, (theta, theta), None, _ITERATIONS, expired, 1e-3)
        y = simulate(replace(begin, segments=segments), theta, start.x0)
    except (InputError, ArithmeticError, np.linalg.LinAlgError):
        return None
    return np.asarray(y)


def _widths(simulator: Simulator, readings: Readings, theta: np.ndarray) -> tuple[float, ...]:
    item = max(readings.items, key=lambda item: item.time.size)
    known = simulator.environment(
        item.time, tuple(item.states.values.T), tuple(item.inputs.T), tuple(theta)
    )
    return width_scales(simulator, known)


def _start(size: int) -> int:
    return max(1, int(np.ceil(_START * size)))


def _compared(readings: Readings, output: int, rows: Sequence[Row], run: np.ndarray) -> Forecast:
    longest = run.shape[1]
    tables = {n: np.full((longest, len(rows)), np.nan) for n in ("law", "still", "mean", "noise")}
    scale = float(readings.scale[output])
    for place, (number, first, last) in enumerate(rows):
        y = readings.items[number].outputs[first:last, output]
        begin, size = _start(last - first), last - first
        with np.errstate(all="ignore"):
            error = (run[output, :size, place] - y) / scale
        error[:begin] = np.nan
        error[begin:] = np.where(
            np.isfinite(error[begin:]) | ~np.isfinite(y[begin:]), error[begin:], DIVERGED
        )
        known = y[:begin][np.isfinite(y[:begin])]
        whole = readings.items[number].outputs[:, output]
        if not len(known):
            continue
        level = float(np.mean(known[-2:]))
        there = np.isfinite(error)
        tables["law"][:size, place] = error
        tables["still"][:size, place] = np.where(there, (level - y) / scale, np.nan)
        mean = float(np.nanmean(whole))
        tables["mean"][:size, place] = np.where(there, (mean - y) / scale, np.nan)
        tables["noise"][:size, place] = readings.noise[number][first:last, output] / scale
    return Forecast(rows=tuple(rows), course=run[output], **tables)
