"""What the evidence tells of sets of mechanisms: their probabilities, and of their constants."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jaxsr.diagnosis.judging.refine import Estimate
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.uncertainty import NORMAL


@dataclass(frozen=True)
class Alternative:
    """What could stand in the place of a finding."""

    number: int
    probability: float
    entry: Entry


@dataclass(frozen=True, eq=False)
class Weights:
    """Probabilities of sets of mechanisms, by labels.

    Attributes
    ----------
    of : dict of frozenset of str to float
    deviations : mapping of (str, str) to float
        Posterior deviations of the leading set's constants, by label and by their own names.
    renamed : mapping of str to str
        Labels of richer laws that count as the simpler ones inside them.
    """

    of: dict[frozenset[str], float]
    deviations: Mapping[tuple[str, str], float] = field(default_factory=dict)
    renamed: Mapping[str, str] = field(default_factory=dict)

    @staticmethod
    def summed(
        told: Iterable[tuple[frozenset[str], float]], renamed: Mapping[str, str] | None = None
    ) -> Weights:
        """Return weights of sets: those of variants of one set, and of what counts as it, added."""
        found = Weights({}, renamed=renamed or {})
        for labels, probability in told:
            known = found.counted(labels)
            found.of[known] = found.of.get(known, 0.0) + probability
        return found

    def counted(self, labels: Iterable[str]) -> frozenset[str]:
        """Return labels as they count."""
        return frozenset(self.renamed.get(label, label) for label in labels)

    def share(self, super_model: SuperModel, entry: Entry) -> float:
        """Return the probability of one set."""
        return self.of.get(self._of_entry(super_model, entry), 0.0)

    def _of_entry(self, super_model: SuperModel, entry: Entry) -> frozenset[str]:
        return self.counted(super_model.candidates[i].label for i in entry.members)

    def _around(self, labels: frozenset[str]) -> frozenset[str]:
        """Return the most probable set that holds all of these."""
        return max((s for s in self.of if labels <= s), key=self.of.__getitem__, default=labels)

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
        """Return the probability of one member of a set, and of what could replace it.

        The chosen set may leave out members that hardly show in free runs: those of the most
        probable set that holds it replace nothing.
        """
        candidates = super_model.candidates
        own = candidates[number].label
        labels = self._of_entry(super_model, chosen)
        around, rest = self._around(labels), labels - {own}
        first = {self._of_entry(super_model, entry): entry for entry in reversed(entries)}
        mass: dict[str, Alternative] = {}
        for labels in sorted(first, key=lambda known: -self.of.get(known, 0.0)):
            swapped = labels - around
            if own in labels or not rest <= labels or len(swapped) != 1:
                continue
            entry, p = first[labels], self.of.get(labels, 0.0)
            other = next(i for i in entry.members if self.counted([candidates[i].label]) == swapped)
            known = mass.setdefault(candidates[other].label, Alternative(other, 0.0, entry))
            mass[candidates[other].label] = replace(known, probability=known.probability + p)
        return self.of_label(own), sorted(mass.values(), key=lambda a: -a.probability)

    def told_of(self, estimate: Estimate) -> Estimate:
        """Return an estimate with intervals of constants that leave no trace in its free runs.

        These may have been told where signals that come late are not judged, at the ends of
        recordings.
        """
        half, super_model = estimate.half.copy(), estimate.arena.super_model
        order = list(super_model.model.parameters)
        for i in estimate.entry.members:
            for own, full in super_model.names[i].items():
                k, known = order.index(full), (super_model.candidates[i].label, own)
                if half[k] == 0.0 and known in self.deviations:
                    half[k] = NORMAL * self.deviations[known]
        told = np.where(estimate.half == 0.0, half, estimate.told)
        return replace(estimate, half=half, told=told)
