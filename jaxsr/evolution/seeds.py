"""Sets of terms to start from that need no luck: polynomials thinned out one term at a time."""

from __future__ import annotations

import itertools

from jaxsr.evolution.config import SearchConfig
from jaxsr.evolution.individual import Problem
from jaxsr.evolution.library import monomials
from jaxsr.expressions.editing import ONE, edit
from jaxsr.expressions.term import Term

Terms = tuple[Term, ...]
_MOST = 130  # monomials of a whole basis
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
