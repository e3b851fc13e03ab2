"""A field's steps as programs of the register machine (`machine_steps`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr._cores import cores, side_by_side, spans
from jaxsr._deadline import ask
from jaxsr._machine_code import compiled, kept, mark
from jaxsr.expressions.instructions import Instructions
from jaxsr.models.directions import Directions
from jaxsr.models.field import Field
from jaxsr.models.machine_steps import rk4_steps
from jaxsr.models.machine_tables import Code, Course
from jaxsr.models.parts import Part

Array = Any
CACHED, LEAST, MOST = 1 << 18, 32, 128
"""Numbers of a row of samples and all that is calculated of it, which a processor's cache holds;
samples of a row."""
TOGETHER = 100_000
"""Parts of samples that are followed between two looks at the clock."""
SHARED = 4_000
"""Parts of samples from which on both cores repay their change: a millisecond's."""


@dataclass(frozen=True, eq=False)
class Program:
    """Rates of a field, and rates with their derivatives, in one set of registers.

    Attributes
    ----------
    code : Code
    fixed : tuple of str
        Constants, in the order of `Code.fixed_at`.
    delayed : tuple of int
        Inputs of the rows of `Course.input_rates`.
    """

    code: Code
    fixed: tuple[str, ...]
    delayed: tuple[int, ...]

    @staticmethod
    def of(field: Field, to: Directions) -> Program | None:
        """Return the programs of a field; None where the machine has not what it calls."""
        rates, slopes = field.instructions("rates"), field.instructions("slopes")
        if rates is None or slopes is None:
            return None
        first = len(rates.preset)
        parts = (rates, 0), (slopes, first)
        rows = [_moved(part, by) for own, by in parts for part in (own.once, own.each)]
        model, (found, derivatives) = field.model, slopes.results
        place = {s: k for k, s in enumerate(to.states)}
        columns = {name: k - len(to.states) for name, k in to.columns.items()}
        late = {model.inputs[u]: d - len(to.states) for u, d in to.delays.items()}
        delayed = tuple(to.delays)
        number = {model.inputs[u]: k for k, u in enumerate(delayed)}
        by_state, by_parameter = [], []
        for i, row in enumerate(derivatives):
            for name, at in row.items():
                if name in place:
                    by_state.append((i, place[name], first + at))
                if name in columns:
                    by_parameter.append((i, columns[name], first + at, -1))
                if name in late:
                    by_parameter.append((i, late[name], first + at, number[name]))
        known = {model.time, *model.states, *model.inputs}
        fixed = [
            (name, by + at)
            for own, by in parts
            for name, at in own.given.items()
            if name not in known
        ]
        code = Code(
            instructions=np.concatenate(rows),
            bounds=np.cumsum([0, *map(len, rows)]),
            preset=np.concatenate([rates.preset, slopes.preset]),
            fixed_at=np.array([at for _, at in fixed], dtype=np.int64),
            time_at=_places(parts, [model.time]),
            states_at=_places(parts, model.states),
            inputs_at=_places(parts, model.inputs),
            rates_at=np.array([rates.results, [first + at for at in found]], dtype=np.int64),
            by_state=_table(by_state, 3),
            by_parameter=_table(by_parameter, 4),
        )
        return Program(code, tuple(name for name, _ in fixed), delayed)

    def run(
        self, field: Field, x: Sequence[Array], parts: Sequence[Part], directions: int
    ) -> tuple[Array, Array]:
        """Advance part by part.

        Parameters
        ----------
        x : sequence of ndarray, shape (steps, segments)
        parts : sequence of Part
        directions : int
            That states are differentiated by; 0 asks for no derivatives.

        Returns
        -------
        states : ndarray, shape (parts + 1, states, steps, segments)
        slopes : ndarray, shape (states, directions, steps, segments)
        """
        shape, n = np.shape(x[0]), len(x)
        flat = _Flat(shape)
        states = np.empty((len(parts) + 1, n, flat.samples))
        states[0] = flat(np.stack(x))
        slopes = np.empty((n, directions, flat.samples if directions else 0))
        constants = [field.constants[name] for name in self.fixed]
        wide = any(np.ndim(c) for c in constants)
        fixed = np.empty((len(constants), flat.samples if wide else 1))
        for row, value in zip(fixed, constants, strict=True):
            row[:] = flat(value) if np.ndim(value) else value
        code = self.code
        rows = len(code.preset) + 4 * (len(code.by_state) + len(code.by_parameter))
        width = CACHED // (rows + n * (directions + 3 * n) + 1) // LEAST * LEAST
        recursion = compiled(rk4_steps)
        assert recursion is not None
        course = self._course(parts, flat, len(field.model.inputs))
        width = min(max(width, LEAST), MOST)
        given = code, fixed, course, states, slopes
        size = max(TOGETHER // len(parts), 1)
        for first in range(0, flat.samples, size):
            ask()
            count = min(size, flat.samples - first)
            shares = spans(count, cores() if count * len(parts) > SHARED else 1, first)
            side_by_side(lambda span: recursion(*given, width, span), shares)
        known = slopes if directions else np.zeros((n, 0, flat.samples))
        return states.reshape(*states.shape[:2], *shape), known.reshape(n, directions, *shape)

    def _course(self, parts: Sequence[Part], flat: _Flat, inputs: int) -> Course:
        """Return the parts as the machine takes them."""
        wholes: list[Part] = []
        of = np.zeros(len(parts), dtype=np.int64)
        shares = np.empty((2, len(parts), flat.samples))
        for k, part in enumerate(parts):
            if not wholes or part.whole is not wholes[-1].whole:
                wholes.append(part)
            of[k] = len(wholes) - 1
            shares[0, k], shares[1, k] = flat(part.first), flat(part.last)
        times = np.empty((2, len(wholes), flat.samples))
        values = np.empty((3, inputs, len(wholes), flat.samples))
        rates = np.empty((3, len(self.delayed), len(wholes), flat.samples))
        for k, part in enumerate(wholes):
            times[0, k], times[1, k] = flat(part.time), flat(part.h)
            values[:, :, k] = flat(part.whole.values)
            for row, own in enumerate(self.delayed):
                rates[:, row, k] = flat(part.whole.rates[own])
        return Course(of, times, shares, values, rates)


@dataclass(frozen=True)
class _Flat:
    """Arrays of samples in one row."""

    shape: tuple[int, ...]

    @property
    def samples(self) -> int:
        return int(np.prod(self.shape))

    def __call__(self, value: Array) -> Array:
        if np.ndim(value) == 0:
            return value
        ahead = np.shape(value)[: -len(self.shape)]
        return np.broadcast_to(value, (*ahead, *self.shape)).reshape(*ahead, self.samples)


def compile_steps() -> None:
    """Compile the machine, once an installation: it takes ten seconds."""
    no, none = np.zeros((2, 0), np.int64), np.zeros((3, 0, 1, 1))
    table = np.zeros((0, 5), np.int64), np.zeros(5, np.int64), np.zeros(0)
    places = np.zeros(0, np.int64), np.full((2, 1), -1), no, no, no
    code = Code(*table, *places, _table([], 3), _table([], 4))
    course = Course(np.zeros(1, np.int64), np.ones((2, 1, 1)), np.ones((2, 1, 1)), none, none)
    states, slopes = np.zeros((2, 0, 1)), np.zeros((0, 0, 0))
    machine = compiled(rk4_steps)
    if machine is not None:
        machine(code, np.zeros((0, 1)), course, states, slopes, LEAST, (0, 1))
        mark(rk4_steps)


def program_of(field: Field, to: Directions | None) -> Program | None:
    """Return the programs of a field; None where they cannot be made, or the machine is not there.

    Where Numba is not installed it never is, and in the first runs of an installation not yet.
    """
    made = "from jaxsr.models.programs import compile_steps; compile_steps()"
    if kept(rk4_steps, made) is None:
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
