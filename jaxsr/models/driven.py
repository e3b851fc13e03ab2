"""Driven states: memories whose course the recorded inputs and the known states decide."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from jaxsr.models.directions import Directions, Stages
from jaxsr.models.field import Field, Point
from jaxsr.models.inputs import stage_inputs
from jaxsr.models.model import Model
from jaxsr.models.sensitivity import advanced, condensed
from jaxsr.models.simulator import Simulator
from jaxsr.models.states import StateEstimate

NEWTON_STEPS = 3  # one suffices where a memory is linear
ITERATIONS = 12
LARGEST = 1e9
STABLE = 1.0
"""Fading per sample up to which one RK4 step follows it well."""


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
    integrated with those and the inputs inserted (one step a sample).

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
    inputs : Stages
        Of the steps between samples.
    method : str
    """

    path: np.ndarray
    inputs: Stages
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
    count = len(model.driven)
    known = len(model.states) - count
    x = np.nan_to_num(item.states.values[:, :known])
    time, u = item.time, item.inputs
    field = Field(simulator, theta)
    to = Directions(tuple(model.states), {}, {}, tuple(model.inputs))
    table = [stage_inputs(time, column, model.input_hold, 1) for column in u.T]
    values = np.array([[c[s][:, 0] for c in table] for s in range(3)])[..., None]
    stages = Stages(values.reshape(3, len(table), time.size - 1, 1), {})
    path = np.zeros((len(model.states), time.size, 1))
    path[:known] = x.T[..., None]
    rest = _at_rest(field, time[0], x[0], u[0], count) if start is None else np.array(start)
    path[known:] = rest[:, None, None]
    length = np.diff(time)[:, None, None]
    method = _method(field, time, x[0], u[0], rest)
    with np.errstate(all="ignore"):
        for _ in range(ITERATIONS):
            ends, tangents = advanced(
                field, to, method, list(path[:, :-1]), time[:-1, None], length, lambda _: stages
            )
            slopes, defects = tangents, np.stack(ends) - path[:, 1:]
            slopes[:known], defects[:known] = 0.0, 0.0
            _, shift = condensed(slopes, defects)
            shift = np.clip(np.nan_to_num(shift[known:]), -LARGEST, LARGEST)
            path[known:] += shift
            size = np.abs(path[known:]).max() + 1e-300
            if np.abs(shift).max() < 1e-9 * size:
                break
    return _Course(path, stages, method)


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
    path, length = course.path, np.diff(time)[:, None, None]
    columns = {name: n + k for k, name in enumerate(chosen)}
    to = Directions(tuple(model.states), columns, {}, tuple(model.inputs))
    field = Field(simulator, theta, active=chosen)
    with np.errstate(all="ignore"):
        _, tangents = advanced(
            field,
            to,
            course.method,
            list(path[:, :-1]),
            time[:-1, None],
            length,
            lambda _: course.inputs,
        )
        tangents[:known] = 0.0
        spread, _ = condensed(tangents, np.zeros((n, time.size - 1, 1)))
        spread = np.clip(np.nan_to_num(spread[:, 0, known:]), -LARGEST, LARGEST)
    return path[known:, :, 0].T, spread[..., n:], spread[..., known:n]


def _method(field: Field, time: np.ndarray, x: np.ndarray, u: np.ndarray, z: np.ndarray) -> str:
    """RK4, or the L-stable method where a memory fades within a sample."""
    with np.errstate(all="ignore"):
        _, rows = field.slopes(Point(time[0], [*x, *z], list(u)))
    own = field.model.states[x.size :]
    rates = [abs(float(row.get(s, 0.0))) for s, row in zip(own, rows[x.size :], strict=True)]
    return "rk4" if max(rates) * float(np.median(np.diff(time))) < STABLE else "rodas3"


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
