r"""Gradient descent over inner constants, through the ridge solve, all sets of terms at once.

For one set with moving columns :math:`\Theta(c)` of unit norm beside its still terms,

.. math:: L(c) = \| y - \Theta\,\xi(c) \|^2, \quad
          (\Theta^T\Theta + \lambda I)\,\xi(c) = \Theta^T y,

and :math:`\log L` is descended by optax, with the gradient taken through the solve.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxsr._result import InputError
from jaxsr.evaluation.interpreter import run_term
from jaxsr.expressions.postfix import CONSTANT, NOP, VARIABLE, compile_postfix
from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array, bucket
from jaxsr.regression.linear import LinearProblem
from jaxsr.regression.projection import Sets
from jaxsr.regression.refinement import Refinement
from jaxsr.regression.slopes import with_leaves

_MOST_SAMPLES = 4000  # a view is written out as a matrix
_TINY = 1e-30  # keeps the logarithm of an exact fit finite


def descend(
    problem: LinearProblem,
    batch: Sets,
    moving: Sequence[Sequence[Term]],
    limits: Refinement,
) -> Array:
    """Return constants (sets, constants) after ``limits.iterations`` steps, the best seen.

    Parameters
    ----------
    moving : sequence of sequence of Term
        The terms of each set of ``batch`` that hold constants.

    Raises
    ------
    InputError
        A term has no postfix code, or a view has too many samples to be written out.
    """
    names = list(problem.variables)
    data = np.array([problem.variables[name] for name in names]).reshape(len(names), -1)
    coded = _coded(batch, moving, names)
    size = np.maximum(np.abs(coded["start"]), 0.1)  # steps are relative to it
    with jax.enable_x64(True):
        run = _runner(limits.method, limits.iterations, limits.learning_rate)
        shared = _Shared(data, _view_matrix(problem), problem.ridge, problem.total or 1.0)
        best = np.array(run(coded, size, shared))
    return best[: len(batch.start), : batch.start.shape[1]]


def descent_shapes(limits: Refinement) -> int:
    """Return how many shapes a method has been compiled for in this process."""
    return int(_runner(limits.method, limits.iterations, limits.learning_rate)._cache_size())


def _view_matrix(problem: LinearProblem) -> Array | None:
    """Return the view, without what the fixed columns explain, as (rows, samples)."""
    if problem.view is None and not problem.fixed.shape[1]:
        return None
    if problem.samples > _MOST_SAMPLES:
        raise InputError(
            f"descent through a view of {problem.samples} samples needs too much memory",
            "Refinement.method",
            "Use 'levenberg_marquardt'.",
        )
    return problem.seen(np.eye(problem.samples))


def _coded(batch: Sets, moving: Sequence[Sequence[Term]], names: list[str]) -> dict[str, Any]:
    """Write every set as padded arrays: postfix code, where its constants stand, what is still.

    Sizes are rounded up to powers of two, so that few shapes are compiled.
    """
    most = batch.start.shape[1]
    # a movable constant is read as a variable of its own, to see where it stands
    marks = [Term.variable(f"{k}") for k in range(most)]
    flat = [term for terms in moving for term in terms]
    code = compile_postfix(flat, names)
    marked: list[Term] = []
    for terms in moving:
        leaves = iter(marks)
        marked += [with_leaves(term, leaves) for term in terms]
    places = compile_postfix(marked, [*names, *(mark.name for mark in marks)], code.opcode.shape[1])
    sets, terms, slots = bucket(len(moving)), bucket(batch.used.shape[1], 1), code.opcode.shape[1]
    still = bucket(batch.basis.shape[1])
    out: dict[str, Any] = {
        "opcode": np.full((sets, terms, slots), NOP, np.int32),
        "operand": np.zeros((sets, terms, slots), np.int32),
        "constants": np.zeros((sets, terms, slots)),
        "place": np.full((sets, bucket(most)), terms * slots, np.int32),
        "start": np.zeros((sets, bucket(most))),
        "used": np.zeros((sets, terms), dtype=bool),
        "basis": np.zeros((sets, still, batch.target.shape[1])),
        "target": np.zeros((sets, batch.target.shape[1])),
    }
    out["opcode"][:, :, 0] = CONSTANT
    row = 0
    for k, own in enumerate(moving):
        span = slice(row, row + len(own))
        for name in ("opcode", "operand", "constants"):
            out[name][k, : len(own)] = getattr(code, name)[span]
        mark = np.where(places.opcode[span] == VARIABLE, places.operand[span] - len(names), -1)
        slot, position = np.nonzero(mark >= 0)
        out["place"][k, mark[slot, position]] = slot * slots + position
        row += len(own)
    for name in ("start", "used", "basis", "target"):
        part = getattr(batch, name)
        out[name][tuple(slice(size) for size in part.shape)] = part
    return out


class _Shared(NamedTuple):
    """What all sets see: data (variables, samples), the view as a matrix, damping, scale."""

    data: Any
    view: Any
    ridge: Any
    total: Any


def _code(coded: dict[str, Any], p: Any, size: Any) -> tuple[Any, Any, Any]:
    """Return opcode, operand and constants of all terms, one a row, at ``start + size * p``."""
    slots = coded["constants"].shape[2]
    place = jax.vmap(lambda c, at, x: c.at[at].set(x, mode="drop"))
    constants = coded["constants"].reshape(len(p), -1)
    constants = place(constants, coded["place"], coded["start"] + size * p)
    rows = (coded["opcode"], coded["operand"], constants)
    opcode, operand, constants = (part.reshape(-1, slots) for part in rows)
    return opcode, operand, constants


def _log_loss(columns: Any, used: Any, basis: Any, target: Any, shared: _Shared) -> Any:
    """Return log L of one set from its columns (terms, samples), by a ridge solve."""
    columns = jnp.where(used[:, None], columns, 0.0)
    if shared.view is not None:
        columns = columns @ shared.view.T
    columns = columns - (columns @ basis.T) @ basis
    theta = columns / jnp.sqrt(jnp.sum(columns**2, axis=1) + ~used)[:, None]
    gram = theta @ theta.T + jnp.diag(shared.ridge + ~used)
    residual = target - jnp.linalg.solve(gram, theta @ target) @ theta
    return jnp.log(residual @ residual / shared.total + _TINY)


def _value_and_gradient(
    coded: dict[str, Any], p: Any, size: Any, shared: _Shared
) -> tuple[Any, Any]:
    """Return log L (sets,) and its gradient (sets, constants); inf and zero where not finite."""
    code = _code(coded, p, size)

    # Term by term: under vmap the interpreter's switch runs every primitive at every node.
    def pull_back(row: tuple[Any, ...]) -> Any:
        opcode, operand, constants, along = row
        run = functools.partial(run_term, opcode, operand, data=shared.data)
        return jax.vjp(run, constants)[1](along)[0]

    columns = jax.lax.map(lambda row: run_term(row[0], row[1], row[2], shared.data), code)
    columns = columns.reshape(*coded["used"].shape, -1)
    each = jax.vmap(jax.value_and_grad(_log_loss), in_axes=(0, 0, 0, 0, None))
    value, slope = each(columns, coded["used"], coded["basis"], coded["target"], shared)
    by_slot = jax.lax.map(pull_back, (*code, slope.reshape(-1, slope.shape[2])))
    by_slot = by_slot.reshape(len(p), -1)
    gradient = jax.vmap(lambda g, at: g.at[at].get(mode="fill", fill_value=0.0))
    gradient = gradient(by_slot, coded["place"]) * size
    return jnp.where(jnp.isfinite(value), value, jnp.inf), jnp.nan_to_num(
        gradient, nan=0.0, posinf=0.0, neginf=0.0
    )


@functools.cache
def _runner(method: str, iterations: int, rate: float) -> Any:
    search = _adam if method == "adam" else _lbfgs

    def run(coded: dict[str, Any], size: Any, shared: _Shared) -> Any:
        evaluate = functools.partial(_value_and_gradient, coded, size=size, shared=shared)
        return coded["start"] + size * search(evaluate, jnp.zeros_like(size), iterations, rate)

    return jax.jit(run)


def _adam(evaluate: Any, start: Any, iterations: int, rate: float) -> Any:
    # a cosine lets the last steps settle
    optimiser = optax.adam(optax.cosine_decay_schedule(rate, max(iterations, 1)))

    def step(carry: Any, _: None) -> Any:
        p, state, best, lowest = carry
        value, gradient = evaluate(p)
        better = value < lowest
        best, lowest = jnp.where(better[:, None], p, best), jnp.where(better, value, lowest)
        updates, state = optimiser.update(gradient, state, p)
        # from where nothing is finite the next step starts at the best
        p = jnp.where(jnp.isfinite(value)[:, None], p + updates, best)
        return (p, state, best, lowest), None

    first = (start, optimiser.init(start), start, jnp.full(len(start), jnp.inf))
    (_, _, best, _), _ = jax.lax.scan(step, first, None, length=iterations + 1)
    return best


def _lbfgs(evaluate: Any, start: Any, iterations: int, rate: float) -> Any:
    """Descend with a step that is halved until the loss falls, each set by itself."""
    memory = optax.scale_by_lbfgs()

    def step(carry: Any, _: None) -> Any:
        p, value, direction, state, length = carry
        trial = p - length[:, None] * direction
        found, gradient = evaluate(trial)
        better = found < value
        turned: Any
        turned, after = jax.vmap(memory.update)(gradient, state, trial)
        p, direction = (
            jnp.where(better[:, None], new, old) for new, old in ((trial, p), (turned, direction))
        )
        state = jax.tree.map(
            lambda new, old: jnp.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old),
            after,
            state,
        )
        length = jnp.where(better, 1.0, 0.5 * length)
        return (p, jnp.where(better, found, value), direction, state, length), None

    value, gradient = evaluate(start)
    state = jax.vmap(memory.init)(start)
    direction: Any
    direction, state = jax.vmap(memory.update)(gradient, state, start)
    # the first direction has no curvature behind it: a step of the learning rate
    size = jnp.sqrt(jnp.sum(direction**2, axis=1)) + _TINY
    carry = (start, value, direction, state, rate / size)
    (best, *_), _ = jax.lax.scan(step, carry, None, length=iterations)
    return best
