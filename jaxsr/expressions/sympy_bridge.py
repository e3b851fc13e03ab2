"""Terms to SymPy and back; no text passes between them."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

from jaxsr.expressions.primitives import PRIMITIVES
from jaxsr.expressions.term import BOOLEAN, Term

if TYPE_CHECKING:
    import sympy

# SymPy is loaded where it is needed: a job that shows no formula of its own does without.


@lru_cache(maxsize=1)
def _number_functions() -> dict[Any, str]:
    import sympy

    return {
        sympy.sin: "sin",
        sympy.cos: "cos",
        sympy.tan: "tan",
        sympy.asin: "asin",
        sympy.acos: "acos",
        sympy.atan: "atan",
        sympy.atan2: "atan2",
        sympy.sinh: "sinh",
        sympy.cosh: "cosh",
        sympy.tanh: "tanh",
        sympy.exp: "exp",
        sympy.log: "log",
        sympy.Abs: "abs",
        sympy.sign: "sign",
        sympy.floor: "floor",
        sympy.Max: "max",
        sympy.Min: "min",
        sympy.And: "and",
        sympy.Or: "or",
        sympy.Not: "not",
        sympy.StrictLessThan: "lt",
        sympy.LessThan: "le",
        sympy.StrictGreaterThan: "gt",
        sympy.GreaterThan: "ge",
        sympy.Equality: "eq",
        sympy.Unequality: "ne",
    }


def to_sympy(term: Term) -> sympy.Basic:
    """Return the SymPy expression; variables become real symbols.

    Whole numbers become SymPy integers, so that algebra on them is exact.
    """
    import sympy

    if term.is_constant:
        whole = term.value == int(term.value) and abs(term.value) < 2**53
        return sympy.Integer(int(term.value)) if whole else sympy.Float(term.value, 17)
    if term.is_variable:
        return sympy.Symbol(term.name, real=True)
    if term.op == BOOLEAN:
        return sympy.true if term.value else sympy.false
    return PRIMITIVES[term.op].sympy(*(to_sympy(arg) for arg in term.args))


def from_sympy(expression: sympy.Basic) -> Term:
    """Return the term of a SymPy expression.

    Raises
    ------
    ValueError
        The expression uses a function outside the grammar.
    """
    import sympy

    if isinstance(expression, sympy.Symbol):
        return Term.variable(expression.name)
    if expression in (sympy.true, sympy.false):
        return Term.boolean(bool(expression))
    if isinstance(expression, sympy.Expr) and expression.is_number:
        return Term.constant(float(expression))
    if isinstance(expression, sympy.Add | sympy.Mul):
        return _chain(expression)
    if isinstance(expression, sympy.Pow):
        base, exponent = expression.args
        if exponent == sympy.Rational(1, 2):
            return Term.apply("sqrt", from_sympy(base))
        if exponent == -1:
            return Term.apply("div", Term.constant(1.0), from_sympy(base))
        return Term.apply("pow", from_sympy(base), from_sympy(exponent))
    if isinstance(expression, sympy.Heaviside):
        return Term.apply("heaviside", from_sympy(expression.args[0]))
    if isinstance(expression, sympy.Piecewise):
        flat = [part for pair in expression.args for part in (pair.args[0], pair.args[1])]
        return Term.apply("piecewise", *(from_sympy(part) for part in flat))
    op = _number_functions().get(expression.func) or _defined(expression.func)
    if op is None:
        raise ValueError(f"{expression.func} is not part of the model grammar")
    return Term.apply(op, *(from_sympy(arg) for arg in expression.args))


def _defined(function: Any) -> str | None:
    """Return the primitive of a SymPy function that is undefined there, or a user's meaning."""
    from sympy.core.function import AppliedUndef

    if issubclass(function, AppliedUndef) and function.__name__ in PRIMITIVES:
        return str(function.__name__)
    return next((name for name, p in PRIMITIVES.items() if p.sympy is function), None)


def _chain(expression: sympy.Basic) -> Term:
    """Turn an n-ary sum or product into nested binary nodes, with - and / where natural."""
    import sympy

    args = [arg for arg in sympy.ordered(expression.args)]
    if isinstance(expression, sympy.Add):
        args.sort(key=lambda arg: arg.could_extract_minus_sign())
        result = from_sympy(args[0])
        for arg in args[1:]:
            negative = arg.could_extract_minus_sign()
            part = from_sympy(-arg if negative else arg)
            result = Term.apply("sub" if negative else "add", result, part)
        return result
    coefficient, factors = expression.as_coeff_mul()  # type: ignore[attr-defined]  # Mul has it
    above = [f for f in factors if not (f.is_Pow and f.args[1].could_extract_minus_sign())]
    below = [1 / f for f in factors if f.is_Pow and f.args[1].could_extract_minus_sign()]
    parts = [from_sympy(f) for f in above]
    if coefficient == -1 and parts:
        parts[0] = Term.apply("neg", parts[0])
    elif coefficient != 1 or not parts:
        parts.insert(0, Term.constant(float(coefficient)))
    result = parts[0]
    for part in parts[1:]:
        result = Term.apply("mul", result, part)
    for part in below:
        result = Term.apply("div", result, from_sympy(part))
    return result
