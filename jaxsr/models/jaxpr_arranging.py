"""Primitives of JAX that pick and arrange elements, applied to arrays of numbers.

The common ones by NumPy: JAX compiles each of them anew for every shape and place, which takes
longer than reading the rest of a program.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

Array = Any


def arranged(equation: Any, given: Sequence[Array]) -> list[Array]:
    """Return what an equation of a program makes of arrays of numbers.

    Parameters
    ----------
    equation : jax.core.JaxprEqn
        Whose primitive computes nothing: its results hold elements of its arguments.
    given : sequence of ndarray
        Its arguments.
    """
    primitive = equation.primitive
    plain = _PLAIN.get(primitive.name)
    if plain is not None:
        return [plain(equation.params, *given)]
    placed = primitive.bind(*given, **equation.params)
    return [np.asarray(part) for part in (placed if primitive.multiple_results else [placed])]


def _slice(params: Mapping[str, Any], a: Array) -> Array:
    strides = params["strides"] or (1,) * a.ndim
    ends = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
    return a[tuple(slice(*end) for end in ends)]


def _broadcast(params: Mapping[str, Any], a: Array, *sizes: Array) -> Array:
    shape, own = params["shape"], np.ones(len(params["shape"]), dtype=int)
    own[list(params["broadcast_dimensions"])] = a.shape
    return np.broadcast_to(a.reshape(own), shape)


_PLAIN: Mapping[str, Callable[..., Array]] = {
    "slice": _slice,
    "squeeze": lambda params, a: np.squeeze(a, tuple(params["dimensions"])),
    "reshape": lambda params, a, *sizes: a.reshape(params["new_sizes"]),
    "transpose": lambda params, a: a.transpose(params["permutation"]),
    "rev": lambda params, a: np.flip(a, params["dimensions"]),
    "concatenate": lambda params, *parts: np.concatenate(parts, params["dimension"]),
    "broadcast_in_dim": _broadcast,
}
