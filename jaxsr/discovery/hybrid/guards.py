"""Guards: the conditions on states, inputs and time under which a mode holds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr.discovery.samples import Roles
from jaxsr.expressions import number_text, to_numpy, to_text
from jaxsr.expressions.term import Term

_MOST_PAIRED = 6  # states of one kind whose differences are tried as guards


@dataclass(frozen=True, slots=True)
class Guard:
    """A bound on one expression: ``variable > threshold``, or ``variable <= threshold``.

    Attributes
    ----------
    variable : Term
        Of states, inputs and time.
    threshold : float
        In the unit of the variable.
    above : bool
    """

    variable: Term
    threshold: float
    above: bool = True

    def holds(self, variables: Mapping[str, np.ndarray]) -> np.ndarray:
        """Tell on which samples the guard holds (samples,)."""
        values = guard_values(self.variable, variables)
        return values > self.threshold if self.above else values <= self.threshold

    @property
    def term(self) -> Term:
        """Return the condition as a term."""
        op = "gt" if self.above else "le"
        return Term.apply(op, self.variable, Term.constant(self.threshold))

    @property
    def other(self) -> Guard:
        """Return the guard of the other side."""
        return Guard(self.variable, self.threshold, not self.above)

    def __str__(self) -> str:
        """Return the condition in the model grammar."""
        sign = ">" if self.above else "<="
        return f"{to_text(self.variable)} {sign} {number_text(self.threshold)}"


Region = tuple[Guard, ...]
"""All of these hold; an empty one holds everywhere."""


def inside(region: Region, variables: Mapping[str, np.ndarray]) -> np.ndarray:
    """Tell which samples lie in a region (samples,)."""
    held = np.ones(len(next(iter(variables.values()))), dtype=bool)
    for guard in region:
        held &= guard.holds(variables)
    return held


def plain(region: Region) -> Region:
    """Return the region with one bound from each side for each variable, the tightest."""
    tight: dict[tuple[Term, bool], Guard] = {}
    for guard in region:
        key = (guard.variable, guard.above)
        old = tight.get(key)
        if old is None or (guard.threshold > old.threshold) == guard.above:
            tight[key] = guard
    return tuple(tight.values())


def region_term(regions: Sequence[Region]) -> Term:
    """Return the condition that any of the regions holds."""
    parts = [_joined("and", [guard.term for guard in plain(region)]) for region in regions]
    return _joined("or", parts)


def _joined(op: str, parts: Sequence[Term]) -> Term:
    if not parts:
        return Term.boolean(True)
    return parts[0] if len(parts) == 1 else Term.apply(op, *parts)


def guard_values(variable: Term, variables: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return a guard's expression on samples (samples,)."""
    count = len(next(iter(variables.values())))
    return np.broadcast_to(to_numpy(variable)(variables), (count,))


def guard_variables(
    part: Roles,
    kinds: Sequence[Sequence[str]],
    variables: Mapping[str, np.ndarray],
    *,
    timed: bool = True,
) -> list[Term]:
    """Return the expressions that a switch may hang on, the plainest first.

    States, inputs, sums and differences of two states of one kind (a gap between two bodies),
    the size of each where it takes both signs, and time.

    Parameters
    ----------
    part : Roles
    kinds : sequence of sequence of str
        States that have one unit: displacements, velocities.
    variables : mapping of str to ndarray, (samples,)
    timed : bool
        Whether time is one of them.
    """
    singles = [Term.variable(name) for name in (*part.states, *part.inputs)]
    pairs = list(_pairs(kinds))
    out = list(singles)
    for term in (*singles, *pairs):
        if term not in out:
            out.append(term)
        values = guard_values(term, variables)
        if np.min(values) < 0.0 < np.max(values):
            out.append(Term.apply("abs", term))
    if timed and not part.autonomous:
        out.append(Term.variable(part.time))
    return [term for term in out if np.ptp(guard_values(term, variables)) > 0.0]


def _pairs(kinds: Sequence[Sequence[str]]) -> Iterator[Term]:
    for names in kinds:
        for place, first in enumerate(names[:_MOST_PAIRED]):
            for second in names[place + 1 : _MOST_PAIRED]:
                both = Term.variable(first), Term.variable(second)
                yield Term.apply("sub", *both)
                yield Term.apply("add", *both)
