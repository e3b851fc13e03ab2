"""Alternatives: how probable a finding is, and what could stand in its place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.contest.blocks import gain, weights
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.judging.criteria import (
    credit,
    criterion,
    independent_per_block,
    independent_residuals,
    least_gain,
    penalties,
)
from jaxsr.diagnosis.mechanisms.super_model import SuperModel

TIE = 0.2
"""Probability from which an alternative with another verdict makes the case undecided."""
LIKELIER = 0.5
"""Probability of re-calibration alone from which a single mechanism is not believed."""


@dataclass(frozen=True)
class Alternative:
    """What could stand in the place of a finding."""

    number: int
    probability: float
    entry: Entry


def alternatives(
    super_model: SuperModel,
    chosen: Entry,
    number: int,
    entries: Sequence[Entry],
    rng: np.random.Generator,
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
    share = shares(super_model, [chosen, *rivals], rng)
    found = []
    for rival, probability in zip(rivals, share[1:], strict=True):
        swapped = set(rival.members) - rest
        if swapped:
            found.append(Alternative(swapped.pop(), float(probability), rival))
    n = independent_residuals(chosen)
    found.sort(key=lambda a: (-round(a.probability, 6), criterion(super_model, a.entry, n)))
    own = super_model.candidates[number].label
    best = {own: Alternative(number, float(share[0]), chosen)}
    for alternative in found:
        # Other starts of a mechanism count for it.
        label = super_model.candidates[alternative.number].label
        known = best.setdefault(label, alternative)
        if known is not alternative:
            total = known.probability + alternative.probability
            best[label] = replace(known, probability=total)
    return best.pop(own).probability, list(best.values())


def likelier_without(
    super_model: SuperModel, chosen: Entry, entries: Sequence[Entry], rng: np.random.Generator
) -> bool:
    """Whether blocks held back speak for re-calibration alone, against a single mechanism.

    All readings together may tell a mechanism from noise by chance, or where noise is coloured in
    a way that neighbouring readings do not show.
    """
    if len(chosen.members) != 1:
        return False
    probability, others = alternatives(super_model, chosen, chosen.members[0], entries, rng)
    return 1.0 - probability - sum(a.probability for a in others) > LIKELIER


def without_doubtful(
    super_model: SuperModel,
    chosen: Entry,
    entries: Sequence[Entry],
    allow: Callable[[float], bool],
    rng: np.random.Generator,
) -> Entry:
    """Return a set without members in whose place there may as well be nothing.

    Beside others a mechanism is claimed where the probability that it, or another in its place,
    acts is one that `allow` takes.
    """
    known = {frozenset(e.members): e for e in entries}
    while len(chosen.members) > 1:
        acts = {}
        for number in chosen.members:
            probability, others = alternatives(super_model, chosen, number, entries, rng)
            acts[number] = probability + sum(a.probability for a in others)
        least = min(acts, key=acts.__getitem__)
        rest = known.get(frozenset(chosen.members) - {least})
        if rest is None or allow(acts[least]):
            break
        chosen = rest
    return chosen


def likelier_with(
    super_model: SuperModel, chosen: Entry, entries: Sequence[Entry], rng: np.random.Generator
) -> Entry:
    """Return the set with another mechanism of the same verdict in the place of a member.

    Where blocks held back speak for it, what is stated must be what is likelier.
    """
    candidates = super_model.candidates
    for number in chosen.members:
        _, others = alternatives(super_model, chosen, number, entries, rng)
        for other in others:
            same = candidates[other.number].verdict is candidates[number].verdict
            if same and other.probability > LIKELIER:
                return other.entry
    return chosen


def shares(
    super_model: SuperModel, entries: Sequence[Entry], rng: np.random.Generator
) -> np.ndarray:
    """Probabilities of entries, the chosen one first.

    A richer rival must gain a standard error beside its price, as in `simplest_adequate`. No other
    block tells of what happened once: beside a push, Schwarz's criterion decides.
    """
    passing = any(super_model.candidates[i].passing for e in entries for i in e.members)
    if not passing:
        price = penalties(super_model, entries)
        price += [least_gain(super_model, e) for e in entries]
        price += [_margin(entries[0], e) - credit(super_model, e) for e in entries]
        return weights([e.errors for e in entries], independent_per_block(entries[0]), price, rng)
    n = independent_residuals(entries[0])
    score = np.array([criterion(super_model, e, n) for e in entries])
    share = np.exp(-0.5 * (score - score.min()))
    return share / share.sum()


def _margin(chosen: Entry, rival: Entry) -> float:
    """Return the standard error of a richer rival's gain; 0 for any other."""
    if rival.constants <= chosen.constants:
        return 0.0
    error = gain(chosen.errors, rival.errors)[1]
    return error if np.isfinite(error) else 0.0


def odds(super_model: SuperModel, chosen: Entry, rival: Entry, rng: np.random.Generator) -> float:
    """Return the probability of one entry against another."""
    price = penalties(super_model, [chosen, rival])
    return float(
        weights([chosen.errors, rival.errors], independent_per_block(chosen), price, rng)[0]
    )
