"""Sets of terms to start from that need no luck: polynomials thinned out one term at a time."""

from __future__ import annotations

import itertools
import math

import numpy as np

from jaxsr.evolution.config import SearchConfig
from jaxsr.evolution.individual import Problem
from jaxsr.evolution.library import monomials
from jaxsr.expressions.editing import ONE, edit
from jaxsr.expressions.term import Term
from jaxsr.regression.digits import rounded

Terms = tuple[Term, ...]
_MOST = 130  # monomials of a whole basis
_COMMON = 20  # terms of a basis whose subsets are tried,
_ALL = 6  # terms of a basis whose subsets are all kept,
_SUBSET = 4  # the terms of a subset,
_TRIED = 1500  # and the subsets of one size
_COMPLETE = 12  # terms of a basis that shapes are put beside


def bases(problem: Problem, config: SearchConfig) -> list[Terms]:
    """Return all monomials up to degree 1, 2, ... as far as there are rows and room for them."""
    if "mul" not in config.primitives.functions:
        return [(ONE,)]
    variables = [Term.variable(name) for name in problem.variables]
    out: list[Terms] = []
    for degree in range(1, 6):
        if len(variables) ** degree > 40_000:
            break
        parts = itertools.chain.from_iterable(monomials(variables, d) for d in range(degree + 1))
        basis = edit(parts)
        if len(basis) > min(_MOST, problem.rows // 3):
            break
        out.append(basis)
    return out


def complete(problem: Problem, config: SearchConfig) -> list[Terms]:
    """Return the bases small enough to be an individual together with a shape."""
    most = min(_COMPLETE, config.sizes.terms - 1)
    return [basis for basis in bases(problem, config) if len(basis) <= most]


def thinned_bases(problem: Problem, config: SearchConfig) -> list[Terms]:
    """Return the chains of sets that backward elimination makes of every basis."""
    out: list[Terms] = []
    for basis in bases(problem, config):
        out += [terms for terms, _ in problem.eliminate(basis, config.sizes.terms)]
    return list(dict.fromkeys(out))


def best_subsets(problem: Problem, config: SearchConfig, each: int = 6) -> list[Terms]:
    """Return the best few sets of every small size out of terms that laws are often made of.

    Where data are noisy many sets fit alike, and the plain ones among them must not be missing
    from the comparison because a stranger one happened to fit a little better.
    """
    out: list[Terms] = []
    for basis in _common(problem, config):
        usable = [t for t, k in zip(basis, problem.index(basis), strict=True) if k >= 0]
        for size in range(1, min(_SUBSET, config.sizes.terms, len(usable)) + 1):
            if math.comb(len(usable), size) > _TRIED:
                break
            sets = list(itertools.combinations(usable, size))
            _, losses = problem.solve(sets)
            count = len(sets) if len(usable) <= _ALL and size < _SUBSET else each
            out += [sets[k] for k in np.argsort(rounded(losses), kind="stable")[:count]]
    return list(dict.fromkeys(out))


def _common(problem: Problem, config: SearchConfig) -> list[Terms]:
    """Return low monomials, and what joints and springs are made of."""
    functions = set(config.primitives.functions)
    variables = [Term.variable(name) for name in problem.variables]
    out = [basis for basis in bases(problem, config) if len(basis) <= _COMMON]
    parts = [ONE, *variables]
    parts += [Term.apply(f, v) for v in variables for f in ("sin", "cos", "sign") if f in functions]
    if {"mul", "abs"} <= functions:
        parts += [Term.apply("mul", Term.apply("abs", v), v) for v in variables]
    out.append(edit(parts))
    return out
