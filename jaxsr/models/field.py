"""A model's vector field and readings with their Jacobians, for many samples at once."""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.expressions import Term, evaluate
from jaxsr.expressions.instructions import Instructions
from jaxsr.expressions.slopes import Slopes, Valued, evaluate_with_slopes
from jaxsr.models.calculations import Calculations
from jaxsr.models.simulator import Simulator
from jaxsr.models.stepping import factorised, nothing

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

    Notes
    -----
    Where a width is 0 the sign is a constant of its own, one of `signs`, and differentiated by:
    `switching` says when it changes.
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
        self.switched = tuple(i for i, w in enumerate(widths) if np.ndim(w) == 0 and w == 0.0)
        self.signs = tuple(f"sign {i}" for i in self.switched)
        self.by = frozenset({*self.model.states, *active, *delayed, *self.signs})
        self._rows = tuple(s for s in self.model.states if s in self.model.inertia)
        self._guesses = tuple(f"rate of {s}" for s in self.model.states)
        known = {
            n: float(v)
            for n, v in self._constants.items()
            if n not in self.by and np.ndim(v) == 0 and v in (0.0, 1.0)
        }
        self._constants |= dict.fromkeys(self.signs, 1.0)
        known_values = tuple(sorted(known.items()))
        self._equations, self._mass, self._readings = _without(simulator, known_values)
        self._shared = _calculations(simulator, known_values, self.by)

    def by_states(self) -> Field:
        """Return the field differentiated by states alone."""
        own = copy.copy(self)
        own.by = frozenset(self.model.states)
        own._shared = _calculations(self.simulator, self._shared.key, own.by)
        return own

    def by_signs(self) -> Field:
        """Return the field differentiated by the signs of what jumps alone."""
        own = copy.copy(self)
        own.by = frozenset(self.signs)
        own._shared = _calculations(self.simulator, self._shared.key, own.by)
        return own

    def valued(self, constants: Mapping[str, Array]) -> Field:
        """Return the field with other values of some constants."""
        own = copy.copy(self)
        own._constants = {**self._constants, **constants}
        return own

    def picked(self, chosen: Array) -> Field:
        """Return the field at some of the samples: a mask over an array of them."""
        own = copy.copy(self)
        own._constants = {
            name: np.broadcast_to(v, chosen.shape)[chosen] if np.ndim(v) else v
            for name, v in self._constants.items()
        }
        return own

    def column(self, chosen: Array) -> Field:
        """Return the field at some of the samples, one below the other: shape (chosen, 1)."""
        own = self.picked(chosen)
        own._constants = {n: v[:, None] if np.ndim(v) else v for n, v in own._constants.items()}
        return own

    def rates(self, at: Point) -> list[Array]:
        """Return dx/dt, an array a state."""
        return self._whole(at, self._calculated(Field._rates, self.environment(at)))

    def slopes(self, at: Point) -> tuple[list[Array], list[Row]]:
        """Return dx/dt and, a row a state, its derivatives by states, parameters and inputs."""
        rates, rows = self._calculated(Field._slopes, self.environment(at))
        return self._whole(at, rates), rows

    def newton(
        self, at: Point, k: Sequence[Array], size: Array
    ) -> tuple[list[Array], list[Array], list[Row]]:
        """Return a Newton step of k = f(x + size k), x + size k being the states of the point.

        Returns
        -------
        left : list of ndarray
            f - k.
        step : list of ndarray
            (1 - size J)^-1 (f - k), J the derivatives of f by the states.
        rows : list of mapping
            Derivatives of f, as `slopes` returns them.
        """
        env = self.environment(at)
        env["size"] = size
        env.update(zip(self._guesses, k, strict=True))
        return self._calculated(Field._newton, env)

    def _rates(self, env: Mapping[str, Any]) -> list[Array]:
        shared: dict[Term, Any] = {}
        values = {s: evaluate(e, env, "numpy", shared) for s, e in self._equations.items()}
        if self._rows:
            matrix, loads = self._inertia(lambda term: evaluate(term, env, "numpy", shared))
            values |= self._accelerations(matrix, loads, values)
        return [values[s] for s in self.model.states]

    def _slopes(self, env: Mapping[str, Any]) -> tuple[list[Array], list[Row]]:
        shared: dict[Term, Any] = {}

        def valued(term: Term) -> tuple[Array, Slopes]:
            return evaluate_with_slopes(term, env, self.by, shared)

        found = {s: valued(e) for s, e in self._equations.items()}
        if self._rows:
            found |= self._solved(found, valued)
        states = self.model.states
        return [found[s][0] for s in states], [found[s][1] for s in states]

    def _newton(self, env: Mapping[str, Any]) -> tuple[list[Array], list[Array], list[Row]]:
        rates, rows = self._slopes(env)
        left = [f - env[k] for f, k in zip(rates, self._guesses, strict=True)]
        step = factorised(implicit(rows, self.model.states, env["size"]))(tuple(left))
        return left, list(step), rows

    def _calculated(self, what: Callable, env: Mapping[str, Any]) -> Any:
        return self._shared.calculated(what, functools.partial(what, self), env)

    @property
    def constants(self) -> Mapping[str, Array]:
        """Values of parameters, widths and signs."""
        return self._constants

    def instructions(self, what: str) -> Instructions | None:
        """Return the ``rates``, or rates and ``slopes``, as instructions; None without any."""
        called = Field._slopes if what == "slopes" else Field._rates
        moving = [self.model.time, *self.model.states, *self.model.inputs]
        names = [*self._constants, *moving]
        return self._shared.instructed(called, functools.partial(called, self), names, moving)

    def kept(self, key: Hashable, made: Callable[[], Any]) -> Any:
        """Return what fields share that differ by the values of their constants alone."""
        return self._shared.kept(key, made)

    def _whole(self, at: Point, values: Sequence[Array]) -> list[Array]:
        """Give numbers the shape of the states."""
        like = np.zeros(np.shape(at.states[0]))
        return [value + like for value in values]

    def forces(self, at: Point) -> dict[str, Valued]:
        """Return the right-hand sides with their slopes: generalised forces with a mass matrix."""
        shared: dict[Term, Valued] = {}
        env = self.environment(at)
        return {
            s: evaluate_with_slopes(e, env, self.by, shared) for s, e in self._equations.items()
        }

    def masses(self, at: Point) -> dict[tuple[str, str], Valued]:
        """Return the entries of the mass matrix with their slopes."""
        shared: dict[Term, Valued] = {}
        env = self.environment(at)
        return {
            (i, j): evaluate_with_slopes(term, env, self.by, shared)
            for i, row in self._mass.items()
            for j, term in row.items()
        }

    def evaluated(self, terms: Mapping[Any, Term], at: Point) -> dict[Any, Valued]:
        """Return other terms with their slopes."""
        shared: dict[Term, Valued] = {}
        env = self.environment(at)
        return {key: evaluate_with_slopes(t, env, self.by, shared) for key, t in terms.items()}

    def readings(self, at: Point) -> tuple[list[Array], list[Row]]:
        """Return what the sensors read, with derivatives."""
        shared: dict[Term, Any] = {}
        env = self.environment(at)
        pairs = [
            evaluate_with_slopes(self._readings[y], env, self.by, shared)
            for y in self.model.outputs
        ]
        like = np.zeros(np.shape(at.states[0]))
        return [value + like for value, _ in pairs], [slopes for _, slopes in pairs]

    def environment(self, at: Point) -> dict[str, Array]:
        """Return the values of all symbols at a point."""
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
        for i, row in enumerate(self.simulator.mass_rows):
            for column, term in self._mass[row].items():
                if column in rows:
                    matrix[i][rows.index(column)] = value(term)
                else:
                    loads[row, column] = value(term)
        return matrix, loads

    def _accelerations(self, matrix: Any, loads: Any, values: dict) -> dict:
        right = []
        for row in self.simulator.mass_rows:
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
        for row in self.simulator.mass_rows:
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
                if not nothing(value):
                    own[name] = value
        return {s: (rate, own) for s, rate, own in zip(self._rows, rates, solved, strict=True)}


def implicit(rows: Sequence[Row], states: Sequence[str], size: Array) -> list[list[Array]]:
    """Matrix 1 - size J; what does not depend on a state stays a number."""
    return [
        [float(i == j) - size * row[s] if s in row else float(i == j) for j, s in enumerate(states)]
        for i, row in enumerate(rows)
    ]


@functools.lru_cache(maxsize=512)
def _calculations(simulator: Simulator, known: tuple, by: frozenset[str]) -> Calculations:
    """Share the recordings of fields that differ by the values of their constants alone."""
    return Calculations(known)


@functools.lru_cache(maxsize=4096)
def _without(simulator: Simulator, known: tuple[tuple[str, float], ...]) -> tuple[Any, ...]:
    """Equations, mass matrix and readings in which mechanisms that are switched off are gone."""
    values, done = dict(known), dict[Term, Term]()
    signs = {n.removeprefix("width "): v for n, v in known if n.startswith("width ") and v == 0.0}
    equations, switched = simulator.smooth_equations, dict[Term, Term]()
    if signs:
        equations = {s: _switched(e, signs, switched) for s, e in equations.items()}
    return (
        {s: folded(e, values, done) for s, e in equations.items()},
        {
            i: {j: folded(e, values, done) for j, e in row.items()}
            for i, row in simulator.model.inertia_terms.items()
        },
        {y: folded(e, values, done) for y, e in simulator.smooth_readings.items()},
    )


def _switched(term: Term, signs: Collection[str], done: dict[Term, Term]) -> Term:
    """Put the variable ``sign i`` for a rounded sign of width i."""
    for node in term.upward(done):
        width = node.args[0].args[1] if node.op == "tanh" and node.args[0].op == "div" else None
        number = width.name.partition(" ")[2] if width is not None and width.is_variable else ""
        if number in signs and width is not None and width.name.startswith("width "):
            done[node] = Term.variable(f"sign {number}")
            continue
        args = tuple(done.get(arg, arg) for arg in node.args)
        done[node] = node if args == node.args else Term(node.op, args)
    return done.get(term, term)


def folded(term: Term, values: Mapping[str, float], done: dict[Term, Term] | None = None) -> Term:
    """Insert zeros and ones, and leave out what they make void.

    `done` holds subtrees met before and is filled on the way.
    """
    done = {} if done is None else done
    for node in term.upward(done):
        done[node] = _folded(node, values, done)
    return _inserted(term, values, done)


def _inserted(term: Term, values: Mapping[str, float], done: Mapping[Term, Term]) -> Term:
    if term.is_variable and term.name in values:
        return Term.constant(values[term.name])
    return done.get(term, term)


def _folded(term: Term, values: Mapping[str, float], done: Mapping[Term, Term]) -> Term:
    args = tuple(_inserted(arg, values, done) for arg in term.args)
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
