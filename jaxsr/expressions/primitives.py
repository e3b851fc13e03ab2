"""The functions an expression may use, each with its NumPy, JAX and SymPy meaning."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxsr._result import InputError

Function = Callable[..., Any]


class _SymPy:
    """SymPy's functions by name; SymPy is loaded by the first call of one."""

    def __getattr__(self, name: str) -> Function:
        def meaning(*args: Any) -> Any:
            import sympy

            return getattr(sympy, name)(*args)

        return meaning


sympy = _SymPy()


def undefined(name: str) -> Function:
    """Return the meaning in SymPy of a function that SymPy does not know."""

    def meaning(*args: Any) -> Any:
        return sympy.Function(name)(*args)

    return meaning


@dataclass(frozen=True)
class Primitive:
    """One function of the grammar.

    Parameters
    ----------
    name : str
        Internal name, e.g. ``"add"``.
    arity : int
        Number of arguments; -1 means any number.
    numpy, jax : callable
        Elementwise functions of arrays.
    sympy : callable
        The SymPy function of the same meaning.
    text : str
        Name in the model grammar; empty for operators.
    pointwise : bool
        Whether a sample's value depends on that sample alone.
    """

    name: str
    arity: int
    numpy: Function
    jax: Function
    sympy: Function
    text: str = ""
    pointwise: bool = True

    def __reduce__(self) -> tuple[Any, ...]:
        return _of_name, (self.name,)


def _of_name(name: str) -> Primitive:
    return PRIMITIVES[name]


def _safe_sqrt(x: Any) -> Any:
    # The double `where` keeps the gradient finite at and below zero.
    positive = x > 0
    root = jnp.sqrt(jnp.where(positive, x, 1.0))
    return jnp.where(positive, root, jnp.where(x == 0, 0.0, jnp.nan))


def _safe_log(x: Any) -> Any:
    positive = x > 0
    return jnp.where(
        positive, jnp.log(jnp.where(positive, x, 1.0)), jnp.where(x == 0, -jnp.inf, jnp.nan)
    )


def _safe_power(x: Any, y: Any) -> Any:
    """x**y with finite gradients at x = 0, exact for whole constant exponents."""
    exponent = y if isinstance(y, int | float) else None
    if exponent is not None and float(exponent).is_integer():
        return jnp.asarray(x) ** int(exponent)
    zero = x == 0
    base = jnp.where(zero, 1.0, x)
    return jnp.where(zero, jnp.where(y > 0, 0.0, jnp.where(y == 0, 1.0, jnp.inf)), base**y)


def _piecewise(xp: Any) -> Function:
    def piecewise(*branches: Any) -> Any:
        # Branches come flat: value, condition, value, condition, ...
        result = xp.nan
        for value, condition in reversed(list(zip(branches[::2], branches[1::2], strict=True))):
            result = xp.where(condition, value, result)
        return result

    return piecewise


def _sympy_piecewise(*branches: Any) -> Any:
    return sympy.Piecewise(*zip(branches[::2], branches[1::2], strict=True))


def _reduce(function: Function) -> Function:
    def reduced(*args: Any) -> Any:
        result = args[0]
        for arg in args[1:]:
            result = function(result, arg)
        return result

    return reduced


def _sympy_heaviside(x: Any) -> Any:
    return sympy.Heaviside(x, sympy.Rational(1, 2))


def _same(name: str, arity: int, text: str = "", **other: Function) -> Primitive:
    """Build a primitive whose function has one name in NumPy, JAX and SymPy."""
    return Primitive(
        name,
        arity,
        other.get("numpy", getattr(np, name, None)),  # type: ignore[arg-type]  # every name given exists
        other.get("jax", getattr(jnp, name, None)),  # type: ignore[arg-type]  # every name given exists
        getattr(sympy, name),
        text or name,
    )


def _integral(name: str, arity: int) -> Primitive:
    """Build a primitive that needs the samples of a whole recording."""

    def refuse(*args: Any) -> Any:
        raise InputError(
            f"{name} has no value at a single sample",
            "",
            "Evaluate it with ColumnCache, or make it a state with an equation of its own.",
        )

    return Primitive(name, arity, refuse, refuse, undefined(name), name, pointwise=False)


_OPERATORS = (
    Primitive("add", 2, np.add, jnp.add, lambda a, b: a + b),
    Primitive("sub", 2, np.subtract, jnp.subtract, lambda a, b: a - b),
    Primitive("mul", 2, np.multiply, jnp.multiply, lambda a, b: a * b),
    Primitive("div", 2, np.divide, jnp.divide, lambda a, b: a / b),
    Primitive("pow", 2, np.float_power, _safe_power, lambda a, b: a**b),
    Primitive("neg", 1, np.negative, jnp.negative, lambda a: -a),
    Primitive("lt", 2, np.less, jnp.less, sympy.Lt),
    Primitive("le", 2, np.less_equal, jnp.less_equal, sympy.Le),
    Primitive("gt", 2, np.greater, jnp.greater, sympy.Gt),
    Primitive("ge", 2, np.greater_equal, jnp.greater_equal, sympy.Ge),
    Primitive("eq", 2, np.equal, jnp.equal, sympy.Eq),
    Primitive("ne", 2, np.not_equal, jnp.not_equal, sympy.Ne),
)

_FUNCTIONS = (
    *(_same(name, 1) for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp")),
    _same("log", 1, jax=_safe_log),
    _same("sqrt", 1, jax=_safe_sqrt),
    Primitive("asin", 1, np.arcsin, jnp.arcsin, sympy.asin, "asin"),
    Primitive("acos", 1, np.arccos, jnp.arccos, sympy.acos, "acos"),
    Primitive("atan", 1, np.arctan, jnp.arctan, sympy.atan, "atan"),
    Primitive("atan2", 2, np.arctan2, jnp.arctan2, sympy.atan2, "atan2"),
    Primitive("abs", 1, np.abs, jnp.abs, sympy.Abs, "Abs"),
    Primitive("sign", 1, np.sign, jnp.sign, sympy.sign, "sign"),
    Primitive("floor", 1, np.floor, jnp.floor, sympy.floor, "floor"),
    Primitive("max", -1, _reduce(np.maximum), _reduce(jnp.maximum), sympy.Max, "Max"),
    Primitive("min", -1, _reduce(np.minimum), _reduce(jnp.minimum), sympy.Min, "Min"),
    Primitive(
        "heaviside",
        1,
        lambda x: np.heaviside(x, 0.5),
        lambda x: jnp.heaviside(x, 0.5),
        _sympy_heaviside,
        "Heaviside",
    ),
    Primitive("piecewise", -1, _piecewise(np), _piecewise(jnp), _sympy_piecewise, "Piecewise"),
    Primitive("and", -1, _reduce(np.logical_and), _reduce(jnp.logical_and), sympy.And, "And"),
    Primitive("or", -1, _reduce(np.logical_or), _reduce(jnp.logical_or), sympy.Or, "Or"),
    Primitive("not", 1, np.logical_not, jnp.logical_not, sympy.Not, "Not"),
)

INTEGRALS: dict[str, Primitive] = {
    "integral": _integral("integral", 1),
    "integral_over": _integral("integral_over", 2),
}
"""Cumulative integrals from the start of a recording: of f dt, and of f dg."""
PRIMITIVES: dict[str, Primitive] = {p.name: p for p in (*_OPERATORS, *_FUNCTIONS)} | INTEGRALS
BUILT_IN: tuple[str, ...] = tuple(PRIMITIVES)
"""Names that mean the same in every process; what a user defines comes on top."""
FUNCTIONS_BY_TEXT: dict[str, Primitive] = {p.text: p for p in _FUNCTIONS}
DISCONTINUOUS = frozenset({"sign", "floor", "heaviside", "lt", "le", "gt", "ge", "eq", "ne"})
"""Primitives whose value jumps; a simulation has to smooth or resolve them."""
