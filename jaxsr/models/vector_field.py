r"""A Python vector field as terms: what its trace says, and calls of it where that says nothing.

``f(t, x, u, p) -> dx`` is traced once by JAX. Components that consist of the grammar's functions
become terms, so that they are run, differentiated and edited as formulas are; the others become
primitives that call `f`. Forces enter a vector field as its inputs do: a force F beside input u
adds \partial f/\partial u F to the rates of all states.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsr._result import InputError
from jaxsr.expressions import PRIMITIVES, Term, evaluate
from jaxsr.models.force_columns import force_columns
from jaxsr.models.jaxpr import LinearSystem, Unreadable, read_jaxpr, size_of, variables_of
from jaxsr.models.model import Model
from jaxsr.models.opaque import OpaquePrimitive, opaque
from jaxsr.models.traced_rates import SolvedRates, VectorField

Array = Any
Function = Callable[..., Any]
LARGEST = 3000
"""Distinct nodes of all terms from which calling the function is cheaper than its formulas."""
TRIALS = 32
"""Random points at which terms are compared with the function."""
SAME = 1e-9
"""Difference, relative to their sizes, at which two values are the same but for rounding."""


def vector_field(function: Function, model: Model, where: str = "") -> VectorField:
    """Trace a function ``f(t, x, u, p) -> dx``.

    Parameters
    ----------
    function : callable
        x holds the states without a row in [equations], u the inputs, in the model's order; p
        maps parameters to values (where a function takes no mapping, an array in the order of
        [parameters]).
    model : Model
    where : str
        Names the function in errors.

    Raises
    ------
    InputError
        The function raises, returns another number of rates, or cannot be traced or
        differentiated by JAX.
    """
    with jax.enable_x64(True), _refusing(where):
        called = _Called(function, model, where)
        found, systems = called.read()
        points = called.points()
        truth = called.at(points)
        rates = {
            state: _rate(called, i, found[i], points, truth[i])
            for i, state in enumerate(called.states)
        }
        for state, rate in rates.items():
            _check_slopes(rate, state, where)
        if size_of(list(rates.values())) > LARGEST:
            order = {s: i for i, s in enumerate(called.states)}
            rates = {
                s: r if r.size <= 1 else called.opaque(order[s], r.variables)
                for s, r in rates.items()
            }
        gains, inputs, columns = force_columns(model, rates, points)
    made = (SolvedRates.of(system, rates, columns) for system in systems)
    return VectorField(rates, gains, inputs, columns, tuple(m for m in made if m is not None))


@contextlib.contextmanager
def _refusing(where: str) -> Iterator[None]:
    """Turn what JAX says of a function that it can trace, and no more, into one line."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"cannot be run for many samples by JAX: {_short(error)}",
            where,
            "Write it with jax.numpy",
        ) from None


class _Called:
    """A function with the order of its arguments."""

    def __init__(self, function: Function, model: Model, where: str) -> None:
        self.function, self.model, self.where = function, model, where
        self.states = tuple(s for s in model.states if s not in model.equations)
        self.names = (model.time, *self.states, *model.inputs, *model.parameters)
        self.mapped = True

    def rates(self, t: Array, x: Array, u: Array, theta: Array) -> Array:
        """Call the function, and return its rates as one array."""
        p = dict(zip(self.model.parameters, theta, strict=True)) if self.mapped else theta
        found = self.function(t, x, u, p)
        if isinstance(found, Mapping):
            if set(found) != set(self.states):
                raise InputError(
                    f"returns the rates of {', '.join(map(str, found))}"[:120],
                    self.where,
                    f"Return those of {', '.join(self.states)}",
                )
            found = [found[s] for s in self.states]
        if isinstance(found, list | tuple):
            shapes = {jnp.shape(part) for part in found}
            if shapes - {()}:
                raise InputError(
                    f"returns a {type(found).__name__} of arrays of shapes {sorted(shapes)}"[:120],
                    self.where,
                    "Return one number for each state",
                )
            found = jnp.stack([jnp.asarray(part, dtype=float) for part in found])
        if found is None:
            raise InputError("returns nothing", self.where, "Return the rates of the states")
        found = jnp.asarray(found, dtype=float)
        if found.shape != (len(self.states),):
            raise InputError(
                f"returns rates of shape {found.shape} for the {len(self.states)} states "
                f"{', '.join(self.states)}"[:160],
                self.where,
                "Return one rate for each state, in the order of [model] states",
            )
        return found

    def read(self) -> tuple[Array, tuple[LinearSystem, ...]]:
        """Trace the function, and read its rates and the systems that it solves."""
        shapes = (
            np.float64(0.0),
            *(np.zeros(len(n)) for n in (self.states, self.model.inputs, self.model.parameters)),
        )
        try:
            closed = jax.make_jaxpr(self.rates)(*shapes)
        except InputError:
            raise
        except Exception as error:
            self.mapped = False
            try:
                closed = jax.make_jaxpr(self.rates)(*shapes)
            except Exception:
                raise _untraced(error, self.where) from None
        parts = (self.states, self.model.inputs, tuple(self.model.parameters))
        time = variables_of([self.model.time])[0:1].reshape(())
        results, systems = read_jaxpr(closed, [time, *(variables_of(part) for part in parts)])
        return results[0], systems

    def component(self, i: int, names: Sequence[str]) -> Function:
        """Return rate `i` as a function of some variables; it depends on no others."""
        place = {name: k for k, name in enumerate(self.names)}
        positions = [place[name] for name in names]
        edges = np.cumsum([1, len(self.states), len(self.model.inputs)])

        def value(*values: Array) -> Array:
            every = jnp.zeros(len(self.names))
            for k, own in zip(positions, values, strict=True):
                every = every.at[k].set(own)
            t, x, u, theta = jnp.split(every, edges)
            return self.rates(t[0], x, u, theta)[i]

        return value

    def opaque(self, i: int, variables: frozenset[str]) -> Term:
        """Return a term that calls the function for one of its rates."""
        names = [n for n in self.names if n in variables]
        call = self.component(i, names)
        if not names:
            return Term.constant(float(call()))
        label = f"{getattr(self.function, '__name__', 'f')}_{self.states[i]}"
        return opaque(label, call, names)

    def points(self) -> dict[str, Array]:
        """Random values of all variables, parameters near those of the model."""
        rng = np.random.default_rng(0)
        values = {n: rng.uniform(-2.0, 2.0, TRIALS) for n in self.names}
        for name, parameter in self.model.parameters.items():
            values[name] = parameter.value * rng.uniform(0.9, 1.1, TRIALS)
        return values

    def at(self, points: Mapping[str, Array]) -> Array:
        """Return all rates at points, shape (states, points), by one compilation."""
        every = np.stack([points[n] for n in self.names])
        edges = np.cumsum([1, len(self.states), len(self.model.inputs)])
        t, *parts = np.split(every, edges)
        # Operation by operation, each would be compiled for itself.
        call = jax.jit(jax.vmap(self.rates, in_axes=(0, 1, 1, 1), out_axes=1))
        return np.asarray(call(t[0], *parts))


def _rate(
    called: _Called,
    i: int,
    found: Term | Unreadable,
    points: Mapping[str, Array],
    truth: Array,
) -> Term:
    """Return a rate as a term that agrees with the function at the points."""
    if isinstance(found, Term) and any(not np.isfinite(n.value) for n in found.distinct()):
        if not np.isfinite(truth).any():
            raise InputError(
                f"the rate of {called.states[i]} is {truth[0]}, whatever the states are",
                called.where,
                "Check its numbers",
            )
        return called.opaque(i, found.variables)
    if isinstance(found, Term):
        with np.errstate(all="ignore"):
            own = np.broadcast_to(evaluate(found, points), truth.shape)
        return found if _same(own, truth) else called.opaque(i, found.variables)
    for name in called.states:
        if name in found.variables and _same(points[name], truth):
            return Term.variable(name)
    return called.opaque(i, found.variables)


def _same(first: Array, second: Array) -> bool:
    good = np.isfinite(second)
    size = np.abs(second[good]).max(initial=1.0)
    return bool(np.all(np.abs(first[good] - second[good]) <= SAME * size))


def _check_slopes(rate: Term, state: str, where: str) -> None:
    """Raise where a call of the function cannot be differentiated."""
    primitive = PRIMITIVES.get(rate.op)
    if not isinstance(primitive, OpaquePrimitive) or primitive.called is None:
        return
    try:
        primitive.called.slopes([np.zeros(1)] * primitive.arity)
    except Exception as error:
        raise InputError(
            f"the rate of {state} cannot be differentiated: {_short(error)}",
            where,
            "Write it with jax.numpy",
        ) from None


def _untraced(error: Exception, where: str) -> InputError:
    """Say in one line why a function cannot be traced."""
    errors = jax.errors
    if isinstance(error, errors.TracerBoolConversionError):
        what = "decides by if, while, and or or on a value that is traced"
        return InputError(what, _place(error, where), "Use jnp.where or jax.lax.cond")
    if isinstance(error, errors.TracerIntegerConversionError | errors.NonConcreteBooleanIndexError):
        what = "uses a traced value as an index"
        return InputError(what, _place(error, where), "Use jnp.where or jnp.take")
    if isinstance(error, errors.TracerArrayConversionError | errors.ConcretizationTypeError):
        what = "turns a traced value into a NumPy array or a Python number"
        return InputError(what, _place(error, where), "Use jax.numpy in place of numpy and math")
    return InputError(f"raises {_short(error)}", _place(error, where), "Run it once by hand")


def _short(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:120]


def _place(error: Exception, where: str) -> str:
    """Add the line of the user's file at which an error was raised."""
    file = where.rpartition(":")[0]
    trace, line = error.__traceback__, None
    while trace is not None:
        if file and trace.tb_frame.f_code.co_filename.endswith(file):
            line = trace.tb_lineno
        trace = trace.tb_next
    return where if line is None else f"{where}, line {line}"
