"""Traced JAX programs read as terms, element by element.

A value is an array of numbers that the program knows, or an array of objects: a `Term`, or an
`Unreadable` where a primitive says nothing that a term could. What only picks and arranges
elements (slices, gathers, reshapes) is done on the elements' numbers (`jaxpr_arranging`).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.expressions import Term
from jaxsr.expressions.derivative import ZERO, built, chosen
from jaxsr.models.jaxpr_arranging import arranged
from jaxsr.models.jaxpr_meanings import ELEMENTWISE, UnreadableError, condition

Array = Any
LONGEST_LOOP = 64
"""Rounds of a loop that are written out."""
MOST_KNOTS = 60
"""Points of a table that is read as a sum of ramps."""


@dataclass(frozen=True)
class Unreadable:
    """An element that is no term, and the variables that it may depend on."""

    variables: frozenset[str]


Element = Term | Unreadable


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """A linear system that a program solves: matrix, right-hand side and solution, of terms."""

    matrix: Array
    right: tuple[Term, ...]
    solution: tuple[Term, ...]

    def solved(self, right: Sequence[Term]) -> tuple[Term, ...]:
        """Return the solution for another right-hand side."""
        return tuple(_eliminated(self.matrix, list(right)))


def read_jaxpr(
    closed: Any, arguments: Sequence[Array]
) -> tuple[list[Array], tuple[LinearSystem, ...]]:
    """Return the results of a program, and the linear systems that it solves.

    Parameters
    ----------
    closed : jax.core.ClosedJaxpr
    arguments : sequence of ndarray
        Of numbers, or of terms.

    Returns
    -------
    results : list of ndarray
        Of terms and of `Unreadable`, in the shapes of the program's results.
    systems : tuple of LinearSystem
    """
    systems: list[LinearSystem] = []
    found = _read(closed.jaxpr, closed.consts, arguments, systems)
    return [symbols(value) for value in found], tuple(systems)


def symbols(value: Array) -> Array:
    """Return an array of terms; numbers become constants."""
    value = np.asarray(value)
    if value.dtype == object:
        return value
    make = Term.boolean if value.dtype == bool else Term.constant
    return _mapped(make, value)


def _read(
    jaxpr: Any, consts: Sequence[Array], arguments: Sequence[Array], systems: list[LinearSystem]
) -> list[Array]:
    known: dict[Any, Array] = dict(zip(jaxpr.constvars, map(np.asarray, consts), strict=True))
    known.update(zip(jaxpr.invars, arguments, strict=True))

    def value(atom: Any) -> Array:
        return np.asarray(atom.val) if hasattr(atom, "val") else known[atom]

    for equation in jaxpr.eqns:
        given = [value(atom) for atom in equation.invars]
        known.update(zip(equation.outvars, _applied(equation, given, systems), strict=True))
    return [value(atom) for atom in jaxpr.outvars]


def _applied(equation: Any, given: list[Array], systems: list[LinearSystem]) -> list[Array]:
    name, params = equation.primitive.name, equation.params
    if name not in _INNER and all(a.dtype != object for a in given) and name not in _CALLING:
        found = equation.primitive.bind(*given, **equation.params)
        found = found if equation.primitive.multiple_results else [found]
        return [np.asarray(part) for part in found]
    try:
        if name in _INNER:
            inner = params[_INNER[name]]
            if params.get("name") == "_interp" and given[0].dtype == object:
                return [_of_table(*given)]
            closed = hasattr(inner, "consts")
            consts = inner.consts if closed else []
            return _read(inner.jaxpr if closed else inner, consts, given, systems)
        if name in _WHOLE:
            return _WHOLE[name](params, systems, *given)
        if name in _ARRANGING:
            return _arranged(equation, given)
        if name in _FOLDED:
            return [_folded(_FOLDED[name], symbols(given[0]), params["axes"])]
        if name in ELEMENTWISE:
            meaning = ELEMENTWISE[name]
            return [_elementwise(lambda *a: meaning(params, *a), given)]
    except UnreadableError:
        pass
    return _unreadable(equation, given)


def _unreadable(equation: Any, given: Sequence[Array]) -> list[Array]:
    """Results that may depend on all that was given."""
    names = frozenset[str]().union(
        *(e.variables for a in given if a.dtype == object for e in a.flat)
    )
    results = []
    for out in equation.outvars:
        whole = np.empty(out.aval.shape, dtype=object)
        whole[...] = Unreadable(names)
        results.append(whole)
    return results


def _mapped(function: Callable[..., Any], *arrays: Array) -> Array:
    """Apply a function of elements; arrays are broadcast."""
    arrays = tuple(np.broadcast_arrays(*arrays))
    result = np.empty(arrays[0].shape, dtype=object)
    for index in np.ndindex(result.shape):
        result[index] = function(*(a[index] for a in arrays))
    return result


def _elementwise(meaning: Callable[..., Term], given: Sequence[Array]) -> Array:
    def element(*parts: Element) -> Element:
        if all(isinstance(p, Term) for p in parts):
            return meaning(*parts)
        return Unreadable(frozenset[str]().union(*(p.variables for p in parts)))

    return _mapped(element, *(symbols(a) for a in given))


def _arranged(equation: Any, given: Sequence[Array]) -> list[Array]:
    """Arrange the numbers of the elements; indices have to be known."""
    moved = _ARRANGING[equation.primitive.name]
    positions = range(len(given)) if moved is None else moved
    pool: list[Element] = [ZERO]
    numbered = []
    for k, array in enumerate(given):
        if k not in positions:
            if array.dtype == object:
                raise UnreadableError
            numbered.append(array)
            continue
        own = symbols(array)
        numbered.append(np.arange(len(pool), len(pool) + own.size).reshape(own.shape))
        pool.extend(own.flat)
    results = []
    for numbers in arranged(equation, numbered):
        if numbers.size and not (numbers.min() >= 0 and numbers.max() < len(pool)):
            raise UnreadableError
        results.append(_mapped(lambda k: pool[int(k)], numbers))
    return results


def _folded(op: str, array: Array, axes: Sequence[int]) -> Array:
    """Sum, product or extreme along axes."""
    for axis in sorted(axes, reverse=True):
        parts = list(np.moveaxis(array, axis, 0))
        if not parts:
            raise UnreadableError
        array = np.asarray(parts[0], dtype=object)
        for part in parts[1:]:
            array = _elementwise(lambda a, b: built(op, a, b), (array, _objects(part)))
    return array


def _running_sum(params: Any, systems: list[LinearSystem], array: Array) -> list[Array]:
    """Sum from one end of an axis on."""
    rows = list(np.moveaxis(symbols(array), params["axis"], 0))
    rows = rows[::-1] if params["reverse"] else rows
    sums = [_objects(rows[0])]
    for row in rows[1:]:
        sums.append(_elementwise(lambda a, b: built("add", a, b), (sums[-1], _objects(row))))
    sums = sums[::-1] if params["reverse"] else sums
    return [np.moveaxis(np.stack(sums), 0, params["axis"])]


def _objects(value: Any) -> Array:
    whole = np.empty(np.shape(value), dtype=object)
    whole[...] = value
    return whole


def _dot(params: Any, systems: list[LinearSystem], a: Array, b: Array) -> list[Array]:
    """Product of arrays, with batches in front."""
    (ca, cb), (ba, bb) = params["dimension_numbers"]
    a, b = symbols(a), symbols(b)
    fa = [k for k in range(a.ndim) if k not in (*ca, *ba)]
    fb = [k for k in range(b.ndim) if k not in (*cb, *bb)]
    left = a.transpose((*ba, *fa, *ca)).reshape(
        *(a.shape[k] for k in ba), -1, int(np.prod([a.shape[k] for k in ca]))
    )
    right = b.transpose((*bb, *fb, *cb)).reshape(
        *(b.shape[k] for k in bb), -1, int(np.prod([b.shape[k] for k in cb]))
    )
    products = _elementwise(
        lambda x, y: built("mul", x, y), (left[..., :, None, :], right[..., None, :, :])
    )
    whole = _folded("add", products, (products.ndim - 1,))
    shape = [a.shape[k] for k in (*ba, *fa)] + [b.shape[k] for k in fb]
    return [_objects(whole).reshape(shape)]


def _linear_solve(params: Any, systems: list[LinearSystem], *given: Array) -> list[Array]:
    """Solve a linear system by elimination, its matrix read off the product with a vector."""
    lengths, jaxprs = params["const_lengths"], params["jaxprs"]
    consts, right = given[: lengths.matvec], symbols(given[sum(lengths)])
    if len(given) != sum(lengths) + 1:
        raise UnreadableError
    columns = []
    for k in range(right.size):
        unit = np.zeros(right.size)
        unit[k] = 1.0
        product = _read(
            jaxprs.matvec.jaxpr, jaxprs.matvec.consts, [*consts, unit.reshape(right.shape)], systems
        )
        columns.append(symbols(product[0]).ravel())
    matrix = np.stack(columns, axis=1)
    if not all(isinstance(e, Term) for e in (*matrix.flat, *right.flat)):
        raise UnreadableError
    solution = _eliminated(matrix, list(right.ravel()))
    systems.append(LinearSystem(matrix, tuple(right.ravel()), tuple(solution)))
    return [_objects(solution).reshape(right.shape)]


def _eliminated(matrix: Array, right: list[Term]) -> list[Term]:
    """Gauss's elimination; rows change places where a pivot is the number zero."""
    rows, right, count = [list(row) for row in matrix], list(right), len(right)
    for k in range(count):
        pivot = next((i for i in range(k, count) if rows[i][k] != ZERO), None)
        if pivot is None:
            raise UnreadableError
        rows[k], rows[pivot] = rows[pivot], rows[k]
        right[k], right[pivot] = right[pivot], right[k]
        for i in range(k + 1, count):
            if rows[i][k] == ZERO:
                continue
            factor = built("div", rows[i][k], rows[k][k])
            for j in range(k + 1, count):
                rows[i][j] = built("sub", rows[i][j], built("mul", factor, rows[k][j]))
            right[i] = built("sub", right[i], built("mul", factor, right[k]))
    solved: list[Term] = [ZERO] * count
    for i in reversed(range(count)):
        total = right[i]
        for j in range(i + 1, count):
            total = built("sub", total, built("mul", rows[i][j], solved[j]))
        solved[i] = built("div", total, rows[i][i])
    return solved


def _cond(params: Any, systems: list[LinearSystem], index: Array, *given: Array) -> list[Array]:
    """Choose among branches; one that is known is taken."""
    branches = [b.jaxpr for b in params["branches"]]
    consts = [b.consts for b in params["branches"]]
    if index.dtype != object:
        k = int(np.clip(index, 0, len(branches) - 1))
        return _read(branches[k], consts[k], given, systems)
    if len(branches) != 2 or not isinstance(index.item(), Term):
        raise UnreadableError
    first, second = (_read(b, c, given, systems) for b, c in zip(branches, consts, strict=True))
    which = condition(index.item())
    return [
        _elementwise(lambda x, y: chosen(which, y, x), pair)
        for pair in zip(first, second, strict=True)
    ]


def _scan(params: Any, systems: list[LinearSystem], *parts: Array) -> list[Array]:
    """Write a short loop out."""
    consts, carry, length = params["num_consts"], params["num_carry"], params["length"]
    if length > LONGEST_LOOP:
        raise UnreadableError
    body, held = params["jaxpr"], list(parts[:consts])
    state, rows = list(parts[consts : consts + carry]), parts[consts + carry :]
    gathered: list[list[Array]] = []
    steps = range(length)
    for k in reversed(steps) if params["reverse"] else steps:
        given = [*held, *state, *(np.asarray(r[k]) for r in rows)]
        found = _read(body.jaxpr, body.consts, given, systems)
        state = found[:carry]
        gathered.append([symbols(y) for y in found[carry:]])
    if params["reverse"]:
        gathered.reverse()
    stacked = [np.stack(list(column)) for column in zip(*gathered, strict=True)]
    return [*state, *stacked]


def _of_table(x: Array, knots: Array, values: Array, *rest: Array) -> Array:
    """Write a table between straight lines as a sum of ramps, its ends held (`jnp.interp`)."""
    given = (knots, values, *rest)
    if any(a.dtype == object for a in given) or rest or not 1 < knots.size <= MOST_KNOTS:
        raise UnreadableError
    rises = np.concatenate([[0.0], np.diff(values) / np.diff(knots), [0.0]])

    def ramps(at: Term) -> Term:
        total = Term.constant(values[0])
        for knot, change in zip(knots, np.diff(rises), strict=True):
            ramp = built("max", built("sub", at, Term.constant(knot)), ZERO)
            total = built("add", total, built("mul", Term.constant(change), ramp))
        return total

    return _elementwise(ramps, [x])


_FOLDED = {"reduce_sum": "add", "reduce_prod": "mul", "reduce_max": "max", "reduce_min": "min"}
_WHOLE: dict[str, Callable[..., list[Array]]] = {
    "dot_general": _dot,
    "custom_linear_solve": _linear_solve,
    "cond": _cond,
    "cumsum": _running_sum,
    "scan": _scan,
}
_INNER = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "core_call": "call_jaxpr",
    "remat2": "jaxpr",
    "checkpoint": "jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "custom_vjp_call_jaxpr": "fun_jaxpr",
}
_ARRANGING: dict[str, tuple[int, ...] | None] = {
    **dict.fromkeys(
        ("reshape", "squeeze", "expand_dims", "broadcast_in_dim", "transpose", "slice", "rev"),
        (0,),
    ),
    **dict.fromkeys(("split", "unstack", "tile"), (0,)),
    **dict.fromkeys(("dynamic_slice", "gather"), (0,)),
    "concatenate": None,
    "stack": None,
    "pad": None,
    "dynamic_update_slice": (0, 1),
    "scatter": (0, 2),
}
"""Primitives that pick and arrange, with the arguments whose elements they move (None: all)."""
_CALLING = frozenset({"pure_callback", "io_callback", "debug_callback"})


def variables_of(names: Sequence[str]) -> Array:
    """Return an array of variables."""
    return _objects([Term.variable(n) for n in names]) if names else np.zeros(0, dtype=object)


def size_of(terms: Sequence[Term]) -> int:
    """Count the distinct nodes of several terms."""
    return len(set(itertools.chain.from_iterable(t.distinct() for t in terms)))


__all__ = ["LinearSystem", "Unreadable", "read_jaxpr", "size_of", "symbols", "variables_of"]
