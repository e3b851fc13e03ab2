"""Probabilities of sets of mechanisms that the evidence of the recordings gives."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.judging.alternatives import Alternative
from jaxsr.diagnosis.mechanisms.super_model import SuperModel


@dataclass(frozen=True, eq=False)
class Weights:
    """Probabilities of sets of mechanisms, by labels.

    Attributes
    ----------
    of : dict of frozenset of str to float
    """

    of: dict[frozenset[str], float]

    def share(self, super_model: SuperModel, entry: Entry) -> float:
        """Return the probability of one set."""
        return self.of.get(frozenset(super_model.candidates[i].label for i in entry.members), 0.0)

    def of_label(self, label: str) -> float:
        """Return the probability that a mechanism at its site is part of the truth."""
        return min(sum(p for labels, p in self.of.items() if label in labels), 1.0)

    def of_any(self, labels: Iterable[str]) -> float:
        """Return the probability that at least one of some mechanisms is part of the truth."""
        wanted = frozenset(labels)
        return min(sum(p for known, p in self.of.items() if known & wanted), 1.0)

    def alternatives(
        self, super_model: SuperModel, chosen: Entry, number: int, entries: Sequence[Entry]
    ) -> tuple[float, list[Alternative]]:
        """Return the probability of one member of a set, and of what could replace it."""
        candidates = super_model.candidates
        own = candidates[number].label
        rest = frozenset(candidates[i].label for i in chosen.members if i != number)
        mass: dict[str, Alternative] = {}
        for entry in entries:
            labels = frozenset(candidates[i].label for i in entry.members)
            swapped = labels - rest
            if own in labels or not rest <= labels or len(swapped) != 1:
                continue
            other = next(i for i in entry.members if candidates[i].label in swapped)
            probability = self.of.get(labels, 0.0)
            mass.setdefault(candidates[other].label, Alternative(other, probability, entry))
        return self.of_label(own), sorted(mass.values(), key=lambda a: -a.probability)
