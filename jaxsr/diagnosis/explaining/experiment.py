"""The next experiment: the excitation that would tell two explanations apart, by simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr._progress import Budget
from jaxsr.diagnosis.explaining.ingredients import Ingredients
from jaxsr.diagnosis.judging.equivalence import equivalent
from jaxsr.diagnosis.judging.weights import Alternative
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.reduced import Lean, lean
from jaxsr.models import Model
from jaxsr.models.lifting import closed, linear
from jaxsr.models.segments import Prepared, build_segments
from jaxsr.models.states import StateEstimate
from jaxsr.recordings import Recording
from jaxsr.report.words import capital, mechanism_at, mechanism_words

SAMPLES, STRIDE = 300, 3
"""Samples of an experiment, each at most so many sample times of the recordings long."""
AMPLITUDES = (0.25, 1.0)
"""Of the largest input recorded, 2 % of the samples apart: an experiment stays inside them."""
PATIENCE = 10.0
"""Seconds after which the best excitation so far is taken, or none: machines may have many inputs,
and laws that jump are slow."""
SHARE = 0.4
"""Share of the time left after which it is taken as well."""
RELEASES = (0.25, 1.0, 2.0)
"""Of the first states recorded, where a machine has no input."""


TOLD_APART = 0.3
"""Separation, in standard deviations a sample, from which an experiment is worth its time."""
LEFT = 0.01
"""Probability below which a rival is rejected: no recording is asked for to do it again."""
_ADVICE = {
    "dissipative": "slow reversals and long runs at constant high speed",
    "elastic": "displacements well beyond those recorded, held at several positions",
    "inertial": "the same motion at another attitude or with faster accelerations",
    "coupling": "one axis moved while the other is held, then the reverse",
    "measurement": "a static calibration of the sensor against a reference",
    "parameter": "a bench measurement of the parameter",
}


@dataclass(frozen=True)
class Experiment:
    """An excitation and what it would show.

    Attributes
    ----------
    text : str
    separation : float
        rms difference of the two explanations in the sensors, in standard deviations of what the
        leading one leaves, after the rival's free parameters have taken what they can.
    """

    text: str
    separation: float


def next_experiment(
    parts: Ingredients, rivals: list[tuple[int, list[Alternative]]], leader: Entry
) -> str | None:
    """Say which recording would separate the leading explanation from its runner-up.

    None where no rival is left, or none that any recording could tell apart.

    Parameters
    ----------
    rivals : list of (int, list of Alternative)
        Candidates of the leader, and what could stand in the place of each.
    """
    model, candidates = parts.case.simulator.model, parts.arena.super_model.candidates
    open_ = [
        (other.probability, number, other)
        for number, others in rivals
        for other in others
        if other.probability >= LEFT
        and not equivalent(model, candidates[number], candidates[other.number])
    ]
    if not open_:
        return None
    _, number, other = max(open_, key=lambda item: item[:2])
    first, second = candidates[number], candidates[other.number]
    names = [mechanism_at(c.label) for c in (first, second)]
    if first.mechanism != second.mechanism and first.site == second.site:
        names = [mechanism_words(c.mechanism) for c in (first, second)]
    found = best_experiment(parts, other.entry, leader)
    if found is not None and found.separation > TOLD_APART:
        return (
            f"Record {found.text}: there {names[0]} and {names[1]}, as estimated, would differ "
            f"by {found.separation:.2g} standard deviations of what is left, sample by sample, "
            "after re-calibration."
        )
    advice = [_ADVICE.get(c.family, "a richer excitation") for c in (first, second)]
    text = " and ".join(dict.fromkeys(advice))
    return f"{capital(text)} would separate {names[0]} from {names[1]}."


def best_experiment(parts: Ingredients, rival: Entry, leader: Entry) -> Experiment | None:
    """Return the excitation under which a rival differs most from the leading set.

    Both sets are simulated as estimated under steps, sines from slow to fast and a sum of sines,
    at two amplitudes, for `SAMPLES` samples, or released from other starts where there is no
    input, for `PATIENCE` seconds at most; None where the simulator is no formula or no simulation
    holds.
    """
    arena = parts.arena
    problem, super_model = arena.problem, arena.super_model
    ours, theirs = (
        lean(super_model, problem.simulator, problem.stepping, e.members) for e in (leader, rival)
    )
    used = np.maximum(problem.segments.weights.sum((1, 2)), 1.0)
    noise = problem.scale * np.sqrt((leader.fit.residual**2).sum((1, 2)) / used)
    best: Experiment | None = None
    left, patience = parts.case.budget.share(SHARE), Budget(PATIENCE)

    def stop() -> bool:
        return left.exhausted or patience.exhausted

    texts, items = zip(*_excitations(parts), strict=True)
    with np.errstate(all="ignore"):
        sizes = _separations(items, (ours, theirs), (leader, rival), noise, stop)
    for text, size in zip(texts, sizes, strict=True):
        if np.isfinite(size) and (best is None or size > best.separation):
            best = Experiment(text, float(size))
    return best


def _excitations(parts: Ingredients) -> Iterator[tuple[str, Prepared]]:
    """Yield experiments in words and as recordings without readings, small ones first."""
    model, prepared = parts.case.simulator.model, parts.case.prepared
    step = float(np.median([p.recording.sample_time for p in prepared]))
    length = float(np.median([p.time[-1] - p.time[0] for p in prepared]))
    time = np.linspace(0.0, min(length, STRIDE * SAMPLES * step), SAMPLES)
    first = np.nan_to_num(np.stack([p.states.values[0] for p in prepared]).mean(0))
    if not model.inputs:
        for factor in RELEASES:
            text = f"a release from {factor:g} times the recorded deflection"
            yield text, _blank(model, time, np.zeros((SAMPLES, 0)), factor * first)
        return
    values = np.concatenate([p.inputs for p in prepared])
    size = np.quantile(np.abs(values), 0.98, axis=0)
    start = np.where([model.kinematic_parent(s) is None for s in model.states], first, 0.0)
    for factor in AMPLITUDES:
        for k, name in enumerate(model.inputs):
            unit, top = model.units.get(name), factor * size[k]
            amount = f"{top:.3g}{' ' + unit if unit else ''}"
            for words, shape in _shapes(time):
                inputs = np.zeros((SAMPLES, len(model.inputs)))
                inputs[:, k] = top * shape
                text = f"{words} of {amount} on {name} for {time[-1]:.3g} s"
                yield text, _blank(model, time, inputs, start)


def _shapes(time: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Yield signals of size one."""
    length = time[-1]
    yield (
        "steps, four times to and fro,",
        np.where(np.floor(8.0 * time / length) % 2 < 1, 1.0, -1.0),
    )
    for turns in (1.0, 3.0, 9.0, 27.0):
        frequency = turns / length
        yield f"a sine at {frequency:.2g} Hz", np.sin(2.0 * np.pi * frequency * time)
    sum_ = sum(np.sin(2.0 * np.pi * n * time / length + n**2) for n in (1, 2, 4, 7, 11, 16))
    yield "a sum of six sines", np.asarray(sum_) / np.abs(sum_).max()


def _blank(model: Model, time: np.ndarray, inputs: np.ndarray, start: np.ndarray) -> Prepared:
    known = np.tile(start, (time.size, 1))
    nothing = np.full((time.size, len(model.outputs)), np.nan)
    estimate = StateEstimate(known, {}, frozenset())
    return Prepared(Recording("experiment", time, {}), time, inputs, nothing, estimate)


def _separations(
    items: Sequence[Prepared],
    sides: tuple[Lean, Lean],
    entries: tuple[Entry, Entry],
    noise: np.ndarray,
    stop: Callable[[], bool],
) -> np.ndarray:
    """Return the rms differences over the noise that the rival's parameters leave.

    Experiments are simulated side by side, as a step costs about the same for all as for one; NaN
    where a simulation does not hold, which is found by halves.
    """
    readings, spread = [], np.zeros((0, 0, 0, 0))
    sizes = np.full(len(items), np.nan)
    for side, entry in zip(sides, entries, strict=True):
        theta = entry.fit.theta[side.parameters]
        near = side.stepping.method == "rk4"  # nothing is known of where a law that jumps leads
        finer = STRIDE if near else 1
        stepping = replace(side.stepping, substeps=finer * side.stepping.substeps)
        rows = [(r, 0, item.time.size) for r, item in enumerate(items)]
        model = side.simulator.model
        segments = build_segments(model, items, rows, stepping.substeps, theta=theta)
        setting = (side.simulator, stepping, segments, theta)
        path = closed(*setting, segments.course, stop, near)
        if path is None:
            if len(items) == 1 or stop():
                return sizes
            middle = len(items) // 2
            halves = items[:middle], items[middle:]
            return np.concatenate([_separations(h, sides, entries, noise, stop) for h in halves])
        place = {int(full): own for own, full in enumerate(side.parameters)}
        active = [place[int(j)] for j in entry.fit.active]
        found = linear(*setting, path, active)
        readings.append(found.outputs / noise[:, None, None])
        spread = found.by_theta / noise[:, None, None]
    for number in range(len(items)):
        difference = (readings[0] - readings[1])[:, :, number].ravel()
        columns = spread[:, :, :, number].reshape(len(spread), -1).T
        if not (np.isfinite(difference).all() and np.isfinite(columns).all()):
            continue
        size = np.linalg.norm(columns, axis=0)
        columns = columns[:, size > 0] / size[size > 0]
        left = difference - columns @ np.linalg.lstsq(columns, difference, rcond=1e-9)[0]
        sizes[number] = np.sqrt(np.mean(left**2))
    return sizes
