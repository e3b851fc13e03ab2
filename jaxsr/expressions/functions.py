"""Terms to callables of named arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np

from jaxsr.expressions.primitives import PRIMITIVES
from jaxsr.expressions.term import BOOLEAN, LARGE, Term

Environment = Mapping[str, Any]


def evaluate(
    term: Term,
    environment: Environment,
    library: Literal["numpy", "jax"] = "numpy",
    shared: dict[Term, Any] | None = None,
) -> Any:
    """Evaluate a term on named arrays.

    Parameters
    ----------
    term : Term
    environment : mapping
        Variable name to array or number.
    library : {"numpy", "jax"}
    shared : dict, optional
        Values of subtrees already known; filled on the way, so that equal subtrees of several
        terms are evaluated once.
    """
    shared = {} if shared is None else shared
    if term.size > LARGE:
        for node in term.upward(shared):
            _evaluate(node, environment, library, shared)
    return _evaluate(term, environment, library, shared)


def _evaluate(term: Term, environment: Environment, library: str, shared: dict[Term, Any]) -> Any:
    known = shared.get(term)
    if known is not None:
        return known
    if term.is_constant:
        return term.value
    if term.is_variable:
        return environment[term.name]
    if term.op == BOOLEAN:
        return bool(term.value)
    args = [_evaluate(arg, environment, library, shared) for arg in term.args]
    value = getattr(PRIMITIVES[term.op], library)(*args)
    shared[term] = value
    return value


def to_numpy(term: Term) -> Callable[[Environment], np.ndarray]:
    """Return a NumPy function of a mapping from names to arrays."""

    def function(environment: Environment) -> np.ndarray:
        with np.errstate(all="ignore"):
            return np.asarray(evaluate(term, environment, "numpy"))

    return function


def to_jax(terms: Sequence[Term]) -> Callable[[Environment], Any]:
    """Return a JAX function of a mapping from names to arrays, all terms stacked in front."""
    terms = tuple(terms)

    def function(environment: Environment) -> Any:
        shared: dict[Term, Any] = {}
        values = [evaluate(term, environment, "jax", shared) for term in terms]
        return jnp.stack(jnp.broadcast_arrays(*values)) if values else jnp.zeros((0,))

    return function
