"""Populations of random terms and the data they are evaluated on.

A *random* population is grown from few variables, so that small subtrees recur, as they do in
evolution. In a *distinct* one every lowest operator holds a constant of its own, so that no two
inner nodes are the same expression. No subtree consists of constants alone: nothing can be folded.
"""

from __future__ import annotations

import bisect
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jaxsr.expressions import Term

VARIABLES = tuple(f"x{k + 1}" for k in range(6))
BINARY = ("add", "sub", "mul", "div")
BINARY_WEIGHTS = (0.3, 0.25, 0.35, 0.1)
_CUMULATED = tuple(itertools.accumulate(BINARY_WEIGHTS[:-1]))
UNARY = ("sin", "cos", "exp", "log", "sqrt", "tanh", "abs")
UNARY_SHARE = 0.3
CONSTANT_SHARE = 0.2
MIX = (
    f"sizes uniform from 3 to 15 nodes; where both fit, an operator is unary with probability "
    f"{UNARY_SHARE}, one of {', '.join(UNARY)} alike; else {', '.join(BINARY)} with "
    f"{', '.join(map(str, BINARY_WEIGHTS))}; a leaf is a constant of one decimal in [-5, 5] with "
    f"probability {CONSTANT_SHARE} where a variable stands beside it, else one of "
    f"{len(VARIABLES)} variables; data standard normal"
)


@dataclass(frozen=True)
class Population:
    """Terms with their counts.

    Attributes
    ----------
    name : str
    terms : tuple of Term
    """

    name: str
    terms: tuple[Term, ...]

    @property
    def nodes(self) -> int:
        """Number of nodes, leaves and duplicates counted."""
        return sum(term.size for term in self.terms)

    @property
    def unique_fraction(self) -> float:
        """Unique inner nodes over all inner nodes."""
        inner = [node for term in self.terms for node in term.walk() if node.args]
        return len(set(inner)) / len(inner)

    def first(self, number: int) -> Population:
        """Return the first terms, all if there are no more."""
        return self if number >= len(self.terms) else Population(self.name, self.terms[:number])


def random_population(
    rng: np.random.Generator, number: int, sizes: Sequence[int] = range(3, 16)
) -> Population:
    """Return terms whose subtrees recur (see the module's text)."""
    terms = tuple(_grow(rng, int(n), True) for n in rng.choice(sizes, number))
    return Population("random", terms)


def distinct_population(
    rng: np.random.Generator, number: int, sizes: Sequence[int] = range(3, 16)
) -> Population:
    """Return terms of which no two inner nodes are the same expression."""
    terms = tuple(_grow_distinct(rng, int(n)) for n in rng.choice(sizes, number))
    return Population("distinct", terms)


def samples(rows: int, seed: int = 0) -> NDArray[np.float32]:
    """Return standard normal data (rows, variables) in float32."""
    return np.random.default_rng(seed).normal(size=(rows, len(VARIABLES))).astype(np.float32)


def _variable(rng: np.random.Generator) -> Term:
    return Term.variable(VARIABLES[rng.integers(len(VARIABLES))])


def _binary(rng: np.random.Generator) -> str:
    return BINARY[bisect.bisect(_CUMULATED, rng.random())]


def _constant(value: float) -> Term:
    return Term.constant(float(np.float32(value)))  # exact in float32, so no engine rounds it


def _grow(rng: np.random.Generator, size: int, constant: bool) -> Term:
    """Grow a term of exactly `size` nodes; a leaf may be a constant if told so."""
    if size == 1:
        if constant and rng.random() < CONSTANT_SHARE:
            return _constant(rng.integers(-50, 51) / 10)
        return _variable(rng)
    if size == 2 or rng.random() < UNARY_SHARE:
        return Term.apply(UNARY[rng.integers(len(UNARY))], _grow(rng, size - 1, False))
    left = int(rng.integers(1, size - 1))
    a = _grow(rng, left, True)
    b = _grow(rng, size - 1 - left, not a.is_constant)
    return Term.apply(_binary(rng), a, b)


def _grow_distinct(rng: np.random.Generator, size: int) -> Term:
    """Grow a term of `size` nodes (not 2) whose lowest operators hold a constant each."""
    if size == 1:
        return _variable(rng)
    # one node beside another leaves no room for an operator of two nodes
    splits = [k for k in range(1, size - 1) if k != 2 and size - 1 - k != 2]
    if size > 3 and (not splits or rng.random() < UNARY_SHARE):
        return Term.apply(UNARY[rng.integers(len(UNARY))], _grow_distinct(rng, size - 1))
    left = splits[rng.integers(len(splits))]
    a = _grow_distinct(rng, left)
    b = _constant(rng.uniform(-5, 5)) if size == 3 else _grow_distinct(rng, size - 1 - left)
    return Term.apply(_binary(rng), a, b)
