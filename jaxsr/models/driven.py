"""Driven states: memories whose course the recorded inputs and the known states decide."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from scipy.sparse.csgraph import connected_components

from jaxsr.models.directions import Directions, Stages
from jaxsr.models.field import Field, Point
from jaxsr.models.following import stepped
from jaxsr.models.inputs import stage_inputs
from jaxsr.models.model import Model
from jaxsr.models.parts import Part
from jaxsr.models.programs import program_of
from jaxsr.models.sensitivity import condensed
from jaxsr.models.simulator import Simulator
from jaxsr.models.states import StateEstimate
from jaxsr.models.steps import METHODS
from jaxsr.models.transitions import Taken, transition

NEWTON_STEPS = 3  # one suffices where a memory is linear
ITERATIONS = 12
LARGEST = 1e9
STABLE, MOST_PARTS = 1.0, 16
"""Fading up to which one RK4 step follows it well, and the most steps of one sample."""


class Known(Protocol):
    """A recording as far as driven states go, see `Prepared`."""

    @property
    def time(self) -> np.ndarray: ...
    @property
    def inputs(self) -> np.ndarray: ...
    @property
    def states(self) -> StateEstimate: ...


def known_states(
    model: Model,
    item: Known,
    theta: np.ndarray | None = None,
    simulator: Any = None,
    start: np.ndarray | None = None,
) -> np.ndarray:
    """Return every state along a recording, shape (samples, states).

    The states read from the sensors come first, as `Prepared` has them; driven states follow,
    integrated with those and the inputs inserted.

    Parameters
    ----------
    model : Model
        A model whose driven states stand last.
    item : Prepared
        Prepared for `model` without its driven states, or for `model` itself.
    theta : ndarray, shape (parameters,), optional
        Parameters of the driven equations; the model's by default.
    start : ndarray, shape (driven,), optional
        Driven states at the first sample; at rest by default.
    """
    known = item.states.values[:, : len(model.states) - len(model.driven)]
    if not model.driven:
        return known
    simulator = simulator or Simulator(model)
    values = simulator.values() if theta is None else theta
    path = _course(simulator, item, tuple(float(v) for v in values), _as_key(start)).path
    return np.concatenate([known, path[known.shape[1] :, :, 0].T], axis=1)


def driven_states(
    simulator: Simulator,
    item: Known,
    theta: np.ndarray,
    chosen: tuple[str, ...],
    start: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the driven states along a recording, and how they follow parameters and their start.

    They begin at `start`, shape (driven,), or at rest.

    Returns
    -------
    path : ndarray, shape (samples, driven)
    slopes : ndarray, shape (samples, driven, chosen)
        Derivatives by the parameters `chosen`, the known states and the start held.
    by_start : ndarray, shape (samples, driven, driven)
        Derivatives by the start, the known states held.
    """
    return _path(simulator, item, tuple(float(v) for v in theta), chosen, _as_key(start))


def _as_key(start: np.ndarray | None) -> tuple[float, ...] | None:
    return None if start is None else tuple(float(v) for v in start)


@dataclass(frozen=True, eq=False)
class _Course:
    """All states along a recording, and how one sample leads to the next.

    Attributes
    ----------
    path : ndarray, shape (states, samples, 1)
    parts : list of Part
        Of the steps between samples.
    method : str
    """

    path: np.ndarray
    parts: list[Part]
    method: str


@functools.lru_cache(maxsize=64)
def _course(
    simulator: Simulator,
    item: Known,
    theta: tuple[float, ...],
    start: tuple[float, ...] | None = None,
) -> _Course:
    """Integrate the driven states along known ones.

    Newton's method on all samples at once (`lifting`), the known states held where they are.
    A recording is cut many times: its latest paths are kept.
    """
    model = simulator.model
    number = len(model.driven)
    known = len(model.states) - number
    x = np.nan_to_num(item.states.values[:, :known])
    time, u = item.time, item.inputs
    field = Field(simulator, theta)
    table = [stage_inputs(time, column, model.input_hold, 1) for column in u.T]
    values = np.array([[c[s][:, 0] for c in table] for s in range(3)])[..., None]
    stages = Stages(values.reshape(3, len(table), time.size - 1, 1), {})
    path = np.zeros((len(model.states), time.size, 1))
    path[:known] = x.T[..., None]
    rest = _at_rest(field, time[0], x[0], u[0], number) if start is None else np.array(start)
    path[known:] = rest[:, None, None]
    method, count = _method(field, time, x[0], u[0], rest)
    edges = [k / count for k in range(count + 1)]
    step = time[:-1, None], np.diff(time)[:, None]
    parts = [Part(stages, *step, *ends) for ends in pairwise(edges)]
    with np.errstate(all="ignore"):
        for _ in range(ITERATIONS):
            ends, blocks = _led(field, method, list(path[:, :-1]), parts, known)
            shift = np.zeros((number, *path.shape[1:]))
            for group, slopes in blocks:
                at = [i - known for i in group]
                defects = np.stack([ends[i] for i in group]) - path[list(group), 1:]
                shift[at] = condensed(slopes, defects)[1]
            shift = np.clip(np.nan_to_num(shift), -LARGEST, LARGEST)
            path[known:] += shift
            size = np.abs(path[known:]).max() + 1e-300
            if np.abs(shift).max() < 1e-9 * size:
                break
    return _Course(path, parts, method)


@functools.lru_cache(maxsize=64)
def _path(
    simulator: Simulator,
    item: Known,
    theta: tuple[float, ...],
    chosen: tuple[str, ...] = (),
    start: tuple[float, ...] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the driven states with their derivatives by parameters and by their start."""
    model, time = simulator.model, item.time
    n, known = len(model.states), len(model.states) - len(model.driven)
    course = _course(simulator, item, theta, start)
    path, field = course.path, Field(simulator, theta, active=chosen)
    by_start = np.zeros((time.size, n - known, n - known))
    by_parameter = np.zeros((time.size, n - known, len(chosen)))
    with np.errstate(all="ignore"):
        _, blocks = _led(field, course.method, list(path[:, :-1]), course.parts, known, chosen)
        for group, slopes in blocks:
            spread, _ = condensed(slopes, np.zeros((len(group), time.size - 1, 1)))
            spread = np.clip(np.nan_to_num(spread[:, 0]), -LARGEST, LARGEST)
            at = [i - known for i in group]
            by_start[:, np.array(at)[:, None], at] = spread[..., : len(group)]
            by_parameter[:, at] = spread[..., len(group) :]
    return path[known:, :, 0].T, by_parameter, by_start


Block = tuple[tuple[int, ...], np.ndarray]


def _led(
    field: Field,
    method: str,
    x: list[np.ndarray],
    parts: list[Part],
    known: int,
    chosen: tuple[str, ...] = (),
) -> tuple[list[np.ndarray], list[Block]]:
    """Return where a step leads, and how the driven states follow themselves and parameters.

    Returns
    -------
    ends : list of ndarray, shape (steps, 1)
        All states after the step.
    blocks : list of (tuple of int, ndarray)
        Positions of driven states that follow no others, and their derivatives by each other and
        by the parameters, shape (states, directions, steps, 1).
    """
    names, inputs = tuple(field.model.states), tuple(field.model.inputs)

    def by(states: tuple[str, ...]) -> Directions:
        return Directions(states, {c: len(states) + k for k, c in enumerate(chosen)}, {}, inputs)

    driven, shape = tuple(range(known, len(names))), np.shape(x[0])
    further = list(range(len(names), len(names) + len(chosen)))
    program = program_of(field, by(names)) if method == "rk4" else None
    if program is not None:
        along, slopes = program.run(field, x, parts, by(names).count)
        return list(along[-1]), [(driven, slopes[np.ix_(driven, [*driven, *further])])]
    along, taken = stepped(field, method, x, parts)
    tableau, groups = METHODS[method][0], _independent(taken, names, known)
    if groups is None:
        slopes = transition(tableau, by(names), taken, shape)
        return along[-1], [(driven, slopes[np.ix_(driven, [*driven, *further])])]
    return along[-1], [
        (group, transition(tableau, by(own), [part.of(group) for part in taken], shape))
        for group in groups
        for own in [tuple(names[i] for i in group)]
    ]


def _independent(
    taken: Sequence[Taken], names: tuple[str, ...], known: int
) -> list[tuple[int, ...]] | None:
    """Return driven states in groups none of which acts on another, also inside a step.

    None where one acts on a known state, and by that on the others.
    """
    driven = range(known, len(names))
    size = len(driven)
    acts = np.zeros((size, size), bool)
    for rows in (rows for part in taken for rows in part.rows):
        for row in rows[:known]:
            if any(names[j] in row and np.any(row[names[j]]) for j in driven):
                return None
        for i in driven:
            acts[i - known] |= [names[j] in rows[i] for j in driven]
    count, label = connected_components(acts, directed=False)
    return [tuple(known + int(i) for i in np.flatnonzero(label == k)) for k in range(count)]


def _method(
    field: Field, time: np.ndarray, x: np.ndarray, u: np.ndarray, z: np.ndarray
) -> tuple[str, int]:
    """RK4 and its steps a sample, or the L-stable method where a memory fades much faster."""
    with np.errstate(all="ignore"):
        _, rows = field.slopes(Point(time[0], [*x, *z], list(u)))
    own = field.model.states[x.size :]
    rates = [abs(float(row.get(s, 0.0))) for s, row in zip(own, rows[x.size :], strict=True)]
    fading = max(rates) * float(np.median(np.diff(time))) / STABLE
    if not fading <= MOST_PARTS:
        return "rodas3", 1
    return "rk4", 2 ** int(np.ceil(np.log2(max(fading, 1.0))))


def _at_rest(field: Field, t: float, x: np.ndarray, u: np.ndarray, count: int) -> np.ndarray:
    """Where the memories have settled if all has stood still with the first sample's values."""
    model = field.model
    moving = [model.kinematic_parent(s) is not None for s in model.states[: x.size]]
    known = np.where(moving, 0.0, x)
    own = model.states[x.size :]
    z = np.zeros(count)
    for _ in range(NEWTON_STEPS):
        with np.errstate(all="ignore"):
            rates, rows = field.slopes(Point(t, [*known, *z], list(u)))
        slope = np.array([[float(row.get(s, 0.0)) for s in own] for row in rows[x.size :]])
        # A memory that standstill leaves where it is (a zero row) stays at zero.
        z = z - np.linalg.pinv(np.nan_to_num(slope)) @ np.nan_to_num(rates[x.size :])
    return z
