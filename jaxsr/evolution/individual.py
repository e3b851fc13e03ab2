"""An individual: a set of terms with what the regression said about it."""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from jaxsr.expressions.term import Term
from jaxsr.regression.digits import rounded

_PLAIN = frozenset({"neg", "abs", "sign"})


@dataclass(frozen=True, slots=True)
class Individual:
    """A set of terms, weighed.

    Attributes
    ----------
    terms : tuple of Term
    loss : float
        Residual sum of squares relative to the target's.
    size : int
        Complexity of the set, see :func:`complexity`.
    operators : int
        Operators over all terms.
    """

    terms: tuple[Term, ...]
    loss: float
    size: int
    operators: int

    @classmethod
    def of(cls, terms: Sequence[Term], loss: float) -> Individual:
        """Measure a set of terms."""
        return cls(
            tuple(terms),
            float(rounded(loss)),
            complexity(terms),
            sum([term.operators for term in terms]),
        )


def complexity(terms: Iterable[Term]) -> int:
    """Return what a set of terms costs to write down.

    Two for each coefficient; one for each node; one more for each fitted constant (whole numbers
    are taken as given) and for each power above the square; four for each function of the
    variables and seven for a function inside another: sin(cos(x)) is no plainer than x + x**2,
    short as it is.
    """
    return sum(map(_cost, terms))


@functools.lru_cache(maxsize=100_000)
def _cost(term: Term) -> int:
    return 2 + _parts_cost(term, False)


def _parts_cost(term: Term, inside: bool) -> int:
    if term.is_constant:
        return 1 if term.value.is_integer() else 2
    applied = len(term.args) == 1 and term.op not in _PLAIN
    own = 1 + ((7 if inside else 4) if applied else 0)
    if term.op == "pow":
        exponent = term.args[-1]
        whole = exponent.is_constant and exponent.value.is_integer()
        own += max(int(abs(exponent.value)) - 2, 0) if whole else 0
    return own + sum(_parts_cost(arg, inside or applied) for arg in term.args)


def all_usable(problem: Problem, sets: Sequence[Sequence[Term]]) -> list[bool]:
    """Tell for each set whether all of its terms can be used, their columns made in one batch."""
    places = iter(problem.index([term for terms in sets for term in terms]))
    return [-1 not in [next(places) for _ in terms] for terms in sets]


class Problem(Protocol):
    """What a search asks of a regression problem; arrays stay on its side."""

    variables: dict[str, np.ndarray]
    target: np.ndarray
    rows: int
    total: float
    time: str
    timed: bool
    floor: float
    judged_rows: int
    noise: float

    @property
    def expired(self) -> Callable[[], bool]:
        """Whether a step must be left in the middle, by ``OutOfTime``."""
        ...

    @expired.setter
    def expired(self, value: Callable[[], bool]) -> None: ...

    def solve(self, individuals: Sequence[Sequence[Term]]) -> tuple[list[Any], np.ndarray]:
        """Return coefficients of unit-norm columns, and relative losses (inf if unusable)."""
        ...

    def index(self, terms: Sequence[Term]) -> list[int]:
        """Return -1 for each unusable term."""
        ...

    def independent(self, sets: Sequence[Sequence[Term]]) -> list[tuple[Term, ...]]:
        """Return the sets without columns that depend on simpler ones of the same set."""
        ...

    def judge(self, individuals: Sequence[Sequence[Term]]) -> np.ndarray:
        """Return relative losses on validation rows with coefficients from the training rows."""
        ...

    def prune_many(self, sets: Sequence[Sequence[Term]]) -> list[tuple[Term, ...]]:
        """Return the terms of each set that survive hard thresholding."""
        ...

    def dictionary(self, key: Hashable, make: Callable[[], Sequence[Term]]) -> Any:
        """Return candidate columns, made at the first call, whose ``best(terms, count)`` would
        lower the loss most beside ``terms``."""
        ...

    def beam(self, terms: Sequence[Term], width: int) -> list[tuple[Term, ...]]:
        """Return the best pairs and triples of terms, ``width`` of each."""
        ...

    def eliminate(self, terms: Sequence[Term], most: int) -> list[tuple[tuple[Term, ...], float]]:
        """Return the chain of sets that backward elimination makes, at most ``most`` terms."""
        ...

    def refine_many(self, sets: Sequence[Sequence[Term]]) -> list[tuple[tuple[Term, ...], float]]:
        """Return each set with inner constants at a local minimum, and its relative loss."""
        ...

    def quotients(self, frequencies: Sequence[float], count: int) -> list[tuple[Term, ...]]:
        """Return terms over one denominator that explain the target best."""
        ...

    def frequencies(self, terms: Sequence[Term], variable: str, count: int) -> list[float]:
        """Return frequencies of ``variable`` in the residual, the strongest first."""
        ...

    def modulated(
        self, terms: Sequence[Term], variable: str, factors: Sequence[str], count: int
    ) -> list[tuple[str, float]]:
        """Return factors of waves of ``variable`` in the residual, and their frequencies."""
        ...
