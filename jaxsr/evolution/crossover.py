"""Exchange subtrees or constants of individuals (paper section 4.2.1, a)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr.evolution.individual import Individual
from jaxsr.expressions.editing import shorten
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
        grown = theirs[j].size - ours[i].size
        if first.size + grown <= largest and second.size - grown <= largest:
            return first.replace_at(i, theirs[j]), second.replace_at(j, ours[i])
    return first, second


def crossover(
    rng: np.random.Generator, first: Individual, second: Individual, largest: int
) -> list[tuple[Term, ...]]:
    """Return two children; sometimes whole terms change places, which is a subtree at the root.

    Two terms of one node each have no subtree to exchange, so others are drawn where there are
    some. Chains of one function that come about are cut to two links.
    """
    a, b = list(first.terms), list(second.terms)
    for _ in range(_REDO):
        i, j = int(rng.integers(len(a))), int(rng.integers(len(b)))
        if a[i].args or b[j].args:
            break
    if rng.random() < 0.5:
        a[i], b[j] = b[j], a[i]
    else:
        one, other = swap_subtrees(rng, a[i], b[j], largest)
        a[i], b[j] = shorten(one), shorten(other)
    return [tuple(a), tuple(b)]


def cross_constant(
    rng: np.random.Generator, terms: Sequence[Term], best: Sequence[Individual]
) -> tuple[Term, ...]:
    """Give one random constant the value of a random constant of the best set.

    Constants that agree make terms that cancel: individuals get simpler. Terms come back
    unchanged where one side has no constant.
    """
    out = list(terms)
    places = constant_places(out)
    known = [n.value for ind in best for t in ind.terms for n in t.walk() if n.is_constant]
    if places and known:
        k, i = places[rng.integers(len(places))]
        value = known[rng.integers(len(known))]
        out[k] = out[k].replace_at(i, Term.constant(value))
    return tuple(out)


def constant_places(terms: Sequence[Term]) -> list[tuple[int, int]]:
    """Return (term, node) of every constant."""
    return [(k, i) for k, t in enumerate(terms) for i, n in enumerate(t.walk()) if n.is_constant]
