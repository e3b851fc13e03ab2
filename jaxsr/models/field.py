"""A model's vector field and readings with their Jacobians, for many samples at once."""

from __future__ import annotations

import copy
import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.expressions import Term, evaluate
from jaxsr.expressions.slopes import Slopes, Valued, evaluate_with_slopes
from jaxsr.models.simulator import Simulator
from jaxsr.models.stepping import factorised

Array = Any
Row = Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Point:
    """Where a field is evaluated: time, states, inputs and parameters, arrays of one shape."""

    time: Array
    states: Sequence[Array]
    inputs: Sequence[Array]


class Field:
    """The formulas of a simulator in NumPy, parameter values inserted.

    Parameters
    ----------
    simulator : Simulator
        Without a Python function.
    theta : sequence of array or float
        Value of every parameter of the model; numbers, or arrays like the states.
    widths : sequence of float
        Of smoothed sign and Heaviside.
    active : sequence of str
        Parameters to differentiate by.
    delayed : sequence of str
        Inputs to differentiate by.
    """

    def __init__(
        self,
        simulator: Simulator,
        theta: Sequence[Array],
        widths: Sequence[float] = (),
        active: Sequence[str] = (),
        delayed: Sequence[str] = (),
    ) -> None:
        self.simulator, self.model = simulator, simulator.model
        widths = widths or simulator.default_widths
        self._constants = dict(zip(self.model.parameters, theta, strict=True))
        self._constants |= {f"width {i}": w for i, w in enumerate(widths)}
        self.by = frozenset({*self.model.states, *active, *delayed})
        self._rows = tuple(s for s in self.model.states if s in self.model.inertia)
        known = {
            n: float(v)
            for n, v in self._constants.items()
            if n not in self.by and np.ndim(v) == 0 and v in (0.0, 1.0)
        }
        self._equations, self._mass, self._readings = _without(
            simulator, tuple(sorted(known.items()))
        )

    def picked(self, chosen: Array) -> Field:
        """Return the field at some of the samples: a mask over an array of them."""
        own = copy.copy(self)
        own._constants = {
            name: np.broadcast_to(v, chosen.shape)[chosen] if np.ndim(v) else v
            for name, v in self._constants.items()
        }
        return own

    def rates(self, at: Point) -> list[Array]:
        """Return dx/dt, an array a state."""
        shared: dict[Term, Any] = {}
        env = self._environment(at)
        values = {s: evaluate(e, env, "numpy", shared) for s, e in self._equations.items()}
        if self._rows:
            matrix, loads = self._inertia(lambda term: evaluate(term, env, "numpy", shared))
            values |= self._accelerations(matrix, loads, values)
        like = np.zeros(np.shape(at.states[0]))
        return [values[s] + like for s in self.model.states]

    def slopes(self, at: Point) -> tuple[list[Array], list[Row]]:
        """Return dx/dt and, a row a state, its derivatives by states, parameters and inputs."""
        shared: dict[Term, Any] = {}
        env = self._environment(at)

        def valued(term: Term) -> tuple[Array, Slopes]:
            return evaluate_with_slopes(term, env, self.by, shared)

        found = {s: valued(e) for s, e in self._equations.items()}
        if self._rows:
            found |= self._solved(found, valued)
        like = np.zeros(np.shape(at.states[0]))
        return [found[s][0] + like for s in self.model.states], [
            found[s][1] for s in self.model.states
        ]

    def forces(self, at: Point) -> dict[str, Valued]:
        """Return the right-hand sides with their slopes: generalised forces with a mass matrix."""
        shared: dict[Term, Valued] = {}
        env = self._environment(at)
        return {
            s: evaluate_with_slopes(e, env, self.by, shared) for s, e in self._equations.items()
        }

    def masses(self, at: Point) -> dict[tuple[str, str], Valued]:
        """Return the entries of the mass matrix with their slopes."""
        shared: dict[Term, Valued] = {}
        env = self._environment(at)
        return {
            (i, j): evaluate_with_slopes(term, env, self.by, shared)
            for i, row in self._mass.items()
            for j, term in row.items()
        }

    def readings(self, at: Point) -> tuple[list[Array], list[Row]]:
        """Return what the sensors read, with derivatives."""
        shared: dict[Term, Any] = {}
        env = self._environment(at)
        pairs = [
            evaluate_with_slopes(self._readings[y], env, self.by, shared)
            for y in self.model.outputs
        ]
        like = np.zeros(np.shape(at.states[0]))
        return [value + like for value, _ in pairs], [slopes for _, slopes in pairs]

    def _environment(self, at: Point) -> dict[str, Array]:
        model = self.model
        env = {model.time: at.time, **self._constants}
        env.update(zip(model.states, at.states, strict=True))
        env.update(zip(model.inputs, at.inputs, strict=True))
        return env

    def _inertia(self, value: Any) -> tuple[list[list[Any]], dict[tuple[str, str], Any]]:
        """Entries of the mass matrix, and those that multiply rates known beforehand."""
        rows = self._rows
        matrix: list[list[Any]] = [[0.0 for _ in rows] for _ in rows]
        loads = {}
        for i, row in enumerate(rows):
            for column, term in self._mass[row].items():
                if column in rows:
                    matrix[i][rows.index(column)] = value(term)
                else:
                    loads[row, column] = value(term)
        return matrix, loads

    def _accelerations(self, matrix: Any, loads: Any, values: dict) -> dict:
        right = []
        for row in self._rows:
            known = sum(m * values[c] for (r, c), m in loads.items() if r == row)
            right.append(values[row] - known)
        return dict(zip(self._rows, factorised(matrix)(tuple(right)), strict=True))

    def _solved(self, found: dict, valued: Any) -> dict:
        """Solve the mass matrix for the rates and, M a' = f' - M' a, for their slopes."""
        matrix, loads = self._inertia(valued)
        # An entry that is not there is the number 0, others are (value, slopes).
        entries = [[m if isinstance(m, tuple) else (0.0, {}) for m in row] for row in matrix]
        solve = factorised([[m for m, _ in row] for row in entries])
        right, parts = [], []
        for row in self._rows:
            force, slopes = found[row]
            for (r, c), (mass, by) in loads.items():
                if r == row:
                    rate, own = found[c]
                    force = force - mass * rate
                    slopes = _less(slopes, by, rate)
                    slopes = _less(slopes, own, mass)
            right.append(force)
            parts.append(slopes)
        rates = solve(tuple(right))
        for i in range(len(self._rows)):
            for j, rate in enumerate(rates):
                parts[i] = _less(parts[i], entries[i][j][1], rate)
        solved: list[Slopes] = [{} for _ in self._rows]
        for name in dict.fromkeys(n for part in parts for n in part):
            column = solve(tuple(part.get(name, 0.0) for part in parts))
            for own, value in zip(solved, column, strict=True):
                if np.ndim(value) or value != 0.0:
                    own[name] = value
        return {s: (rate, own) for s, rate, own in zip(self._rows, rates, solved, strict=True)}


@functools.lru_cache(maxsize=4096)
def _without(simulator: Simulator, known: tuple[tuple[str, float], ...]) -> tuple[Any, ...]:
    """Equations, mass matrix and readings in which mechanisms that are switched off are gone."""
    values, done = dict(known), dict[Term, Term]()
    return (
        {s: folded(e, values, done) for s, e in simulator.smooth_equations.items()},
        {
            i: {j: folded(e, values, done) for j, e in row.items()}
            for i, row in simulator.model.inertia_terms.items()
        },
        {y: folded(e, values, done) for y, e in simulator.smooth_readings.items()},
    )


def folded(term: Term, values: Mapping[str, float], done: dict[Term, Term] | None = None) -> Term:
    """Insert zeros and ones, and leave out what they make void.

    `done` holds subtrees met before and is filled on the way.
    """
    if term.is_variable and term.name in values:
        return Term.constant(values[term.name])
    if not term.args:
        return term
    done = {} if done is None else done
    if term not in done:
        done[term] = _folded(term, values, done)
    return done[term]


def _folded(term: Term, values: Mapping[str, float], done: dict[Term, Term]) -> Term:
    args = tuple(folded(arg, values, done) for arg in term.args)
    zero = [a.is_constant and a.value == 0.0 for a in args]
    one = [a.is_constant and a.value == 1.0 for a in args]
    match term.op:
        case "mul" if any(zero):
            return Term.constant(0.0)
        case "mul" if any(one):
            return args[1] if one[0] else args[0]
        case "add" if any(zero):
            return args[1] if zero[0] else args[0]
        case "sub" if zero[1]:
            return args[0]
        case "sub" if zero[0]:
            return Term.apply("neg", args[1])
        case "div" if zero[0]:
            return args[0]
        case "neg" if zero[0]:
            return args[0]
    return term if args == term.args else Term(term.op, args)


def _less(slopes: Slopes, other: Slopes, factor: Array) -> Slopes:
    """Return slopes - factor * other."""
    result = dict(slopes)
    for name, slope in other.items():
        result[name] = result.get(name, 0.0) - factor * slope
    return result
