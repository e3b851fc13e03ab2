"""Deciding: which entry of the contest to believe, and how much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr.diagnosis.candidates import Candidate, SuperModel
from jaxsr.diagnosis.contest import MIN_GAIN, Entry, correlation_length, gain, weights

SIGNIFICANCE = 1e-3
"""False-alarm rate per comparison with re-calibration; divided by the candidates screened."""
TIE = 0.2
"""Probability from which an alternative with another verdict makes the case undecided."""


@dataclass(frozen=True)
class Detection:
    """Whether something beats re-calibration on held-back blocks."""

    detected: bool
    log_gain: float
    p: float
    threshold: float


def plausible(super_model: SuperModel, entry: Entry) -> bool:
    """Whether the estimates keep to physics: no bound is touched, Fs is not below Fc."""
    if not np.isfinite(entry.errors).all():
        return False
    order = list(super_model.model.parameters.values())
    for number in entry.members:
        candidate = super_model.candidates[number]
        values = super_model.own_values(number, entry.fit.theta)
        if candidate.mechanism == "stribeck_friction":
            if not values["Fc"] <= values["Fs"] <= 3.0 * values["Fc"] + 1e-12:
                return False
        for spec, index in zip(candidate.parameters, super_model.index(number), strict=False):
            value, parameter = entry.fit.theta[index], order[index]
            low, high = parameter.bounds or (spec.low, spec.high)
            if value <= low or value >= high:
                return False
    return True


def simplest_adequate(entries: Sequence[Entry]) -> Entry:
    """Return the entry with the fewest estimated constants that the best one does not beat.

    An entry stays in the race where the best one's gain over it, block by block, is within one
    standard error (Breiman's rule), or too small to count.
    """
    best = min(entries, key=lambda e: e.error)
    adequate = []
    for entry in entries:
        mean, error, _ = gain(entry.errors, best.errors)
        if entry is best or mean <= max(error, MIN_GAIN):
            adequate.append(entry)
    return min(adequate, key=lambda e: (e.fit.active.size, e.error))


def detect(null: Entry, chosen: Entry, candidates: int) -> Detection:
    """Test an entry against re-calibration alone."""
    mean, _, p = gain(null.errors, chosen.errors)
    threshold = SIGNIFICANCE / max(candidates, 1) * 10.0
    return Detection(mean > MIN_GAIN and p < threshold, mean, p, threshold)


@dataclass(frozen=True)
class Alternative:
    """What could stand in the place of a finding."""

    number: int
    probability: float
    entry: Entry


def alternatives(
    chosen: Entry, number: int, entries: Sequence[Entry], rng: np.random.Generator
) -> tuple[float, list[Alternative]]:
    """Return the probability of one member of the chosen set, and of what could replace it.

    Compared are the chosen set, the set without the member, and sets with one other candidate
    in its place.
    """
    rest = set(chosen.members) - {number}
    rivals = [
        e
        for e in entries
        if e is not chosen
        and rest <= set(e.members)
        and number not in e.members
        and len(e.members) <= len(chosen.members)
    ]
    effective = _independent(chosen)
    share = weights([chosen, *rivals], effective, rng)
    found = []
    for rival, probability in zip(rivals, share[1:], strict=True):
        swapped = set(rival.members) - rest
        if swapped and probability > 5e-4:
            found.append(Alternative(swapped.pop(), float(probability), rival))
    found.sort(key=lambda a: -a.probability)
    return float(share[0]), found


def _independent(entry: Entry) -> float:
    """Independent residuals per block, by the correlation length of the residuals."""
    samples = float(np.count_nonzero(entry.fit.residual))
    return max(samples / correlation_length(entry.fit.residual) / entry.errors.size, 1.0)


def equivalent(a: Candidate, b: Candidate, angle: float) -> bool:
    """Whether two candidates act alike in the sensors (below 3 degrees)."""
    return a.label != b.label and angle < 3.0
