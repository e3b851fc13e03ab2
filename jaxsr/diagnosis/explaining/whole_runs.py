"""Free runs over whole recordings that are too long to be worked on at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jaxsr._deadline import OutOfTime, never
from jaxsr.diagnosis.judging.whole import chunks, prepared_chunk
from jaxsr.diagnosis.shooting.reduced import Lean
from jaxsr.diagnosis.shooting.scoring import DIVERGED, FreeRun, free_run
from jaxsr.diagnosis.thinning import MOST, Whole
from jaxsr.models.segments import Prepared, cut
from jaxsr.models.states import StateEstimate, input_table, output_table, spread
from jaxsr.recordings import Recording

BEGINNING = 0.05
"""Share of a recording on which its start is estimated."""
TOGETHER = 2
"""Recordings run side by side over their full length, in what a search works on."""


@dataclass(frozen=True, eq=False)
class Scores:
    """Squared errors of one model at one horizon, gathered piece by piece.

    Attributes
    ----------
    squares, count : ndarray, shape (recordings, outputs)
    diverged : ndarray of bool, shape (recordings, outputs)
    simulated : list of ndarray, shape (samples, outputs)
        Empty where no course is kept.
    """

    squares: np.ndarray
    count: np.ndarray
    diverged: np.ndarray
    simulated: list[np.ndarray] = field(default_factory=list)

    @staticmethod
    def of(whole: Whole, kept: bool) -> Scores:
        """Begin with nothing, and keep the course of the outputs if it is `kept`."""
        shape = len(whole.recordings), len(whole.model.outputs)
        sizes = [(len(r), shape[1]) for r in whole.recordings]
        courses = [np.full(size, np.nan) for size in sizes] if kept else []
        return Scores(np.zeros(shape), np.zeros(shape), np.zeros(shape, bool), courses)

    def add(self, recording: int, first: int, run: np.ndarray, measured: np.ndarray) -> None:
        """Count the outputs of a run against readings, both (samples, outputs)."""
        seen = np.isfinite(measured)
        self.diverged[recording] |= (seen & ~np.isfinite(run)).any(0)
        with np.errstate(all="ignore"):
            error = np.where(seen & np.isfinite(run), measured - run, 0.0)
            self.squares[recording] += np.sum(error**2, axis=0)
        self.count[recording] += seen.sum(0)
        if self.simulated:
            self.simulated[recording][first : first + len(run)] = run

    def run(self, scale: np.ndarray) -> FreeRun:
        """Return the errors, relative to the outputs' deviations (recordings, outputs)."""
        known = self.count > 0
        with np.errstate(all="ignore"):
            mse = np.where(known, self.squares / np.maximum(self.count, 1), np.nan)
            relative = np.minimum(mse / scale**2, DIVERGED**2)
        relative = np.where(self.diverged, DIVERGED**2, relative)
        told = known.any(1)
        scores = [float(np.sqrt(np.nanmean(row))) for row in relative[told]]
        nrmse = float(np.mean(scores)) if scores else np.nan
        rmse = np.where(self.diverged, np.inf, np.sqrt(np.nan_to_num(mse, nan=np.inf)))
        return FreeRun(self.simulated, nrmse, rmse)


@dataclass(frozen=True, eq=False)
class Runs:
    """Free runs of some models on recordings.

    Attributes
    ----------
    models : dict of str to list of FreeRun
        Name of a model to its runs, one a horizon.
    recordings : tuple of Recording
    share : float
        Of the samples that there was time for.
    """

    models: dict[str, list[FreeRun]]
    recordings: tuple[Recording, ...]
    share: float = 1.0


Models = Mapping[str, tuple[Lean, np.ndarray]]
"""Name of a model to what runs it and its parameters, in the order of the super-model."""


def whole_horizons(whole: Whole, horizons: Sequence[float]) -> list[float]:
    """Return the horizons of a search and, as the last one, the whole recordings."""
    length = float(np.median([r.time[-1] - r.time[0] for r in whole.recordings]))
    known = [h for h in horizons if h >= 0.999 * length]
    return [*(h for h in horizons if h < 0.999 * length), known[-1] if known else length]


def whole_runs(
    whole: Whole,
    models: Models,
    horizons: Sequence[float],
    headline: float,
    stops: tuple[Callable[[], bool], Callable[[], bool]],
) -> Runs:
    """Run models freely over all recordings, at every horizon.

    Parameters
    ----------
    horizons : sequence of float
        In s; the last one is the whole recording.
    headline : float
        The horizon of which the course is kept.
    stops : pair of callable
        Whether to end the runs over short horizons, and those over whole recordings. The first
        piece of the former is run unless the time of all ends (`jaxsr._deadline.limited`).
    """
    table = {
        (name, h): Scores.of(whole, kept=horizons[h] == headline)
        for name in models
        for h in range(len(horizons))
    }
    samples = 0
    for chunk in chunks(whole):
        stop = stops[0] if samples else never  # what time is left over all is for the first
        if stop():
            break
        try:
            items = prepared_chunk(whole, chunk)
            runs = {h: _all_run(models, items, at, stop) for h, at in enumerate(horizons[:-1])}
        except OutOfTime:
            break
        if stop():  # of models that are compared, none is run further than another
            break
        samples += sum(item.time.size for item in items)
        for h, found in runs.items():
            readings = [_covered(item, horizons[h]) for item in items]
            for name, run in found.items():
                for piece, course, measured in zip(chunk, run.simulated, readings, strict=True):
                    table[name, h].add(piece.recording, piece.first, course, measured)
    stop = stops[1]
    for group in _groups(whole):
        try:
            items = [_begun(whole, r) for r in group]
            runs = _all_run(models, items, None, stop)
        except OutOfTime:
            break
        if stop():
            break
        readings = [_covered(item, None) for item in items]
        for name, run in runs.items():
            for r, course, measured in zip(group, run.simulated, readings, strict=True):
                table[name, len(horizons) - 1].add(r, 0, course, measured)
    scale = np.ones((len(whole.recordings), len(whole.model.outputs)))
    if any(scores.count.any() for scores in table.values()):
        scale = np.array([spread(output_table(whole.model, r)) for r in whole.recordings])
    runs = {name: [table[name, h].run(scale) for h in range(len(horizons))] for name in models}
    return Runs(runs, whole.recordings, samples / whole.samples)


def _all_run(
    models: Models,
    items: Sequence[Prepared],
    horizon: float | None,
    stop: Callable[[], bool],
) -> dict[str, FreeRun]:
    """Run every model freely over some recordings."""
    return {
        name: free_run(own.simulator, own.stepping, items, theta[own.parameters], horizon, (), stop)
        for name, (own, theta) in models.items()
    }


def _covered(item: Prepared, horizon: float | None) -> np.ndarray:
    """Readings of the samples that lie in a segment, NaN for the others."""
    covered = np.zeros(item.time.size, bool)
    for _, first, last in cut((item,), horizon):
        covered[first:last] = True
    return np.where(covered[:, None], item.outputs, np.nan)


def _groups(whole: Whole) -> list[list[int]]:
    """Put recordings of about equal length side by side, as many as memory should hold."""
    most, groups, padded = TOGETHER * MOST // len(whole.model.states), [], 0
    for r in sorted(range(len(whole.recordings)), key=lambda r: len(whole.recordings[r])):
        padded = (len(groups[-1]) + 1) * len(whole.recordings[r]) if groups else np.inf
        if padded > most:
            groups.append([])
        groups[-1].append(r)
    return groups


def _begun(whole: Whole, number: int) -> Prepared:
    """Prepare a recording to be run from its start: states are told where that is estimated."""
    recording = whole.recordings[number]
    model = whole.model
    count = min(max(int(np.ceil(2.0 * BEGINNING * len(recording))), 200), len(recording))
    begin = Prepared.build(model, recording.select(slice(0, count)))
    rest = np.repeat(begin.states.values[-1:], len(recording) - count, axis=0)
    estimate = replace(begin.states, values=np.concatenate([begin.states.values, rest]))
    known = StateEstimate(estimate.values, {}, estimate.hidden)
    inputs, outputs = input_table(model, recording), output_table(model, recording)
    return Prepared(recording, recording.time, inputs, outputs, known)


__all__ = ["Runs", "Scores", "whole_horizons", "whole_runs"]
