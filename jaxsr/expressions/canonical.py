"""The canonical form of a term: folded, cancelled and ordered, so that equal terms look equal.

Rewrites hold wherever every part of the original is finite and no exponential underflows;
``x/x`` becomes 1 at zero too. What can never be finite (the root of a negative constant, a
division by zero) becomes the constant NaN.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from jaxsr.expressions.primitives import INTEGRALS, PRIMITIVES
from jaxsr.expressions.signs import never_negative, never_positive, positive
from jaxsr.expressions.term import Term

ONE = Term.constant(1.0)
NEVER = Term.constant(math.nan)
_ODD = frozenset({"sin", "tan", "asin", "atan", "sinh", "tanh", "sign"})
_SAME_SIGN = frozenset({"sign", "tanh", "sinh", "atan"})  # as the argument's
_EVEN = frozenset({"cos", "cosh", "abs"})
_SQUARED = {"abs": 1.0, "sqrt": 0.5}  # what is left of the exponent where it was even
REMEMBERED = 100_000  # terms whose form is kept; a search meets fewer that matter
_HUGE = 1e100  # beyond it a constant is no number to reckon with

Sum = dict[Term, float]
Product = dict[Term, float]


@functools.lru_cache(maxsize=REMEMBERED)
def simplify(term: Term) -> Term:
    """Return the canonical form of a term."""
    if not term.args:
        return term
    args = tuple([simplify(arg) if arg.args else arg for arg in term.args])
    if any(is_nan(arg) for arg in args):
        return NEVER
    if term.op in INTEGRALS:
        return _integral(term.op, args)
    if all(arg.op == "constant" for arg in args):
        return _folded(term.op, args)
    match term.op:
        case "add" | "sub" | "neg":
            return _build_sum(*collect_sum(Term(term.op, args)))
        case "mul" | "div":
            return build_product(*collect_product(Term(term.op, args)))
        case "pow" if args[1].op == "constant":
            return build_product(*collect_product(Term("pow", args)))
        case _:
            return _function(term.op, args)


def is_nan(term: Term) -> bool:
    return term.op == "constant" and not math.isfinite(term.value)


def _folded(op: str, args: tuple[Term, ...]) -> Term:
    with np.errstate(all="ignore"):
        value = float(PRIMITIVES[op].numpy(*(np.float64(arg.value) for arg in args)))
    return Term.constant(value) if abs(value) < _HUGE else NEVER


def collect_sum(term: Term) -> tuple[float, Sum]:
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
        elif node.op == "div" and node.args[0].op == "constant" and node.args[0] != ONE:
            stack.append((factor * node.args[0].value, Term("div", (ONE, node.args[1]))))
        else:
            parts[node] = parts.get(node, 0.0) + factor
    return constant, {k: c for k, c in parts.items() if c != 0.0}


def _build_sum(constant: float, parts: Sum) -> Term:
    """Write a sum, what is added before what is taken away: c - x, not -x + c."""
    bases = sorted(parts, key=_key)
    added = [times(parts[base], base) for base in bases if parts[base] > 0.0]
    taken = [base for base in bases if not parts[base] > 0.0]
    if constant > 0.0 or not parts:
        added.append(Term.constant(constant))
    if not added:
        added.append(times(parts[taken[0]], taken.pop(0)))
    total = functools.reduce(lambda a, b: Term("add", (a, b)), added)
    for base in taken:
        total = Term("sub", (total, times(-parts[base], base)))
    if constant < 0.0 and parts:
        total = Term("sub", (total, Term.constant(-constant)))
    return total


def _divided(constant: float, parts: Sum, by: float) -> Term:
    """Write a sum with every part divided; 0.76/0.76 is 1, whatever rounding makes of it."""

    def quotient(value: float) -> float:
        exact = value / by
        near = float(round(exact)) if abs(exact) < 1e15 else exact
        return near if abs(exact - near) <= 4e-16 * abs(exact) else exact

    return _build_sum(quotient(constant), {k: quotient(c) for k, c in parts.items()})


def times(coefficient: float, base: Term) -> Term:
    if coefficient == 1.0:
        return base
    if base.op == "div" and base.args[0] == ONE:
        return Term("div", (Term.constant(coefficient), base.args[1]))
    return Term("mul", (Term.constant(coefficient), base))


def collect_product(term: Term) -> tuple[float, Product]:
    """Return (coefficient, {base: exponent}) of a product whose arguments are simplified."""
    coefficient, powers = 1.0, {}
    stack = [(1.0, term)]
    while stack:
        while stack:
            coefficient *= _take_factor(*stack.pop(), stack, powers)
        _merge_signs(powers)
        # Abs(a)**2 = a**2 and sqrt(a)**2 = a, whose factors are then collected in turn
        for base in [b for b, e in powers.items() if b.op in _SQUARED and e % 2.0 == 0.0 and e]:
            stack.append((powers.pop(base) * _SQUARED[base.op], base.args[0]))
    return coefficient, {k: e for k, e in powers.items() if e != 0.0}


def _take_factor(
    exponent: float, node: Term, stack: list[tuple[float, Term]], powers: Product
) -> float:
    """Put node**exponent into ``powers``, or its factors on the stack; return its constant."""
    if node.op == "constant":
        return _power(node.value, exponent)
    whole = _keeps(exponent)
    if node.op == "neg":
        stack.append((exponent, node.args[0]))
        return _power(-1.0, exponent)
    if node.op in ("mul", "div") and whole:
        sign = -1.0 if node.op == "div" else 1.0
        stack += [(exponent * sign, node.args[1]), (exponent, node.args[0])]
        return 1.0
    if node.op == "pow" and node.args[1].op == "constant" and whole:
        stack.append((exponent * node.args[1].value, node.args[0]))
        return 1.0
    # a positive scale leaves a power of any exponent
    scale, base = _unit_sum(node) if whole else _scale_apart(node)
    powers[base] = powers.get(base, 0.0) + exponent
    return _power(scale, exponent)


def _keeps(exponent: float) -> bool:
    """Tell whether (a*b)**exponent = a**exponent * b**exponent for every real a and b."""
    return float(exponent).is_integer()


def _power(value: float, exponent: float) -> float:
    if exponent == 1.0 or value == 1.0:
        return value
    try:
        return math.pow(value, exponent)
    except (OverflowError, ValueError):  # too large; 0**-1 or a root of a negative number
        return math.nan


def _unit_sum(node: Term) -> tuple[float, Term]:
    """Scale a sum so that its first part has coefficient 1."""
    if node.op not in ("add", "sub"):
        return 1.0, node
    constant, parts = collect_sum(node)
    if not parts:
        return 1.0, node
    lead = parts[min(parts, key=_key)]
    if lead == 1.0:
        return 1.0, node
    return lead, _divided(constant, parts, lead)


def _merge_signs(powers: Product) -> None:
    """Join x with sign(x) and Abs(x), above or below the line: x*sign(x) = Abs(x)."""
    for base in [b for b in powers if b.op == "sign" and abs(powers[b]) == 1.0]:
        inner, side = base.args[0], powers[base]
        magnitude = Term("abs", (inner,))
        if side * powers.get(inner, 0.0) >= 1.0 and _keeps(powers[inner]):
            source, target = inner, magnitude
        elif side * powers.get(magnitude, 0.0) >= 1.0:
            source, target = magnitude, inner
        else:
            continue
        del powers[base]
        powers[source] -= side
        powers[target] = powers.get(target, 0.0) + side


def build_product(coefficient: float, powers: Product) -> Term:
    if coefficient == 0.0 or not math.isfinite(coefficient):
        return Term.constant(coefficient) if coefficient == 0.0 else NEVER
    bases = sorted(powers, key=_key)
    above = [_raised(b, powers[b]) for b in bases if powers[b] > 0.0]
    below = [_raised(b, -powers[b]) for b in bases if powers[b] < 0.0]
    top = functools.reduce(product, above) if above else ONE
    if below:
        top = Term("div", (top, functools.reduce(product, below)))
    if top.op == "constant":
        return Term.constant(coefficient * top.value)
    if top.op in ("add", "sub") and coefficient != 1.0:  # 2*(x + y) is the sum 2*x + 2*y
        constant, parts = collect_sum(top)
        return _build_sum(coefficient * constant, {k: coefficient * c for k, c in parts.items()})
    return times(coefficient, top)


def product(a: Term, b: Term) -> Term:
    return Term("mul", (a, b))


def _raised(base: Term, exponent: float) -> Term:
    return base if exponent == 1.0 else Term("pow", (base, Term.constant(exponent)))


def _integral(op: str, args: tuple[Term, ...]) -> Term:
    """Take constant factors out of an integral; what it integrates over has no offset."""
    factors, inner = 1.0, []
    for place, arg in enumerate(args):
        constant, parts = collect_sum(arg)
        constant = constant if place == 0 else 0.0
        if not parts and constant == 0.0:
            return Term.constant(0.0)
        lead = parts[min(parts, key=_key)] if parts else constant
        factors *= lead
        inner.append(_divided(constant, parts, lead))
    return times(factors, Term(op, tuple(inner)))


def _function(op: str, args: tuple[Term, ...]) -> Term:
    """Simplify a function of simplified arguments."""
    if len(args) != 1:
        return _two_arguments(op, args)
    (arg,) = args
    sign = 1.0
    if op in _ODD or op in _EVEN:
        sign, arg = _sign_apart(arg)
        sign = sign if op in _ODD else 1.0
    scale = 1.0
    if op in ("sign", "abs", "heaviside"):
        scale, arg = _scale_apart(arg)
        scale = scale if op == "abs" else 1.0
    known = _sign_definite(op, arg) or _inverse(op, arg)
    if known is None and sign * scale == 1.0:
        return Term(op, (arg,))
    inner = known or Term(op, (arg,))
    return build_product(*collect_product(times(sign * scale, inner)))


def _sign_definite(op: str, arg: Term) -> Term | None:
    """Return what a function becomes where its argument cannot change its sign."""
    match op:
        case "abs" if never_negative(arg):
            return arg
        case "sign" | "heaviside" if positive(arg):
            return ONE
        case "heaviside" if positive(arg, -1):
            return Term.constant(0.0)
        case "sqrt" if positive(arg, -1):
            return NEVER
        case "log" if never_positive(arg):
            return NEVER
    return None


def _inverse(op: str, arg: Term) -> Term | None:
    """Return what is left of a function of its inverse, of a power or of a scaled argument."""
    if (op, arg.op) in (("log", "exp"), ("exp", "log")):
        return arg.args[0]
    if op in ("sign", "heaviside") and arg.op in _SAME_SIGN:
        return simplify(Term(op, arg.args))
    if op == "sqrt":
        if arg.op == "pow" and arg.args[1] == Term.constant(2.0):
            return simplify(Term("abs", (arg.args[0],)))
        scale, rest = _scale_apart(arg)
        if scale != 1.0:
            return times(math.sqrt(scale), simplify(Term("sqrt", (rest,))))
    if op == "log":  # log(2*x) = log(2) + log(x)
        scale, rest = _scale_apart(arg)
        if scale != 1.0:
            inner = simplify(Term("log", (rest,)))
            return simplify(Term("add", (inner, Term.constant(math.log(scale)))))
    if op == "exp" and arg.op in ("add", "sub"):  # exp(x + 2) = exp(2)*exp(x)
        constant, parts = collect_sum(arg)
        if constant and abs(constant) < math.log(_HUGE):
            inner = simplify(Term("exp", (_build_sum(0.0, parts),)))
            return times(math.exp(constant), inner)
    return None


def _two_arguments(op: str, args: tuple[Term, ...]) -> Term:
    if op in ("max", "min") and len(args) == 2:
        first, second = sorted(args, key=_key)
        return first if first == second else Term(op, (first, second))
    if op == "pow" and args[0] == ONE:
        return ONE
    return Term(op, args)


def _sign_apart(arg: Term) -> tuple[float, Term]:
    """Return (-1, -arg) where the leading coefficient of ``arg`` is negative, else (1, arg)."""
    constant, parts = collect_sum(arg)
    if parts and parts[min(parts, key=_key)] < 0.0:
        return -1.0, _build_sum(-constant, {k: -c for k, c in parts.items()})
    return 1.0, arg


def _scale_apart(arg: Term) -> tuple[float, Term]:
    """Return (s, arg/s) with s > 0 the size of the leading coefficient."""
    if arg.op not in ("add", "sub", "mul", "div"):
        return 1.0, arg
    constant, parts = collect_sum(arg)
    lead = abs(parts[min(parts, key=_key)]) if parts else 1.0
    if lead == 1.0:
        return 1.0, arg
    return lead, _divided(constant, parts, lead)


@functools.lru_cache(maxsize=REMEMBERED)
def _key(term: Term) -> str:
    """Order terms by what they are made of, so that sums and products read the same each time."""
    inside = ",".join(_key(arg) for arg in term.args)
    head = term.name if term.op == "variable" else term.op
    value = f"{term.value!r}" if term.op == "constant" else ""
    return f"{head}{value}({inside})"
