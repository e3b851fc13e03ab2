"""Primitives that a user defines by a Python function."""

from __future__ import annotations

import inspect
import warnings
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsr._result import InputError
from jaxsr.expressions.parsing import is_identifier
from jaxsr.expressions.primitives import (
    FUNCTIONS_BY_TEXT,
    PRIMITIVES,
    Function,
    Primitive,
    undefined,
)

_WHERE = "define_primitive"


@dataclass(frozen=True)
class DefinedPrimitive(Primitive):
    """A primitive with the definition that it travels by when pickled."""

    definition: tuple[Any, ...] = ()

    def __reduce__(self) -> tuple[Any, ...]:
        return define_primitive, self.definition


def define_primitive(
    name: str,
    function: Function,
    arity: int | None = None,
    jax: Function | None = None,
    sympy: Function | None = None,
) -> Primitive:
    """Add a function to the grammar, for searches, texts and model files of this process.

    A name keeps its meaning for the life of the process, because terms hold the name; defining
    the same function again is allowed and changes nothing. During a search a function that
    raises, or returns anything but one real number for each sample, makes its term unusable and
    warns once.

    Parameters
    ----------
    name : str
        An identifier that is not part of the grammar. Data columns can then not bear it.
    function : callable
        Elementwise function of real arrays of one shape, written with operators or NumPy. It must
        not write into its arguments.
    arity : int, optional
        Number of arguments; by default that of the function's signature.
    jax : callable, optional
        The same with ``jax.numpy``. By default ``function`` itself; where JAX cannot trace it,
        it is called back from JAX and differentiated by central differences.
    sympy : callable, optional
        The SymPy meaning; by default an undefined function of that name.

    Returns
    -------
    Primitive
        Its ``name`` goes into ``PrimitiveSet.functions``.

    Raises
    ------
    InputError
        The name is taken or no identifier, the number of arguments cannot be told, or a trial on
        a few numbers between 0 and 1 raises or returns another shape.

    Examples
    --------
    >>> define_primitive("bump", lambda x: 1.0 / (1.0 + x * x)).arity
    1
    """
    definition = (name, function, arity, jax, sympy)
    known = PRIMITIVES.get(name)
    if isinstance(known, DefinedPrimitive) and _same(known.definition, definition):
        return known
    if not isinstance(name, str) or name in PRIMITIVES or not is_identifier(name):
        raise InputError(f"name {name!r} is taken or no identifier", _WHERE, "Choose another.")
    if not callable(function):
        raise InputError(f"{name} must be a function, got {function!r}", _WHERE)
    count = _arguments(name, function) if arity is None else arity
    if not isinstance(count, int) or count < 1:
        raise InputError(f"arity of {name} must be at least 1, got {count}", _WHERE)
    guarded = _Guarded(name, function)
    guarded.check(count)
    primitive = DefinedPrimitive(
        name,
        count,
        guarded,
        _jax_meaning(guarded, jax, count),
        sympy or undefined(name),
        name,
        definition=definition,
    )
    PRIMITIVES[name] = FUNCTIONS_BY_TEXT[name] = primitive
    return primitive


def _same(one: tuple[Any, ...], other: tuple[Any, ...]) -> bool:
    """Tell whether two definitions are equal; a notebook's cell run again gives equal code."""
    return all(
        a is b or a == b or (_code(a) is not None and _code(a) == _code(b))
        for a, b in zip(one, other, strict=True)
    )


def _code(function: Any) -> Any:
    code = getattr(function, "__code__", None)
    plain = code is not None and not function.__closure__
    return (code, function.__defaults__) if plain else None


def _arguments(name: str, function: Function) -> int:
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        parameters = ()
    places = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    count = sum(p.kind in places and p.default is p.empty for p in parameters)
    if not count:
        raise InputError(f"cannot tell how many arguments {name} takes", _WHERE, "Give `arity`.")
    return count


class _Guarded:
    """A user's function as a NumPy function that returns NaN where the user's fails."""

    def __init__(self, name: str, function: Function) -> None:
        self.name, self.function, self.warned = name, function, False

    def __call__(self, *args: Any) -> Any:
        arrays = [np.asarray(arg) for arg in args]
        shape = np.broadcast_shapes(*(a.shape for a in arrays))
        value, problem = self._tried(arrays, shape or (1,))
        if value is not None:
            return value.reshape(shape)
        if not self.warned:
            self.warned = True
            warnings.warn(f"{problem}; its terms are left out", RuntimeWarning, stacklevel=2)
        return np.full(shape, np.nan)

    def check(self, arity: int) -> None:
        """Raise where the function fails on a few numbers inside most domains."""
        for count in (5, 2):
            columns = [np.linspace(0.2, 0.9, count) + 0.01 * k for k in range(arity)]
            _, problem = self._tried(columns, (count,))
            if problem:
                remedy = "It takes real arrays of one shape and returns an array of that shape."
                raise InputError(problem, _WHERE, remedy)

    def _tried(self, arrays: list[Any], shape: tuple[int, ...]) -> tuple[Any, str]:
        """Return the value and an empty text, or None and what went wrong."""
        # Views that cannot be written to, so that kept columns stay as they are.
        views = [np.broadcast_to(a, shape) for a in arrays]
        try:
            # A function written with jax.numpy would otherwise compute in float32.
            with np.errstate(all="ignore"), jax.enable_x64(True):
                value = np.asarray(self.function(*views))
        except Exception as error:  # a user's function may raise anything
            reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
            return None, f"primitive {self.name} raised {reason}"
        if value.shape != shape:
            return None, f"primitive {self.name} returned shape {value.shape} instead of {shape}"
        if value.dtype.kind not in "biuf":
            return None, f"primitive {self.name} returned {value.dtype} instead of real numbers"
        return value, ""


def _jax_meaning(guarded: _Guarded, given: Function | None, arity: int) -> Function:
    function = given or guarded.function
    trial = [jax.ShapeDtypeStruct((3,), jnp.float32)] * arity
    try:
        traced = jax.eval_shape(function, *trial)
        fits = getattr(traced, "shape", None) == (3,)
    except Exception as error:  # NumPy functions refuse traced arrays in several ways
        if given is not None:
            reason = " ".join(str(error).split())[:200]
            raise InputError(f"{guarded.name} raised {reason} in JAX", _WHERE) from None
        fits = False
    if not fits and given is not None:
        raise InputError(f"{guarded.name} returned another shape in JAX", _WHERE)
    called = function if fits else _called_back(guarded)

    def meaning(*args: Any) -> Any:
        return called(*jnp.broadcast_arrays(*(jnp.asarray(a, dtype=float) for a in args)))

    return meaning


def _called_back(guarded: _Guarded) -> Function:
    """Return a JAX function that leaves the compiled program to call NumPy."""

    @jax.custom_jvp
    def call(*args: Any) -> Any:
        result = jax.ShapeDtypeStruct(args[0].shape, args[0].dtype)
        return jax.pure_callback(
            lambda *a: np.asarray(guarded(*a), dtype=result.dtype),
            result,
            *args,
            vmap_method="broadcast_all",
        )

    def slope(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, Any]:
        total = jnp.zeros_like(primals[0])
        for k, (x, tangent) in enumerate(zip(primals, tangents, strict=True)):
            # Central differences err least near the cube root of the rounding.
            h = jnp.finfo(x.dtype).eps ** (1 / 3) * jnp.maximum(jnp.abs(x), 1.0)
            above = call(*primals[:k], x + h, *primals[k + 1 :])
            below = call(*primals[:k], x - h, *primals[k + 1 :])
            total += (above - below) / (2.0 * h) * tangent
        return call(*primals), total

    call.defjvp(slope)
    return call
