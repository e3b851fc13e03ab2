"""Terms a mechanician would try first, and shapes with an inner constant on a coarse grid."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from jaxsr.evolution.config import PrimitiveSet
from jaxsr.expressions.editing import ONE, edit
from jaxsr.expressions.primitives import PRIMITIVES
from jaxsr.expressions.term import Term

_MONOMIALS = 130  # the degree of monomials is the highest, up to 5, that gives no more
FEW = 4  # variables up to which every combination is offered
_LARGEST = 1e50  # of a variable whose powers shapes hold
_SPREAD = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)


def small_terms(names: Sequence[str], primitives: PrimitiveSet, most: int = 2000) -> list[Term]:
    """Return small terms without constants, the plainest first.

    One, the variables, their functions and monomials; products of these, products of three sines
    and cosines, functions of sums and products, ratios.
    """
    functions = {name for name in primitives.functions if isinstance(name, str)}
    variables = [Term.variable(name) for name in names]
    unary = [f for f in primitives.functions if _is_unary(f)]
    applied = [Term.apply(f, v) for f in unary for v in variables]
    groups: list[Iterable[Term]] = [[ONE, *variables, *applied]]
    if "mul" in functions:
        groups += [
            _monomials(variables),
            (_product(a, b) for a in variables for b in applied),
        ]
    groups.append(_of_pairs(unary, variables, functions))
    if "div" in functions:
        groups.append(Term.apply("div", a, b) for a in [ONE, *variables] for b in variables)
        groups.append(Term.apply("div", a, b) for a in [ONE, *variables] for b in applied)
        if len(variables) <= FEW:
            groups.append(Term.apply("div", a, b) for a in applied for b in variables)
    if "mul" in functions:
        groups.append(_product(a, b) for a, b in _pairs(applied))
        if len(variables) <= FEW:
            groups += [_angles(variables, functions), _squared(variables, applied)]
    drawn = itertools.islice(itertools.chain(*groups), 2 * most)
    return list(edit(drawn))[:most]


def shape_terms(
    variables: Mapping[str, np.ndarray],
    primitives: PrimitiveSet,
    shift: float = 0.0,
    most: int = 4000,
) -> list[Term]:
    """Return terms that hold an inner constant, its values on a grid that suits the data.

    For each variable v: 1/(v + c), 1/(v^n + c), exp(c v), 1/(1 + exp(c v + d)), v^c, (c - v)^d,
    log(v + c), sqrt(c - v^2), alone and times a variable; ``shift``, in [0, 1), moves the grid by
    that part of its spacing. A wrong constant of this kind often has
    no gradient to follow, so the grid is what a refinement starts from.
    """
    functions = {name for name in primitives.functions if isinstance(name, str)}
    names = list(variables)
    out: list[Term] = []
    for name in names:
        values = np.asarray(variables[name], dtype=np.float64)
        if not np.ptp(values) > 0.0:
            continue
        shapes = list(_shapes(name, values, functions, shift))
        out += shapes
        others = [n for n in names if n != name] if len(names) <= FEW else []
        if "mul" in functions:
            for factor in (name, *others):
                out += [_product(Term.variable(factor), shape) for shape in shapes]
            pairs = itertools.combinations_with_replacement([name, *others[:2]], 2)
            out += [
                _product(_product(Term.variable(a), Term.variable(b)), shape)
                for a, b in pairs
                if (a, b) != (name, name)
                for shape in shapes
            ]
    if len(names) <= FEW and {"exp", "div"} <= functions:
        out += [
            term
            for a, b in itertools.combinations(names, 2)
            for term in _steps(a, b, variables, shift)
        ]
    return list(edit(out[:most]))


def _shapes(name: str, values: np.ndarray, functions: set[str], shift: float) -> Iterator[Term]:
    v = Term.variable(name)
    low, high = float(np.min(values)), float(np.max(values))
    span = high - low
    scale = float(np.sqrt(np.mean(values**2)))
    if max(abs(low), abs(high)) > _LARGEST:
        return  # its powers are no numbers
    spread = [s * 3.0**shift for s in _SPREAD]
    shifts = [span * s - low for s in spread] + [-high - span * s for s in spread]
    if "div" in functions:
        yield from (_over(_plus(v, c)) for c in shifts)
        for power in (2, 3, 4, 5) if low >= 0.0 else (2, 4):
            raised = Term.apply("pow", v, Term.constant(power))
            sizes = (s * 10.0**shift * scale**power for s in (0.01, 0.1, 1.0, 10.0, 100.0))
            yield from (_over(_plus(raised, size)) for size in sizes)
    if "exp" in functions:
        rates = [sign * s * 3.0**shift / span for s in (0.3, 1.0, 3.0) for sign in (1.0, -1.0)]
        yield from (Term.apply("exp", _times(c, v)) for c in rates)
        if "div" in functions:
            for rate in (2.0, 5.0, 15.0):
                for place in (-0.2, 0.1, 0.35, 0.65, 0.9, 1.2):
                    slope = rate * 2.5**shift / span
                    inner = _plus(_times(slope, v), -slope * (low + place * span))
                    yield _over(_plus(Term.apply("exp", inner), 1.0))
    if "pow" in functions:
        if low >= 0.0:
            yield from (Term.apply("pow", v, Term.constant(p)) for p in (0.7, 1.3, 2.5, -0.5))
        for s in (0.1, 1.0):
            short = Term.apply("sub", Term.constant(high + s * span), v)
            yield from (Term.apply("pow", short, Term.constant(p)) for p in (0.7, 1.3, 2.5))
    if "log" in functions:
        yield from (Term.apply("log", _plus(v, span * s - low)) for s in (0.1, 1.0))
    if "sqrt" in functions:
        top = max(high**2, low**2)
        square = Term.apply("pow", v, Term.constant(2.0))
        for s in (1.05, 1.3, 2.0, 4.0):
            yield Term.apply("sqrt", Term.apply("sub", Term.constant(s * top), square))
        yield from (Term.apply("sqrt", _plus(v, span * s - low)) for s in (0.1, 1.0))


def _steps(a: str, b: str, variables: Mapping[str, np.ndarray], shift: float) -> Iterator[Term]:
    """Return logistic steps of a weighted sum of two variables."""
    parts = []
    for name in (a, b):
        values = np.asarray(variables[name], dtype=np.float64)
        span = float(np.ptp(values)) or 1.0
        parts.append((Term.variable(name), span, float(np.min(values)) + 0.5 * span))
    (v, wide, centre), (w, other, middle) = parts
    for first, second in itertools.product((1.5, 5.0), (-5.0, -1.5, 1.5, 5.0)):
        slopes = first * 3.0**shift / wide, second * 3.0**shift / other
        inner = Term.apply("add", _times(slopes[0], v), _times(slopes[1], w))
        for place in (-2.0, 0.0, 2.0):
            offset = place - slopes[0] * centre - slopes[1] * middle
            yield _over(_plus(Term.apply("exp", _plus(inner, offset)), 1.0))


def _is_unary(name: object) -> bool:
    known = PRIMITIVES.get(name) if isinstance(name, str) else None
    return known is not None and known.arity == 1 and known.name not in ("neg", "integral")


def monomials(variables: Sequence[Term], degree: int) -> list[Term]:
    """Return every product of ``degree`` variables, ONE for degree 0."""
    if degree == 0:
        return [ONE]
    draws = itertools.combinations_with_replacement(variables, degree)
    return [_chain(parts) for parts in draws]


def _monomials(variables: list[Term]) -> list[Term]:
    out: list[Term] = []
    for degree in range(2, 6):
        if len(variables) ** degree > 40_000:
            break
        found = monomials(variables, degree)
        if degree > 2 and len(out) + len(found) > _MONOMIALS:
            break
        out += found
    return out


def _of_pairs(unary: list[str], variables: list[Term], functions: set[str]) -> Iterator[Term]:
    for f in unary:
        for a, b in itertools.combinations(variables, 2):
            yield Term.apply(f, Term.apply("sub", a, b))
            if len(variables) <= FEW:
                yield Term.apply(f, Term.apply("add", a, b))
        if "mul" in functions and len(variables) <= 3 * FEW:
            for a, b in _pairs(variables):
                yield Term.apply(f, _product(a, b))


def _angles(variables: list[Term], functions: set[str]) -> Iterator[Term]:
    """Products of three sines and cosines, one of them perhaps below the line."""
    waves = [Term.apply(f, v) for f in ("sin", "cos") if f in functions for v in variables]
    for a, b in _pairs(waves):
        for c in waves:
            yield _product(_product(a, b), c)
            if "div" in functions:
                yield Term.apply("div", _product(a, b), c)
    if "div" in functions:
        yield from (Term.apply("div", a, b) for a in waves for b in waves if a != b)


def _squared(variables: list[Term], applied: list[Term]) -> Iterator[Term]:
    """Products of two variables with a function: v^2 sin(q), v*w*cos(q)."""
    for a, b in _pairs(variables):
        yield from (_product(_product(a, b), f) for f in applied)


def _pairs(terms: list[Term]) -> list[tuple[Term, Term]]:
    return list(itertools.combinations_with_replacement(terms, 2))


def _product(a: Term, b: Term) -> Term:
    return Term.apply("mul", a, b)


def _chain(parts: tuple[Term, ...]) -> Term:
    out = parts[0]
    for part in parts[1:]:
        out = _product(out, part)
    return out


def _plus(term: Term, c: float) -> Term:
    return Term.apply("add", term, Term.constant(_short(c)))


def _times(c: float, term: Term) -> Term:
    return _product(Term.constant(_short(c)), term)


def _over(term: Term) -> Term:
    return Term.apply("div", ONE, term)


def _short(c: float) -> float:
    return float(f"{c:.4g}")
