"""Exchange subtrees of two individuals (paper section 4.2.1, a)."""

from __future__ import annotations

import numpy as np

from jaxsr.evolution.individual import Individual
from jaxsr.expressions.term import Term

_REDO = 5


def swap_subtrees(
    rng: np.random.Generator, first: Term, second: Term, largest: int
) -> tuple[Term, Term]:
    """Exchange one random subtree of each term; redone where a child has over ``largest`` nodes.

    After five tries the parents come back unchanged.
    """
    ours, theirs = list(first.walk()), list(second.walk())
    for _ in range(_REDO):
        i, j = int(rng.integers(len(ours))), int(rng.integers(len(theirs)))
        a = first.replace_at(i, theirs[j])
        b = second.replace_at(j, ours[i])
        if a.size <= largest and b.size <= largest:
            return a, b
    return first, second


def crossover(
    rng: np.random.Generator, first: Individual, second: Individual, largest: int
) -> list[tuple[Term, ...]]:
    """Return two children; sometimes whole terms change places, which is a subtree at the root."""
    a, b = list(first.terms), list(second.terms)
    i, j = int(rng.integers(len(a))), int(rng.integers(len(b)))
    if rng.random() < 0.5:
        a[i], b[j] = b[j], a[i]
    else:
        a[i], b[j] = swap_subtrees(rng, a[i], b[j], largest)
    return [tuple(a), tuple(b)]
