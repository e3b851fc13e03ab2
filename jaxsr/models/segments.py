"""Segments: pieces of recordings that are simulated side by side, each from its own start."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from jaxsr.models.driven import known_states
from jaxsr.models.hidden import with_hidden
from jaxsr.models.inputs import stage_inputs
from jaxsr.models.model import FREE, Model
from jaxsr.models.states import StateEstimate, estimate_states, input_table, output_table
from jaxsr.models.unfolding import with_signs
from jaxsr.recordings import Recording

SHORTEST = 20
"""Samples of the shortest free run; none goes across a break in the rows that is longer."""
WASHED = 4
"""Margins that a segment must hold before one is spent at a recording's beginning."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A recording with the model's roles read off: what every cut into segments starts from.

    `begins` says whether the experiment does at its first sample, where [initial] holds; a piece
    out of it begins anywhere.
    """

    recording: Recording
    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    states: StateEstimate
    begins: bool = True

    @staticmethod
    def build(model: Model, recording: Recording, begins: bool = True) -> Prepared:
        """Read inputs and outputs and estimate the states."""
        if not begins:
            model = replace(model, initial={})
        inputs, time = input_table(model, recording), recording.time
        told = estimate_states(*with_signs(model, recording))
        measured = output_table(model, recording)
        states = with_hidden(model, told, time, inputs, outputs=measured)
        return Prepared(recording, time, inputs, measured, states, begins)


@dataclass(frozen=True, eq=False)
class Segments:
    """Arrays of equally long, padded segments.

    Padding repeats the last sample with steps of length zero, so that it changes no state, and
    has weight zero.

    Attributes
    ----------
    recording, start, count : ndarray of int, shape (segments,)
        Which recording, first sample, number of samples.
    time : ndarray, shape (samples, segments)
    length : ndarray, shape (samples - 1, substeps, segments)
        Lengths of the steps.
    stages : ndarray, shape (3, inputs, samples - 1, substeps, segments)
        Inputs at start, middle and end of every step.
    inputs : ndarray, shape (inputs, samples, segments)
    outputs : ndarray, shape (outputs, samples, segments)
        Measured; NaN where missing or padded.
    guess : ndarray, shape (states, segments)
        States at the start, from the sensors.
    course : ndarray, shape (states, samples, segments)
        The same along the segments; padding repeats the last sample.
    free_start : ndarray of bool, shape (states, segments)
        False where [initial] gives the state at the start of a recording.
    override : ndarray, shape (parameters, segments)
        Values of [per_recording]; NaN elsewhere.
    """

    recording: np.ndarray
    start: np.ndarray
    count: np.ndarray
    time: np.ndarray
    length: np.ndarray
    stages: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    guess: np.ndarray
    course: np.ndarray
    free_start: np.ndarray
    override: np.ndarray

    @property
    def number(self) -> int:
        """How many segments."""
        return self.start.size

    def coarsened(self, substeps: int) -> Segments:
        """Return the segments with fewer steps between samples, a divisor of their number.

        Inputs are lines or constants between samples, which fewer points draw as well.
        """
        many = self.length.shape[1]
        group = many // substeps
        shape = (self.length.shape[0], substeps, group, self.number)
        inputs = self.stages.reshape(*self.stages.shape[:3], substeps, group, self.number)
        half = group // 2
        middle = inputs[2, :, :, :, half - 1] if group % 2 == 0 else inputs[1, :, :, :, half]
        stages = np.stack([inputs[0, :, :, :, 0], middle, inputs[2, :, :, :, -1]])
        return replace(self, length=self.length.reshape(shape).sum(2), stages=stages)

    def refined(self, factor: int) -> Segments:
        """Return the segments with every step cut into `factor` equal ones.

        Inputs are drawn as parabolas through a step's three stages: exact for lines and constants.
        """

        def at(share: float) -> np.ndarray:
            rest = 1.0 - share
            weights = (rest * (rest - share), 4.0 * share * rest, share * (share - rest))
            return np.tensordot(weights, self.stages, 1)

        shape = (*self.stages.shape[1:3], factor * self.length.shape[1], self.number)
        shares = (np.arange(factor)[:, None] + (0.0, 0.5, 1.0)) / factor
        stages = [np.stack([at(s) for s in column], axis=3).reshape(shape) for column in shares.T]
        length = np.repeat(self.length / factor, factor, axis=1)
        return replace(self, length=length, stages=np.stack(stages))

    @property
    def weights(self) -> np.ndarray:
        """1 where an output is measured, else 0; shape (outputs, samples, segments)."""
        return np.isfinite(self.outputs).astype(float)


def cut(prepared: Sequence[Prepared], horizon: float | None) -> list[tuple[int, int, int]]:
    """Cut recordings into consecutive segments of `horizon` seconds (None: whole recordings).

    Returns (recording, start, stop) rows; a rest shorter than a quarter of a segment, or than
    three samples, is left out. No segment goes across a break in the rows (`unbroken`).
    """
    rows = []
    for r, item in enumerate(prepared):
        parts = _stretches(item)
        for first, last in parts:
            time = item.time[first:last]
            if horizon is None or horizon >= time[-1] - time[0]:
                short = horizon is not None and time[-1] - time[0] <= 0.25 * horizon
                if len(parts) == 1 or not short:
                    rows.append((r, first, last))
                continue
            edges = np.arange(time[0], time[-1], horizon)
            starts = np.searchsorted(time, edges - 1e-9 * horizon)
            for start, stop in zip(starts, [*starts[1:], time.size], strict=True):
                if stop - start >= 3 and time[stop - 1] - time[start] > 0.25 * horizon:
                    rows.append((r, first + int(start), first + int(stop)))
    return rows


def unbroken(time: np.ndarray) -> list[tuple[int, int]]:
    """Return the stretches (start, stop) of rows of which none follows the other far too late.

    Of inputs nothing is known in a break longer than the shortest free run, so that the state
    behind it is another start. Stretches of less than three samples are left out.
    """
    intervals = np.diff(time)
    breaks = np.flatnonzero(intervals > SHORTEST * np.median(intervals)) + 1
    edges = [0, *breaks.tolist(), time.size]
    parts = [(a, b) for a, b in pairwise(edges) if b - a >= 3]
    return parts or [(0, time.size)]


def build_segments(
    model: Model,
    prepared: Sequence[Prepared],
    rows: Sequence[tuple[int, int, int]],
    substeps: int,
    shape: tuple[int, int] = (0, 0),
    theta: np.ndarray | None = None,
    margin: int = 0,
    starts: Sequence[np.ndarray] | None = None,
) -> Segments:
    """Collect the arrays of the segments `rows`.

    `shape` is the least number of samples and of segments: padding recordings of another length
    to one shape lets them share a compiled simulation. Driven states start where parameters
    `theta` (the model's by default) lead them from `starts`, one a recording (rest by default).
    The simulation begins and ends `margin` samples outside the rows where the recording reaches so
    far, so that delayed signals exist all along a row; the outputs there are left out.
    """
    ends = [_stretch(prepared[r], a) for r, a, _ in rows]
    wide = [
        (r, max(a - margin, min(first, a)), max(min(b + margin, last), b))
        for (r, a, b), (first, last) in zip(rows, ends, strict=True)
    ]
    size = max(max(stop - start for _, start, stop in wide), shape[0])
    begun = [None] * len(prepared) if starts is None else starts
    known = [
        known_states(model, item, theta, start=start)
        for item, start in zip(prepared, begun, strict=True)
    ]
    spare = max(shape[1] - len(rows), 0)
    stages = [_stage_table(model, item, substeps) for item in prepared]
    parts: dict[str, list[np.ndarray]] = {
        k: [] for k in "time length stages inputs outputs guess course free over".split()
    }
    driven = np.array([s in model.driven for s in model.states])
    given = driven | np.array([model.initial.get(s, FREE) != FREE for s in model.states])
    over = [values_of(model, item.recording.name) for item in prepared]
    for number, (r, start, stop) in enumerate([*wide, *[wide[-1]] * spare]):
        item = prepared[r]
        pick = np.minimum(np.arange(start, start + size), stop - 1)
        parts["time"].append(item.time[pick])
        steps = np.diff(item.time[pick])
        parts["length"].append(np.repeat(steps[:, None] / substeps, substeps, axis=1))
        gaps = np.minimum(pick[:-1], item.time.size - 2)
        parts["stages"].append(stages[r][:, :, gaps])
        parts["inputs"].append(item.inputs[pick].T)
        measured = item.outputs[pick].T.copy()
        first, last = told(model, item, rows[min(number, len(rows) - 1)], margin)
        measured[:, : first - start] = np.nan
        measured[:, last - start if number < len(rows) else 0 :] = np.nan
        parts["outputs"].append(measured)
        parts["guess"].append(known[r][start])
        parts["course"].append(known[r][pick].T)
        parts["free"].append(~(given if start == 0 and item.begins else driven))
        parts["over"].append(over[r])
    array = {key: np.stack(values, axis=-1) for key, values in parts.items()}
    index = np.array([*wide, *[(*wide[-1][:2], wide[-1][1])] * spare], dtype=int).reshape(-1, 3)
    return Segments(
        recording=index[:, 0],
        start=index[:, 1],
        count=index[:, 2] - index[:, 1],
        time=array["time"],
        length=array["length"],
        stages=array["stages"],
        inputs=array["inputs"],
        outputs=array["outputs"],
        guess=array["guess"],
        course=array["course"],
        free_start=array["free"],
        override=array["over"],
    )


def told(model: Model, item: Prepared, row: tuple[int, int, int], margin: int) -> tuple[int, int]:
    """First and last (exclusive) sample of a row that are judged where signals come late.

    Beyond a recording's ends nothing is known that a sensor could see later.
    """
    _, first, last = row
    begin, end = _stretch(item, first)
    start, stop = max(first - margin, begin), min(last + margin, end)
    if stop - start <= WASHED * margin:
        return first, last
    return start + margin, min(last, end - margin) if model.clock else last


def _stretch(item: Prepared, sample: int) -> tuple[int, int]:
    """First and last (exclusive) sample of the unbroken stretch that holds a sample."""
    parts = _stretches(item)
    return next(((a, b) for a, b in parts if a <= sample < b), (0, item.time.size))


@functools.lru_cache(maxsize=256)
def _stretches(item: Prepared) -> list[tuple[int, int]]:
    return unbroken(item.time)


def _stage_table(model: Model, item: Prepared, substeps: int) -> np.ndarray:
    if not model.inputs:
        return np.zeros((3, 0, item.time.size - 1, substeps))
    tables = [
        stage_inputs(item.time, item.inputs[:, k], model.input_hold, substeps)
        for k in range(len(model.inputs))
    ]
    return np.stack([np.stack(table) for table in tables], axis=1)


def values_of(model: Model, name: str) -> np.ndarray:
    """Parameters of a recording by [per_recording]; NaN for those that hold everywhere."""
    values = [model.per_recording.get(p, {}).get(name, np.nan) for p in model.parameters]
    return np.array(values, dtype=float)


def values_over(theta: np.ndarray, override: np.ndarray) -> list[Any]:
    """Parameter values; an array over the segments where recordings have their own."""
    values: list[Any] = []
    for value, own in zip(theta, override, strict=True):
        given = np.isfinite(own)
        values.append(np.where(given, own, value) if given.any() else float(value))
    return values
