"""Where a found effect acts: the ranges of a variable, and the times, at which its size counts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.diagnosis.judging.refine import Estimate
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.expressions import Term, evaluate
from jaxsr.models import Model, apply_edit

ACTS = 0.05
"""Size of an effect, relative to its largest in the recordings, from which it is said to act."""
APART = 0.1
"""Distance of neighbouring values at which it acts, over the recorded range, that parts two
ranges; a zero crossing is no gap. What covers all but as much of the range acts everywhere."""

Interval = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Course:
    """Signals along the recordings, samples one after another.

    Attributes
    ----------
    signals : dict of str to ndarray, shape (samples,)
        States, inputs and time in s.
    recording : ndarray of str, shape (samples,)
    """

    signals: dict[str, np.ndarray]
    recording: np.ndarray

    @staticmethod
    def of(model: Model, estimate: Estimate) -> Course:
        """Follow the states that an estimate found, and those of the sensors where it has none.

        The former carry no noise, so that a rate is known where it is small.
        """
        path, segments = estimate.entry.fit.path, estimate.arena.problem.segments
        prepared = estimate.arena.prepared
        states = {s: k for k, s in enumerate(model.states)}
        inside = np.arange(segments.time.shape[0])[:, None] < segments.count
        if path is None or path.shape[1:] != inside.shape or not np.isfinite(path[:, inside]).all():
            time = np.concatenate([p.time for p in prepared])
            x = np.concatenate([p.states.values for p in prepared]).T
            u = np.concatenate([p.inputs for p in prepared]).T
            names = np.repeat([p.recording.name for p in prepared], [p.time.size for p in prepared])
        else:
            time, x, u = segments.time[inside], path[:, inside], segments.inputs[:, inside]
            owner = np.array([p.recording.name for p in prepared])[segments.recording]
            names = np.broadcast_to(owner, inside.shape)[inside]
        signals = {s: x[k] for s, k in states.items()}
        signals |= {name: u[k] for k, name in enumerate(model.inputs)}
        return Course({**signals, model.time: time}, names)


def acting(variable: np.ndarray, size: np.ndarray, largest: float | None = None) -> list[Interval]:
    """Return the ranges of a variable in which an effect acts.

    It acts at a sample where its size is more than `ACTS` of the largest. Values at which it acts
    belong to one range unless they lie farther apart than `APART` of all that was recorded; one
    range that leaves out less than `APART` is all of it.

    Parameters
    ----------
    variable, size : ndarray, shape (samples,)
    largest : float, optional
        Where the samples are a part of all.

    Returns
    -------
    list of (float, float)
        In rising order; none where the effect never acts.
    """
    known = np.isfinite(variable) & np.isfinite(size)
    variable, size = variable[known], np.abs(size[known])
    largest = float(size.max(initial=0.0)) if largest is None else largest
    there = np.sort(variable[size > ACTS * largest])
    if not there.size:
        return []
    low, high = float(variable.min()), float(variable.max())
    breaks = np.flatnonzero(np.diff(there) > APART * (high - low)) + 1
    found = [(float(part[0]), float(part[-1])) for part in np.split(there, breaks)]
    if len(found) == 1 and found[0][1] - found[0][0] >= (1.0 - APART) * (high - low):
        return [(low, high)]
    return found


@dataclass(frozen=True, eq=False)
class Effect:
    """What a candidate does at a moment.

    Attributes
    ----------
    terms : tuple of Term
        Forces that it adds; what it changes in readings.
    variables : tuple of str
        States and inputs over which it is told.
    """

    terms: tuple[Term, ...]
    variables: tuple[str, ...]

    @staticmethod
    def of(
        candidate: Candidate, given: Model, names: Mapping[str, str], values: Mapping[str, float]
    ) -> Effect:
        """Read the effect off a candidate's templates.

        What is no function of the moment (memory, inertia, delays, clocks) has no terms, and is
        told over the variable at whose site it stands. So is what acts on an input, whatever
        stands before it.

        Parameters
        ----------
        names : mapping
            Own name of a constant to its name in the edited model.
        values : mapping
            Parameters of the edited model.
        """
        signals = (*given.states, *given.inputs)
        kind, _, place = candidate.site.partition(":")
        alone = (place,) if place in signals else ()
        if candidate.states or candidate.inertia:
            return Effect((), alone)
        own, terms = tuple(names.values()), []
        for state, template in candidate.terms:
            text = template.format(**names)
            text = f"0 {text}" if text.startswith(("+", "-")) else text
            terms.append(given.term(text, f"force along {state}", own))
        if candidate.readings:
            edit = candidate.edit(given, names, {k: values[name] for k, name in names.items()})
            after, before = apply_edit(given, edit).reading_terms, given.reading_terms
            terms += [Term.apply("sub", after[y], before[y]) for y, _ in candidate.readings]
        told = frozenset().union(*(term.variables for term in terms))
        over = alone if kind == "input" else tuple(s for s in signals if s in told)
        return Effect(tuple(terms), over)

    def size(self, environment: Mapping[str, Any], samples: int) -> np.ndarray:
        """Return the size along a course, relative to the largest; 1 of what is no function."""
        if not self.terms:
            return np.ones(samples)
        total = np.zeros(samples)
        with np.errstate(all="ignore"):
            for term in self.terms:
                own = np.abs(np.broadcast_to(evaluate(term, environment), (samples,)))
                own = np.where(np.isfinite(own), own, 0.0)
                total = np.maximum(total, own / max(own.max(initial=0.0), 1e-300))
        return total


def where_acting(candidate: Candidate, estimate: Estimate, position: int) -> dict[str, Any]:
    """Return region, recordings and times of a finding in the form of docs/files.md.

    A region that is all that was recorded of a variable is marked ``everywhere``; a recording in
    which the effect never acts is left out; times are the first and the last at which it acts.

    Parameters
    ----------
    position : int
        Of the candidate in the estimate.
    """
    given, names = estimate.named.given, estimate.named.names[position]
    values = {n: p.value for n, p in given.parameters.items()}
    values |= {n: estimate.interval(n)[0] for n in estimate.positions}
    course = Course.of(given, estimate)
    found = Effect.of(candidate, given, names, values)
    size = found.size({**values, **course.signals}, course.recording.size)
    size = np.where(np.isin(course.recording, candidate.quiet), 0.0, size)
    region = [
        row for name in found.variables for row in region_rows(name, course.signals[name], size)
    ]
    recordings, times = [], []
    for item in estimate.arena.prepared:
        mine = course.recording == item.recording.name
        time = course.signals[given.time][mine]
        spans = acting(time, size[mine], np.max(size, initial=0.0))
        if spans:
            # what acts all along the samples that were compared acts all along the recording
            whole = spans == [(float(time.min()), float(time.max()))]
            ends = (item.time[0], item.time[-1]) if whole else (spans[0][0], spans[-1][1])
            recordings.append(item.recording.name)
            times.append([float(end) for end in ends])
    return {"region": region, "recordings": recordings, "times": times}


def region_rows(name: str, signal: np.ndarray, size: np.ndarray) -> list[dict[str, Any]]:
    """Return the ranges of a variable as rows of ``where.region``."""
    rows: list[dict[str, Any]] = []
    for low, high in acting(signal, size):
        whole = low <= np.nanmin(signal) and high >= np.nanmax(signal)
        row: dict[str, Any] = {"variable": name, "from": low, "to": high}
        rows.append(row | {"everywhere": True} if whole else row)
    return rows
