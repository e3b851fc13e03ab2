"""A field's steps as programs of the register machine (`machine_steps`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr._machine_code import compiled
from jaxsr.expressions.instructions import Instructions
from jaxsr.models.directions import Directions, Stages
from jaxsr.models.field import Field
from jaxsr.models.machine_steps import rk4_steps

Array = Any
CACHED, LEAST, MOST = 1 << 16, 8, 128
"""Numbers of a row of samples and all that is calculated of it, which a processor's cache holds;
samples of a row."""


@dataclass(frozen=True, eq=False)
class Span:
    """A step of every sample.

    Attributes
    ----------
    begin, length : ndarray, shape (steps, segments)
    stages : Stages
        Inputs along it.
    """

    begin: Array
    length: Array
    stages: Stages


@dataclass(frozen=True, eq=False)
class Program:
    """Rates of a field, and rates with their derivatives, in one set of registers.

    Attributes
    ----------
    code, bounds, preset, time_at, states_at, inputs_at, rates_at, by_state, by_parameter : ndarray
        As `rk4_steps` has them.
    fixed : tuple of (str, int)
        Names of constants, and their registers.
    delayed : tuple of int
        Inputs of the rows of `input_rates`.
    """

    code: Array
    bounds: Array
    preset: Array
    time_at: Array
    states_at: Array
    inputs_at: Array
    rates_at: Array
    by_state: Array
    by_parameter: Array
    fixed: tuple[tuple[str, int], ...]
    delayed: tuple[int, ...]

    @staticmethod
    def of(field: Field, to: Directions) -> Program | None:
        """Return the programs of a field; None where the machine has not what it calls."""
        rates, slopes = field.instructions("rates"), field.instructions("slopes")
        if rates is None or slopes is None:
            return None
        first = len(rates.preset)
        parts = (
            (rates, 0),
            (slopes, first),
        )
        code = [_moved(rows, by) for own, by in parts for rows in (own.once, own.each)]
        model = field.model
        found, rows = slopes.results
        place = {s: k for k, s in enumerate(to.states)}
        own_rows = [(i, name, first + at) for i, row in enumerate(rows) for name, at in row.items()]
        columns = {name: k - len(to.states) for name, k in to.columns.items()}
        late = {model.inputs[u]: (d - len(to.states), u) for u, d in to.delays.items()}
        delayed = tuple(to.delays)
        by_parameter = [(i, columns[n], at, -1) for i, n, at in own_rows if n in columns]
        by_parameter += [
            (i, late[n][0], at, delayed.index(late[n][1])) for i, n, at in own_rows if n in late
        ]
        known = {model.time, *model.states, *model.inputs}
        return Program(
            code=np.concatenate(code),
            bounds=np.cumsum([0, *(len(rows) for rows in code)]),
            preset=np.concatenate([rates.preset, slopes.preset]),
            time_at=_places(parts, [model.time])[:, 0],
            states_at=_places(parts, model.states),
            inputs_at=_places(parts, model.inputs),
            rates_at=np.array([rates.results, [first + at for at in found]], dtype=np.int64),
            by_state=_table([(i, place[n], at) for i, n, at in own_rows if n in place], 3),
            by_parameter=_table(by_parameter, 4),
            fixed=tuple(
                (name, by + at)
                for own, by in parts
                for name, at in own.given.items()
                if name not in known
            ),
            delayed=delayed,
        )

    def run(
        self, field: Field, x: Sequence[Array], spans: Sequence[Span], directions: int
    ) -> tuple[Array, Array]:
        """Advance by all steps.

        Parameters
        ----------
        x : sequence of ndarray, shape (steps, segments)
        spans : sequence of Span
        directions : int
            That states are differentiated by; 0 asks for no derivatives.

        Returns
        -------
        states : ndarray, shape (spans + 1, states, steps, segments)
        slopes : ndarray, shape (states, directions, steps, segments)
        """
        shape, n = np.shape(x[0]), len(x)
        samples = int(np.prod(shape))

        def flat(value: Array) -> Array:
            wide = np.broadcast_to(value, (*np.shape(value)[: -len(shape)], *shape))
            return wide.reshape(*wide.shape[: -len(shape)], samples)

        states = np.empty((len(spans) + 1, n, samples))
        states[0] = flat(np.stack(x))
        length = np.stack([flat(s.length) for s in spans])
        begin = np.stack([flat(s.begin) for s in spans])
        inputs = np.empty((3, len(field.model.inputs), len(spans), samples))
        for s, span in enumerate(spans):
            inputs[:, :, s] = flat(span.stages.values)
        rates = np.empty((3, len(self.delayed) if directions else 0, len(spans), samples))
        for k in range(rates.shape[1]):
            for s, span in enumerate(spans):
                rates[:, k, s] = flat(span.stages.rates[self.delayed[k]])
        slopes = np.empty((n, directions, samples if directions else 0))
        constants = [field.constants[name] for name, _ in self.fixed]
        wide = any(np.ndim(c) for c in constants)
        fixed = np.empty((len(constants), samples if wide else 1))
        for row, value in zip(fixed, constants, strict=True):
            row[:] = flat(value) if np.ndim(value) else value
        rows = len(self.preset) + 4 * (len(self.by_state) + len(self.by_parameter))
        width = CACHED // (rows + n * (directions + 3 * n) + 1) // LEAST * LEAST
        recursion = compiled(rk4_steps)
        assert recursion is not None
        recursion(
            self.code,
            self.bounds,
            self.preset,
            np.array([at for _, at in self.fixed], dtype=np.int64),
            fixed,
            self.time_at,
            self.states_at,
            self.inputs_at,
            self.rates_at,
            self.by_state,
            self.by_parameter,
            begin,
            length,
            inputs,
            rates,
            states,
            slopes,
            min(max(width, LEAST), MOST),
        )
        known = slopes if directions else np.zeros((n, 0, samples))
        return states.reshape(*states.shape[:2], *shape), known.reshape(n, directions, *shape)


def program_of(field: Field, to: Directions | None) -> Program | None:
    """Return the programs of a field; None where Numba is not installed, or they cannot be made."""
    if compiled(rk4_steps) is None:
        return None
    to = Directions(tuple(field.model.states), {}, {}, ()) if to is None else to
    key = to.states, tuple(to.columns.items()), tuple(to.delays.items())
    return field.kept(key, lambda: Program.of(field, to))


def _moved(rows: Array, by: int) -> Array:
    """Return instructions with their registers moved."""
    return rows + by * (np.arange(rows.shape[1]) > 0)


def _places(parts: Sequence[tuple[Instructions, int]], names: Sequence[str]) -> Array:
    found = [[own.given.get(n, -1 - by) + by for n in names] for own, by in parts]
    return np.array(found, dtype=np.int64).reshape(len(parts), len(names))


def _table(rows: Sequence[tuple[int, ...]], width: int) -> Array:
    return np.array(rows, dtype=np.int64).reshape(-1, width)
