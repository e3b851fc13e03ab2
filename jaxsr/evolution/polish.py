"""Local search around the Pareto front: constants, frequencies, fewer and simpler terms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import compress

import numpy as np

from jaxsr.evolution.config import SearchConfig
from jaxsr.evolution.front import Front
from jaxsr.evolution.individual import Individual, Problem, all_usable
from jaxsr.evolution.mutate import simpler_terms
from jaxsr.expressions.editing import edit
from jaxsr.expressions.term import Term
from jaxsr.regression.digits import rounded

Terms = tuple[Term, ...]
_EXACT = 1e-18  # relative loss at which two fits are both exact to rounding
NEAR = 1e-3  # distance from a whole number, relative to the larger of it and one
CONSTANT_BITS, UNTOLD = (12, 24), 1e-3
"""Binary digits of constants, the fewest first; rise of the loss that tells nothing, in that by
which it falls on average with a constant that explains nothing."""
_TRIED = 10  # simplifications of one individual whose constants are refined


def has_constants(terms: Iterable[Term]) -> bool:
    """Tell whether any term holds a constant that is not a bare one."""
    return any(node.is_constant for term in terms if term.args for node in term.walk())


def promising(
    ranked: Sequence[Individual],
    front: Front,
    refined: frozenset[Terms],
    count: int,
    rows: int,
) -> list[Terms]:
    """Choose the sets whose constants to refine: by fitness, from the front, by description."""
    fresh = [i for i in ranked if i.terms not in refined and has_constants(i.terms)]
    length = {id(i): rows * np.log(i.loss + _EXACT) + i.size * np.log(rows) for i in fresh}
    by_length = sorted(fresh, key=lambda i: length[id(i)])
    on_front = [i for i in front.members if i.terms not in refined and has_constants(i.terms)]
    mixed = [*on_front[-count // 3 :], *by_length[: count // 2], *fresh[: count // 2]]
    return list(dict.fromkeys(i.terms for i in mixed))[:count]


def settled(problem: Problem, moved: Sequence[tuple[Terms, float]]) -> list[tuple[Terms, float]]:
    """Leave refined constants the digits that data tell, and whole numbers where they lie next.

    x**1.9999998 and x**2 fit alike; only the latter can be multiplied out, and only it is a law.
    """
    moved = shortened(problem, moved)
    out = list(moved)
    near = [
        k
        for k, (terms, loss) in enumerate(moved)
        if np.isfinite(loss) and _with_whole_numbers(terms)
    ]
    whole = [edit(_with_whole_numbers(moved[k][0])) for k in near]
    trials = shortened(problem, problem.refine_many(whole))
    for k, (terms, loss) in zip(near, trials, strict=True):
        allowed = max(moved[k][1] * (1.0 + 4.0 / problem.rows), 4.0 * problem.floor)
        if loss <= allowed:
            out[k] = terms, loss
    return out


def _with_whole_numbers(terms: Terms) -> Terms:
    """Return the terms with constants next to whole numbers rounded; empty if there are none."""
    changed = tuple(_whole(term) if term.args else term for term in terms)
    return changed if changed != terms else ()


def whole_near(value: float, near: float = NEAR) -> float | None:
    """Return the whole number next to a constant; None where it is too far.

    ``near`` is relative to the larger of the whole number and one.
    """
    whole = float(np.round(value))
    return whole if abs(value - whole) <= near * max(abs(whole), 1.0) else None


def _whole(term: Term) -> Term:
    if term.is_constant:
        whole = whole_near(term.value)
        return term if whole is None else Term.constant(whole)
    if not term.args:
        return term
    return Term.apply(term.op, *map(_whole, term.args))


def shortened(problem: Problem, moved: Sequence[tuple[Terms, float]]) -> list[tuple[Terms, float]]:
    """Return sets whose refined constants have the digits that the data tell, and no others.

    Those are the fewest with which as much is explained, to `UNTOLD` of what one constant more
    would; a constant that nothing tells has few.
    """
    out, open_sets = list(moved), [k for k, (_, loss) in enumerate(moved) if np.isfinite(loss)]
    for bits in CONSTANT_BITS:
        short = [tuple(_rounded_to(bits, t) for t in out[k][0]) for k in open_sets]
        _, losses = problem.solve(short)
        left = []
        for k, terms, loss in zip(open_sets, short, losses.tolist(), strict=True):
            if loss <= max(moved[k][1] * (1.0 + UNTOLD / problem.rows), problem.floor):
                out[k] = terms, loss
            else:
                left.append(k)
        open_sets = left
    return out


def _rounded_to(bits: int, term: Term) -> Term:
    if term.is_constant:
        return Term.constant(float(rounded(term.value, bits)))
    return Term.apply(term.op, *[_rounded_to(bits, a) for a in term.args]) if term.args else term


def polish(
    problem: Problem, front: Front, config: SearchConfig, refined: frozenset[Terms]
) -> tuple[Front, list[Individual], frozenset[Terms]]:
    """Simplify the members of the front that are new since the last generation.

    For each: the chain of sets that lose their least useful term one by one, and the sets in
    which a node gives way to its argument, refined where they hold constants.
    """
    found: list[Individual] = []
    seen = set(refined)
    for member in _worth(front, problem.rows):
        mark = (*member.terms, Term.variable(""))  # polished, as opposed to refined
        if mark in seen:
            continue
        seen.add(mark)
        found += _eliminated(problem, member)
        found += _simplified(problem, member, seen)
    return front.with_(found), found, frozenset(seen)


def _worth(front: Front, rows: int) -> list[Individual]:
    """Return the members near the shortest description of the data."""
    lengths = {id(m): rows * np.log(m.loss + _EXACT) + m.size * np.log(rows) for m in front.members}
    return sorted(front.members, key=lambda m: lengths[id(m)])[:3]


def _eliminated(problem: Problem, member: Individual) -> list[Individual]:
    chain = problem.eliminate(member.terms, len(member.terms) - 1)
    out = [Individual.of(terms, loss) for terms, loss in chain]
    moved = settled(
        problem, problem.refine_many([terms for terms, _ in chain if has_constants(terms)])
    )
    return [*out, *(Individual.of(edit(terms), loss) for terms, loss in moved)]


def _simplified(problem: Problem, member: Individual, seen: set[Terms]) -> list[Individual]:
    options = [edit(terms) for terms in simpler_terms(member.terms)]
    options = [t for t in dict.fromkeys(options) if t and t not in seen]
    options = list(compress(options, all_usable(problem, options)))
    if not options:
        return []
    _, losses = problem.solve(options)
    best = [int(k) for k in np.argsort(rounded(losses), kind="stable")[:_TRIED]]
    seen.update(options[k] for k in best)
    out = [Individual.of(options[k], float(losses[k])) for k in best]
    moved = settled(
        problem, problem.refine_many([options[k] for k in best if has_constants(options[k])])
    )
    out += [Individual.of(edit(terms), loss) for terms, loss in moved if edit(terms)]
    return [individual for individual in out if np.isfinite(individual.loss)]
