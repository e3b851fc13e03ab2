"""The editing operation: fold, cancel and order, so that equal terms look equal.

Rewrites hold wherever the original is finite; ``x/x`` becomes 1 at zero too. A subtree that can
never be finite (the root of a negative constant, a division by zero) becomes the constant NaN,
and :func:`edit` drops the term that holds it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable

import numpy as np

from jaxsr.expressions.primitives import PRIMITIVES
from jaxsr.expressions.term import Term

ONE = Term.constant(1.0)
_ODD = frozenset({"sin", "tan", "asin", "atan", "sinh", "tanh", "sign"})
_EVEN = frozenset({"cos", "cosh", "abs"})
_NEVER_NEGATIVE = frozenset({"abs", "exp", "sqrt", "cosh", "heaviside"})
_OFTEN_ZERO = frozenset({"heaviside", "max", "min"})
_MOST_EXPANDED = 6  # a product of sums that expands to more parts stays a product

Sum = dict[Term, float]
Product = dict[Term, float]


@functools.lru_cache(maxsize=200_000)
def simplify(term: Term) -> Term:
    """Return the canonical form of a term."""
    if not term.args:
        return term
    args = tuple(simplify(arg) for arg in term.args)
    if all(arg.op == "constant" for arg in args):
        return _folded(term.op, args)
    if any(_is_nan(arg) for arg in args):
        return Term.constant(math.nan)
    match term.op:
        case "add" | "sub" | "neg":
            return _build_sum(*_collect_sum(Term.apply(term.op, *args)))
        case "mul" | "div":
            return _build_product(*_collect_product(Term.apply(term.op, *args)))
        case "pow" if args[1].op == "constant":
            return _build_product(*_collect_product(Term.apply("pow", *args)))
        case _:
            return _function(term.op, args)


def split(term: Term) -> list[tuple[float, Term]]:
    """Return a term as (coefficient, term of outer coefficient 1): sums apart, products expanded.

    In a linear regression each part deserves its own coefficient: ``x*(y + 3)`` holds an inner
    constant, ``x*y`` and ``x`` hold none.
    """
    constant, parts = _collect_sum(simplify(term))
    out: list[tuple[float, Term]] = []
    for base, coefficient in parts.items():
        pieces = _expand(base)
        if pieces == [base]:
            out.append((coefficient, base))
        else:
            out += [(coefficient * c, part) for piece in pieces for c, part in split(piece)]
    if constant != 0.0:
        out.append((constant, ONE))
    return out


def shorten(term: Term) -> Term:
    """Return the term with chains of one function cut to two links; this changes its value.

    sin(sin(sin(sin(x)))) becomes sin(sin(x)): the repetition adds nodes, not physics (paper,
    section 4.2.1, a).
    """
    if not term.args:
        return term
    if len(term.args) == 1 and term.args[0].op == term.op == _inner(term.args[0]):
        return shorten(term.args[0])
    return Term.apply(term.op, *map(shorten, term.args))


def _inner(term: Term) -> str:
    return term.args[0].op if len(term.args) == 1 else ""


def edit(terms: Iterable[Term]) -> tuple[Term, ...]:
    """Return an individual's terms in canonical form, without repeats and hopeless terms."""
    parts = dict.fromkeys(
        part for term in terms for scale, part in split(shorten(term)) if math.isfinite(scale)
    )
    return tuple(part for part in parts if not any(_is_nan(node) for node in part.walk()))


def _is_nan(term: Term) -> bool:
    return term.op == "constant" and not math.isfinite(term.value)


def _folded(op: str, args: tuple[Term, ...]) -> Term:
    with np.errstate(all="ignore"):
        value = float(PRIMITIVES[op].numpy(*(np.float64(arg.value) for arg in args)))
    return Term.constant(value if abs(value) < 1e100 else math.nan)


def _collect_sum(term: Term) -> tuple[float, Sum]:
    """Return (constant, {base: coefficient}) of a sum whose arguments are simplified."""
    constant, parts = 0.0, {}
    stack = [(1.0, term)]
    while stack:
        factor, node = stack.pop()
        if node.op == "constant":
            constant += factor * node.value
        elif node.op == "neg":
            stack.append((-factor, node.args[0]))
        elif node.op in ("add", "sub"):
            sign = -1.0 if node.op == "sub" else 1.0
            stack += [(factor, node.args[0]), (factor * sign, node.args[1])]
        elif node.op == "mul" and node.args[0].op == "constant":
            stack.append((factor * node.args[0].value, node.args[1]))
        else:
            parts[node] = parts.get(node, 0.0) + factor
    return constant, {k: c for k, c in parts.items() if c != 0.0}


def _build_sum(constant: float, parts: Sum) -> Term:
    pieces = [_times(parts[base], base) for base in sorted(parts, key=_key)]
    if constant != 0.0 or not pieces:
        pieces.append(Term.constant(constant))
    return functools.reduce(lambda a, b: Term.apply("add", a, b), pieces)


def _times(coefficient: float, base: Term) -> Term:
    return base if coefficient == 1.0 else Term.apply("mul", Term.constant(coefficient), base)


def _collect_product(term: Term) -> tuple[float, Product]:
    """Return (coefficient, {base: exponent}) of a product whose arguments are simplified."""
    coefficient, powers = 1.0, {}
    stack = [(1.0, term)]
    while stack:
        exponent, node = stack.pop()
        if node.op == "constant":
            coefficient *= _power(node.value, exponent)
        elif node.op == "neg":
            coefficient *= _power(-1.0, exponent)
            stack.append((exponent, node.args[0]))
        elif node.op in ("mul", "div") and _keeps(exponent):
            sign = -1.0 if node.op == "div" else 1.0
            stack += [(exponent * sign, node.args[1]), (exponent, node.args[0])]
        elif node.op == "pow" and node.args[1].op == "constant" and _keeps(exponent):
            stack.append((exponent * node.args[1].value, node.args[0]))
        else:
            scale, base = _unit_sum(node) if _keeps(exponent) else (1.0, node)
            coefficient *= _power(scale, exponent)
            powers[base] = powers.get(base, 0.0) + exponent
    return coefficient, _merge({k: e for k, e in powers.items() if e != 0.0})


def _keeps(exponent: float) -> bool:
    """Tell whether (a*b)**exponent = a**exponent * b**exponent for every real a and b."""
    return float(exponent).is_integer()


def _power(value: float, exponent: float) -> float:
    if value == 0.0 and exponent < 0.0:
        return math.nan
    with np.errstate(all="ignore"):
        result = float(np.power(np.float64(value), exponent))
    return result if math.isfinite(result) else math.nan


def _unit_sum(node: Term) -> tuple[float, Term]:
    """Scale a sum so that its first part has coefficient 1."""
    if node.op != "add":
        return 1.0, node
    constant, parts = _collect_sum(node)
    if not parts:
        return 1.0, node
    lead = parts[min(parts, key=_key)]
    return lead, _build_sum(constant / lead, {k: c / lead for k, c in parts.items()})


def _merge(powers: Product) -> Product:
    """Join x with sign(x) and Abs(x): x*sign(x) = Abs(x), sign(x)*Abs(x) = x."""
    for base in [b for b in powers if b.op == "sign" and powers[b] == 1.0]:
        inner = base.args[0]
        magnitude = Term.apply("abs", inner)
        if powers.get(inner, 0.0) >= 1.0 and _keeps(powers[inner]):
            source, target = inner, magnitude
        elif powers.get(magnitude, 0.0) >= 1.0:
            source, target = magnitude, inner
        else:
            continue
        del powers[base]
        powers[source] -= 1.0
        powers[target] = powers.get(target, 0.0) + 1.0
    for base in [b for b in powers if b.op == "abs" and powers[b] % 2.0 == 0.0 and powers[b]]:
        exponent = powers.pop(base)
        powers[base.args[0]] = powers.get(base.args[0], 0.0) + exponent
    for base in [b for b in powers if b.op == "sqrt" and powers[b] % 2.0 == 0.0 and powers[b]]:
        exponent = powers.pop(base)
        powers[base.args[0]] = powers.get(base.args[0], 0.0) + exponent / 2.0
    return {k: e for k, e in powers.items() if e != 0.0}


def _build_product(coefficient: float, powers: Product) -> Term:
    if coefficient == 0.0 or not math.isfinite(coefficient):
        return Term.constant(coefficient)
    above = [_raised(b, powers[b]) for b in sorted(powers, key=_key) if powers[b] > 0.0]
    below = [_raised(b, -powers[b]) for b in sorted(powers, key=_key) if powers[b] < 0.0]
    top = functools.reduce(lambda a, b: Term.apply("mul", a, b), above) if above else ONE
    if below:
        bottom = functools.reduce(lambda a, b: Term.apply("mul", a, b), below)
        top = Term.apply("div", top, bottom)
    if top.op == "constant":
        return Term.constant(coefficient * top.value)
    if top.op == "add":  # 2*(x + y) is the sum 2*x + 2*y
        constant, parts = _collect_sum(top)
        return _build_sum(coefficient * constant, {k: coefficient * c for k, c in parts.items()})
    return _times(coefficient, top)


def _raised(base: Term, exponent: float) -> Term:
    return base if exponent == 1.0 else Term.apply("pow", base, Term.constant(exponent))


def _expand(base: Term) -> list[Term]:
    """Return a product of sums as its parts, or the product itself where they are many."""
    _, powers = _collect_product(base)
    for factor, exponent in powers.items():
        if factor.op != "add" or exponent not in (1.0, 2.0):
            continue
        rest = dict(powers)
        rest[factor] = exponent - 1.0
        others = _build_product(1.0, {k: e for k, e in rest.items() if e != 0.0})
        constant, parts = _collect_sum(factor)
        pieces = [_times(c, part) for part, c in parts.items()]
        pieces += [Term.constant(constant)] if constant else []
        if len(pieces) <= _MOST_EXPANDED:
            return [simplify(Term.apply("mul", piece, others)) for piece in pieces]
    return [base]


def _function(op: str, args: tuple[Term, ...]) -> Term:
    """Simplify a function of simplified arguments."""
    if len(args) != 1:
        return _two_arguments(op, args)
    (arg,) = args
    if op in _ODD or op in _EVEN:
        sign, arg = _sign_apart(arg)
        if op in ("sign", "abs", "heaviside"):
            scale, arg = _scale_apart(arg)
        else:
            scale = 1.0
        inner = _plain(op, arg)
        factor = (sign if op in _ODD else 1.0) * (scale if op == "abs" else 1.0)
        return _build_product(*_collect_product(_times(factor, inner)))
    return _plain(op, arg)


def _plain(op: str, arg: Term) -> Term:
    if op == "abs" and _never_negative(arg):
        return arg
    if op == "sign" and _never_negative(arg) and not arg.uses(_OFTEN_ZERO):
        return ONE
    if op == "log" and arg.op == "exp":
        return arg.args[0]
    if op == "sqrt" and arg.op == "pow" and arg.args[1] == Term.constant(2.0):
        return simplify(Term.apply("abs", arg.args[0]))
    if op == "sqrt" and arg.op in ("add", "mul"):
        scale, rest = _scale_apart(arg)
        return _times(math.sqrt(scale), Term.apply("sqrt", rest))
    return Term.apply(op, arg)


def _two_arguments(op: str, args: tuple[Term, ...]) -> Term:
    if op in ("max", "min"):
        first, second = sorted(args, key=_key)
        return first if first == second else Term.apply(op, first, second)
    return Term.apply(op, *args)


def _sign_apart(arg: Term) -> tuple[float, Term]:
    """Return (-1, -arg) where the leading coefficient of ``arg`` is negative, else (1, arg)."""
    constant, parts = _collect_sum(arg)
    if parts and parts[min(parts, key=_key)] < 0.0:
        return -1.0, _build_sum(-constant, {k: -c for k, c in parts.items()})
    return 1.0, arg


def _scale_apart(arg: Term) -> tuple[float, Term]:
    """Return (s, arg/s) with s > 0 the leading coefficient."""
    constant, parts = _collect_sum(arg)
    lead = parts[min(parts, key=_key)] if parts else 1.0
    if lead <= 0.0 or lead == 1.0:
        return 1.0, arg
    return lead, _build_sum(constant / lead, {k: c / lead for k, c in parts.items()})


def _never_negative(term: Term) -> bool:
    if term.op == "constant":
        return term.value > 0.0
    if term.op == "pow" and term.args[1].op == "constant":
        return term.args[1].value % 2.0 == 0.0 or _never_negative(term.args[0])
    if term.op in ("mul", "div"):
        return all(_never_negative(arg) for arg in term.args)
    return term.op in _NEVER_NEGATIVE


@functools.lru_cache(maxsize=200_000)
def _key(term: Term) -> str:
    """Order terms by what they are made of, so that sums and products read the same each time."""
    inside = ",".join(_key(arg) for arg in term.args)
    head = term.name if term.op == "variable" else term.op
    value = f"{term.value!r}" if term.op == "constant" else ""
    return f"{head}{value}({inside})"
