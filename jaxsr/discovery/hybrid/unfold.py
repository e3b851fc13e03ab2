"""Laws with signs and sizes, unfolded into modes on either side of zero where that is plainer."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np

from jaxsr.discovery.equation import Equation
from jaxsr.discovery.hybrid.guards import Guard, guard_values, inside, plain
from jaxsr.discovery.hybrid.tree import Node
from jaxsr.discovery.samples import Samples
from jaxsr.expressions.term import Term

_KINKS = frozenset({"abs", "sign"})

Laws = Callable[[Samples, Samples], tuple[dict[str, Equation], bool]]
"""Submodels of samples to learn from and to judge by, and whether they explain them."""


def unfolded(root: Node, train: Samples, judge: Samples, laws: Laws, least: int) -> Node:
    """Return the tree, split at zero of what its laws take the sign or size of, if it is plainer.

    ``a*x + b*Abs(x)`` in one region is two laws written as one. It is written as two where all
    different laws together then have fewer terms, or as many and smaller ones: a friction
    ``sign(v)*f(Abs(v))``, the same in both directions, stays one.
    """
    if not all(leaf.explained for leaf in root.leaves()):
        return root
    for x in _kinked(leaf.laws for leaf in root.leaves()):
        guard = Guard(x, 0.0)
        trial = _cut(root, guard, train, judge, laws, least)
        if trial is None or not all(leaf.explained for leaf in trial.leaves()):
            continue
        if _terms(trial) < _terms(root):
            root = trial
    return root


def _kinked(laws: Iterable[Mapping[str, Equation]]) -> list[Term]:
    """Return what laws take the sign or size of."""
    found: dict[Term, None] = {}
    for table in laws:
        for law in table.values():
            for part in law.terms:
                for node in part.term.walk():
                    if node.op in _KINKS:
                        found.setdefault(node.args[0])
    return list(found)


def _cut(
    node: Node, guard: Guard, train: Samples, judge: Samples, laws: Laws, least: int
) -> Node | None:
    """Return the tree with every leaf that lies on both sides of a guard split by it."""
    if node.below is not None and node.above is not None:
        below = _cut(node.below, guard, train, judge, laws, least)
        above = _cut(node.above, guard, train, judge, laws, least)
        return None if below is None or above is None else replace(node, below=below, above=above)
    part, seen = (s.take(np.flatnonzero(inside(node.region, s.variables))) for s in (train, judge))
    held = guard_values(guard.variable, part.variables) > guard.threshold
    if np.all(held) or not np.any(held):
        return node
    if min(np.count_nonzero(held), np.count_nonzero(~held)) < least:
        return None
    sides = []
    for own in (guard.other, guard):
        rows = part.take(np.flatnonzero(own.holds(part.variables)))
        check = seen.take(np.flatnonzero(own.holds(seen.variables)))
        found, explained = laws(rows, check)
        sides.append(Node(plain((*node.region, own)), found, explained, rows=len(rows)))
    return replace(node, guard=guard, below=sides[0], above=sides[1])


def _terms(root: Node) -> tuple[int, int]:
    """Return the number of terms of all different laws, and of their nodes."""
    distinct: dict[frozenset[tuple[str, Term, float]], tuple[int, int]] = {}
    for leaf in root.leaves():
        key = [
            (state, t.term, float(f"{t.coefficient:.3g}"))
            for state, law in leaf.laws.items()
            for t in law.terms
        ]
        distinct[frozenset(key)] = len(key), sum(term.size for _, term, _ in key)
    return sum(n for n, _ in distinct.values()), sum(n for _, n in distinct.values())
