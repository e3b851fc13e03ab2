"""Create terms: random ones of ramped size."""

from __future__ import annotations

import itertools

import numpy as np

from jaxsr.evolution.config import PrimitiveSet, whole_between
from jaxsr.expressions.editing import ONE, edit
from jaxsr.expressions.primitives import PRIMITIVES
from jaxsr.expressions.term import Term


def random_leaf(rng: np.random.Generator, names: list[str], primitives: PrimitiveSet) -> Term:
    """Return a variable in four draws of five, else a constant or, at times, 1 (Eq. 4)."""
    kind = rng.random()
    if names and kind < 0.8:
        return Term.variable(names[rng.integers(len(names))])
    return ONE if kind > 0.96 else Term.constant(_drawn(rng, primitives.constants))


def _drawn(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    """Return a number of four digits inside the bounds."""
    value = float(f"{rng.uniform(*bounds):.4g}")
    return min(max(value, bounds[0]), bounds[1])


def random_exponent(rng: np.random.Generator, primitives: PrimitiveSet) -> Term:
    """Return a whole or, in the share ``real_exponents``, a real exponent."""
    if rng.random() < primitives.real_exponents:
        return Term.constant(_drawn(rng, primitives.exponents))
    whole = whole_between(*primitives.exponents)
    return Term.constant(float(whole[rng.integers(len(whole))]))


def random_term(
    rng: np.random.Generator, names: list[str], primitives: PrimitiveSet, size: int
) -> Term:
    """Return a random term of at most ``size`` nodes."""
    fitting = [f for f in primitives.functions if _arguments(f) < size]
    if not fitting:
        return random_leaf(rng, names, primitives)
    op = fitting[rng.integers(len(fitting))]
    if op == "pow":
        base = random_term(rng, names, primitives, size - 2)
        return Term.apply(op, base, random_exponent(rng, primitives))
    shares = _shares(rng, size - 1, _arguments(op))
    return Term.apply(op, *(random_term(rng, names, primitives, share) for share in shares))


def _shares(rng: np.random.Generator, nodes: int, count: int) -> list[int]:
    """Divide the nodes left among arguments, at least one for each."""
    if count == 1:
        return [nodes]
    if count == 2:
        first = int(rng.integers(1, nodes))
        return [first, nodes - first]
    cuts = sorted(int(c) for c in rng.choice(range(1, nodes), count - 1, replace=False))
    return [b - a for a, b in itertools.pairwise([0, *cuts, nodes])]


def _arguments(name: str) -> int:
    arity = PRIMITIVES[name].arity
    return 2 if arity == -1 else arity


def random_terms(
    rng: np.random.Generator, names: list[str], primitives: PrimitiveSet, size: int, count: int
) -> tuple[Term, ...]:
    """Return the edited terms of one new individual, sizes ramped up to ``size``."""
    drawn = [
        random_term(rng, names, primitives, int(rng.integers(1, size + 1))) for _ in range(count)
    ]
    return edit(drawn)
