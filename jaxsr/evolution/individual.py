"""An individual: a set of terms with what the regression said about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from jaxsr.expressions.term import Term


@dataclass(frozen=True, slots=True)
class Individual:
    """A set of terms, weighed.

    Attributes
    ----------
    terms : tuple of Term
    loss : float
        Residual sum of squares relative to the target's.
    size : int
        Complexity: one for each coefficient and one for each node.
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
            float(loss),
            sum(1 + term.size for term in terms),
            sum(term.operators for term in terms),
        )


class Problem(Protocol):
    """What a search asks of a regression problem; arrays stay on its side."""

    variables: dict[str, np.ndarray]
    rows: int
    total: float
    time: str

    def solve(self, individuals: Sequence[Sequence[Term]]) -> tuple[list[Any], np.ndarray]:
        """Return coefficients of unit-norm columns, and relative losses (inf if unusable)."""
        ...

    def index(self, terms: Sequence[Term]) -> list[int]:
        """Return -1 for each unusable term."""
        ...

    def prune(self, terms: Sequence[Term]) -> tuple[Term, ...]:
        """Return the terms that survive hard thresholding."""
        ...

    def screen(self, terms: Sequence[Term], count: int) -> list[Term]:
        """Return known terms that would lower the loss most beside ``terms``."""
        ...

    def refine(self, terms: Sequence[Term]) -> tuple[tuple[Term, ...], float]:
        """Return the terms with inner constants at a local minimum, and the relative loss."""
        ...

    def frequencies(self, terms: Sequence[Term], variable: str, count: int) -> list[float]:
        """Return frequencies of ``variable`` in the residual, the strongest first."""
        ...
