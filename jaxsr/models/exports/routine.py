"""Formulas as assignments that another program can run: what is used twice is computed once.

A mass matrix that is solved symbolically shares most of its subtrees; written out, a two-link arm
takes pages and a six-link arm does not end.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from jaxsr._result import InputError
from jaxsr.expressions import INTEGRALS, Term, to_sympy
from jaxsr.expressions.primitives import BUILT_IN

_CONDITIONS = frozenset({"lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not"})


@dataclass(frozen=True)
class Routine:
    """Assignments in order, and results that use them.

    Attributes
    ----------
    used : frozenset of str
        Symbols of the model that occur, as they are named here.
    parts, results : tuple of (str, SymPy expression)
    """

    used: frozenset[str]
    parts: tuple[tuple[str, Any], ...]
    results: tuple[tuple[str, Any], ...]


def routine(
    terms: Mapping[str, Term], names: Mapping[str, str], apart: Container[str] = ()
) -> Routine:
    """Return formulas as assignments.

    Parameters
    ----------
    terms : mapping of str to Term
        Results by name.
    names : mapping of str to str
        Symbol to its name in the other program.
    apart : container of str
        Primitives that get an assignment of their own wherever they stand.

    Raises
    ------
    InputError
        A term calls a function that the model grammar does not define.
    """
    counts, order = _counted(terms)
    taken, done = {*names.values()}, dict[Term, Term]()
    parts: list[tuple[str, Any]] = []
    used: set[str] = set()

    def rewritten(node: Term) -> Term:
        if node in done:
            return done[node]
        if node.is_variable:
            used.add(names[node.name])
            return Term.variable(names[node.name])
        return node

    for node in order:
        new = Term(node.op, tuple(rewritten(arg) for arg in node.args))
        repeated = counts[node] > 1 and node.op not in _CONDITIONS and node.op != "neg"
        if repeated or node.op in apart:
            name = unused(f"s{len(parts) + 1}", taken)
            taken.add(name)
            parts.append((name, _formula(new)))
            new = Term.variable(name)
        done[node] = new
    results = tuple((name, _formula(rewritten(term))) for name, term in terms.items())
    return Routine(frozenset(used), tuple(parts), results)


def _counted(terms: Mapping[str, Term]) -> tuple[Counter[Term], list[Term]]:
    """Return how often every subtree is used, and those with arguments, arguments first."""
    counts: Counter[Term] = Counter()
    order: dict[Term, None] = {}
    for name, term in terms.items():
        counts[term] += 1
        for node in term.upward(order):
            if node.op not in BUILT_IN or node.op in INTEGRALS:
                what = f"{name} uses {node.op}, a function without a formula"
                remedy = "Write it out in the model file; to_numpy() and to_jax() run it as it is"
                raise InputError(what, "export", remedy)
            order[node] = None
            counts.update(node.args)
    return counts, list(order)


def _formula(term: Term) -> Any:
    """Return the SymPy expression, no branch of a Piecewise left open."""
    import sympy

    def closed(*branches: Any) -> Any:
        if branches[-1][1] == sympy.true:
            return sympy.Piecewise(*branches, evaluate=False)
        return sympy.Piecewise(*branches, (sympy.nan, True), evaluate=False)

    return to_sympy(term).replace(sympy.Piecewise, closed)


def unused(name: str, taken: Container[str]) -> str:
    """Return a name, with underscores at its end until it is not taken."""
    while name in taken:
        name += "_"
    return name


def renamed(symbols: Iterable[str], reserved: Container[str]) -> dict[str, str]:
    """Return a name for every symbol that is no word of the other language."""
    names: dict[str, str] = {}
    symbols = list(symbols)
    for symbol in symbols:
        others = {*names.values(), *(s for s in symbols if s != symbol)}
        name = symbol
        while name in reserved or name in others:
            name += "_"
        names[symbol] = name
    return names
