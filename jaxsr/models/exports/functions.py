"""A model's rates as functions of arrays."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, cast, overload

import numpy as np

from jaxsr._result import InputError
from jaxsr.expressions import Term, evaluate
from jaxsr.models.exports.system import System

if TYPE_CHECKING:
    from jaxtyping import Float


class Rates(Protocol):
    """Rates of states: by place, or by name where a mapping of named arrays is given."""

    @overload
    def __call__(self, t: Mapping[str, Any], /) -> dict[str, Float[Any, "*samples"]]: ...

    @overload
    def __call__(
        self, t: Any, x: Any, u: Sequence[Any] = (), p: Mapping[str, Any] | None = None
    ) -> Float[Any, " states *samples"]: ...


Named = Callable[[Mapping[str, Any]], dict[str, Any]]


def numpy_function(system: System, named: Named | None = None) -> Rates:
    """Return ``f(t, x, u=(), p=None) -> dx`` on NumPy arrays, see `Exported.to_numpy`.

    Parameters
    ----------
    system : System
    named : callable, optional
        What ``f(values)`` returns, in place of the rates of the system by name.
    """

    def by_name(given: Mapping[str, Any]) -> dict[str, Any]:
        environment, shared = {**system.values, **given}, dict[Term, Any]()
        with np.errstate(all="ignore"):
            rates = {s: evaluate(r, environment, "numpy", shared) for s, r in system.rates.items()}
        return {state: np.asarray(rate, dtype=float) for state, rate in rates.items()}

    def rates(
        t: Any, x: Any = None, u: Sequence[Any] = (), p: Mapping[str, Any] | None = None
    ) -> Any:
        if isinstance(t, Mapping):
            return (named or by_name)(cast("Mapping[str, Any]", t))
        environment = _environment(system, (t, x, u, p))
        shared: dict[Term, Any] = {}
        with np.errstate(all="ignore"):
            values = [evaluate(r, environment, "numpy", shared) for r in system.rates.values()]
        like = np.zeros(np.shape(np.asarray(x, dtype=float)[0]))
        return np.stack([np.asarray(value, dtype=float) + like for value in values])

    return rates


def jax_function(system: System, named: Named | None = None) -> Rates:
    """Return ``f(t, x, u=(), p=None) -> dx`` in JAX, see `Exported.to_jax`."""
    jnp: Any = importlib.import_module("jax.numpy")

    def by_name(given: Mapping[str, Any]) -> dict[str, Any]:
        environment, shared = {**system.values, **given}, dict[Term, Any]()
        return {s: evaluate(rate, environment, "jax", shared) for s, rate in system.rates.items()}

    def rates(
        t: Any, x: Any = None, u: Sequence[Any] = (), p: Mapping[str, Any] | None = None
    ) -> Any:
        if isinstance(t, Mapping):
            return (named or by_name)(cast("Mapping[str, Any]", t))
        environment = _environment(system, (t, x, u, p))
        shared: dict[Term, Any] = {}
        values = [evaluate(rate, environment, "jax", shared) for rate in system.rates.values()]
        like = jnp.zeros_like(jnp.asarray(x)[0])
        return jnp.stack([value + like for value in values])

    return rates


def _environment(system: System, given: tuple[Any, Any, Any, Any]) -> dict[str, Any]:
    """Return arrays by name.

    Raises
    ------
    InputError
        There are more or fewer states or inputs than the model has, or an unknown parameter.
    """
    t, x, u, p = given
    model = system.model
    changed = dict(p or {})
    for what, names, values in (("states", model.states, x), ("inputs", model.inputs, u)):
        if len(values) != len(names):
            wanted = ", ".join(names) or "none"
            raise InputError(f"{len(values)} {what} for {len(names)}", model.name, f"Give {wanted}")
    unknown = [name for name in changed if name not in model.parameters]
    if unknown:
        known = ", ".join(model.parameters) or "none"
        raise InputError(f"no parameter {unknown[0]!r:.80}", model.name, f"There are: {known:.200}")
    environment = {model.time: t, **system.values, **changed}
    environment.update(zip(model.states, x, strict=True))
    environment.update(zip(model.inputs, u, strict=True))
    return environment
