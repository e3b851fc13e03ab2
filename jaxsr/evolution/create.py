"""Create terms: every small one, and random ones of ramped size."""

from __future__ import annotations

import itertools

import numpy as np

from jaxsr.evolution.config import PrimitiveSet
from jaxsr.expressions.editing import ONE, edit
from jaxsr.expressions.primitives import PRIMITIVES
from jaxsr.expressions.term import Term


def random_leaf(rng: np.random.Generator, names: list[str], primitives: PrimitiveSet) -> Term:
    """Return a variable, or in one draw of five a constant."""
    if names and rng.random() < 0.8:
        return Term.variable(names[rng.integers(len(names))])
    return Term.constant(round(rng.uniform(*primitives.constants), 3))


def random_term(
    rng: np.random.Generator, names: list[str], primitives: PrimitiveSet, size: int
) -> Term:
    """Return a random term of at most ``size`` nodes."""
    if size <= 1:
        return random_leaf(rng, names, primitives)
    fitting = [f for f in primitives.functions if size > 2 or PRIMITIVES[f].arity == 1]
    if not fitting:
        return random_leaf(rng, names, primitives)
    op = fitting[rng.integers(len(fitting))]
    if op == "pow":
        exponent = Term.constant(float(rng.integers(2, 4)))
        return Term.apply(op, random_term(rng, names, primitives, size - 2), exponent)
    if PRIMITIVES[op].arity == 1:
        return Term.apply(op, random_term(rng, names, primitives, size - 1))
    left = int(rng.integers(1, size - 1))
    return Term.apply(
        op,
        random_term(rng, names, primitives, left),
        random_term(rng, names, primitives, size - 1 - left),
    )


def random_terms(
    rng: np.random.Generator, names: list[str], primitives: PrimitiveSet, size: int, count: int
) -> tuple[Term, ...]:
    """Return the edited terms of one new individual, sizes ramped up to ``size``."""
    drawn = [
        random_term(rng, names, primitives, int(rng.integers(1, size + 1))) for _ in range(count)
    ]
    return edit(drawn)


def small_terms(names: list[str], primitives: PrimitiveSet, most: int = 1500) -> list[Term]:
    """Return the small terms a mechanician would try first, without constants.

    One, the variables, their functions, products of two of these, ratios and cubes; smallest
    first. They seed the population and the library that greedy children draw from.
    """
    variables = [Term.variable(name) for name in names]
    functions = [f for f in primitives.functions if PRIMITIVES[f].arity == 1 and f != "neg"]
    applied = [Term.apply(f, v) for f in functions for v in variables]
    singles = [ONE, *variables, *applied]
    products = [Term.apply("mul", a, b) for a, b in _pairs(variables, variables)]
    mixed = [Term.apply("mul", a, b) for a in variables for b in applied]
    cubes = [Term.apply("mul", a, p) for a in variables for p in products]
    deeper = [Term.apply(f, p) for f in functions for p in products]
    differences = [
        Term.apply(f, Term.apply("sub", a, b))
        for f in functions
        for a, b in itertools.combinations(variables, 2)
    ]
    ratios = [Term.apply("div", a, b) for a in [ONE, *variables] for b in [*variables, *applied]]
    pairs = [Term.apply("mul", a, b) for a, b in _pairs(applied, applied)]
    allowed = [
        *singles,
        *(products + mixed + cubes if "mul" in primitives.functions else []),
        *differences,
        *deeper,
        *(ratios if "div" in primitives.functions else []),
        *(pairs if "mul" in primitives.functions else []),
    ]
    return list(edit(allowed[: 2 * most]))[:most]


def _pairs(first: list[Term], second: list[Term]) -> list[tuple[Term, Term]]:
    return [(a, b) for i, a in enumerate(first) for b in second[i:]]
