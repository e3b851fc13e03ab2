"""Mutation of subtrees, constants and sets of terms (paper section 4.2.1, b)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr.evolution.config import PrimitiveSet, SizeLimits
from jaxsr.evolution.create import random_term
from jaxsr.evolution.crossover import constant_places, cross_constant
from jaxsr.evolution.individual import Individual
from jaxsr.expressions.editing import shorten
from jaxsr.expressions.term import Term

_REDO = 5
_CROSSED = 0.3  # share of constants that are crossed; the paper keeps that inside mutation


def mutate_subtree(
    rng: np.random.Generator,
    terms: Sequence[Term],
    names: list[str],
    primitives: PrimitiveSet,
    sizes: SizeLimits,
) -> tuple[Term, ...]:
    """Replace a random subtree of a random term by a new one of at most the birth size.

    At times the old subtree stays as an argument of the new one. A child over the later size is
    redone; after five tries the parent comes back unchanged.
    """
    out = list(terms)
    k = int(rng.integers(len(out)))
    nodes = list(out[k].walk())
    for _ in range(_REDO):
        new = random_term(rng, names, primitives, int(rng.integers(1, sizes.at_birth + 1)))
        place = int(rng.integers(len(nodes)))
        if rng.random() < 0.3:  # grow
            new = new.replace_at(int(rng.integers(new.size)), nodes[place])
        if out[k].size - nodes[place].size + new.size <= sizes.later:
            out[k] = shorten(out[k].replace_at(place, new))
            break
    return tuple(out)


def mutate_constant(
    rng: np.random.Generator,
    terms: Sequence[Term],
    generation: int,
    vartheta: float,
    best: Sequence[Individual] = (),
) -> tuple[Term, ...]:
    r"""Move one constant by Eq. 7, or cross it with one of the best set.

    .. math:: c_{new} = c_{old} + \frac{2\kappa - \vartheta}{\vartheta + 2j},
              \qquad 0 \le \kappa < \vartheta,

    with generation j. Terms without a constant come back unchanged.
    """
    if best and rng.random() < _CROSSED:
        return cross_constant(rng, terms, best)
    out = list(terms)
    places = constant_places(out)
    if places:
        k, i = places[rng.integers(len(places))]
        kappa = rng.uniform(0.0, vartheta)
        old = list(out[k].walk())[i].value
        value = old + (2.0 * kappa - vartheta) / (vartheta + 2.0 * generation)
        out[k] = out[k].replace_at(i, Term.constant(value))
    return tuple(out)


def simpler_terms(terms: Sequence[Term]) -> list[tuple[Term, ...]]:
    """Return every set in which one node gave way to an argument of its own, or a constant to 0,
    1 or its nearest whole number."""
    out = []
    for k, term in enumerate(terms):
        for i, node in enumerate(term.walk()):
            choices = list(node.args)
            if node.is_constant:
                values = {0.0, 1.0, float(np.round(node.value))} - {node.value}
                choices = [Term.constant(v) for v in sorted(values)]
            for choice in choices:
                out.append((*terms[:k], term.replace_at(i, choice), *terms[k + 1 :]))
    return out
