"""The weak view of a simulator: generalised forces against test functions, linearised."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jaxsr.diagnosis.weak.weak_grid import WeakGrid
from jaxsr.models.balance import Balance
from jaxsr.models.driven import known_states
from jaxsr.models.field import Field, Point
from jaxsr.models.model import Model
from jaxsr.models.segments import Prepared, values_of
from jaxsr.models.simulator import Simulator, width_scales
from jaxsr.views import WeakView


@dataclass(frozen=True, eq=False)
class WeakSystem:
    r"""Residuals of the equations of motion in the weak view and their derivatives.

    Row (recording, state i, test function phi) holds

        residual = int phi (equations_i - sum_j inertia_ij dx_j/dt) dt,

    with derivatives of measured states moved onto phi by parts.

    Attributes
    ----------
    residual : ndarray, shape (rows,)
        At the parameter values `theta`.
    jacobian : ndarray, shape (rows, parameters)
        Derivative of `residual` by the parameters.
    input_side : ndarray, shape (rows,)
        The part of the equation that the inputs bring; the measure of the relative force error.
    state : ndarray of int, shape (rows,)
        Index of the equation's state.
    recording, centre : ndarray, shape (rows,)
        Which recording, and the centre of phi in seconds.
    row : ndarray of int, shape (rows,)
        Row of the `WeakGrid`: equations whose sensors drop samples have fewer than others.
    theta : ndarray, shape (parameters,)
    half_width : float
    """

    residual: np.ndarray
    jacobian: np.ndarray
    input_side: np.ndarray
    state: np.ndarray
    recording: np.ndarray
    centre: np.ndarray
    row: np.ndarray
    theta: np.ndarray
    half_width: float

    def at(self, theta: np.ndarray) -> np.ndarray:
        """Return the residual at other parameter values, to first order."""
        return self.residual + self.jacobian @ (theta - self.theta)

    def only(self, states: np.ndarray) -> WeakSystem:
        """Return the equations of some states alone."""
        rows = np.isin(self.state, states)
        names = "residual", "jacobian", "input_side", "state", "recording", "centre", "row"
        return replace(self, **{name: getattr(self, name)[rows] for name in names})


def weak_system(
    simulator: Simulator,
    grid: WeakGrid,
    theta: np.ndarray,
    states: Sequence[str] | None = None,
) -> WeakSystem:
    """Build the weak view of equations over all recordings.

    Parameters
    ----------
    simulator : Simulator
        Of the grid's model, or of an edit of it.
    grid : WeakGrid
        Decides by its own model which equation has which rows.
    theta : ndarray, shape (parameters,)
    states : sequence of str, optional
        Whose equations; all that the grid's sensors show by default.
    """
    states = grid.observable if states is None else tuple(states)
    theta = np.asarray(theta, float)
    none = np.zeros(0)
    parts: list[tuple[np.ndarray, ...]] = [
        (none, np.zeros((0, theta.size)), none, none, none, none, none)
    ]
    for number, view in enumerate(grid.views):
        known = {s: grid.known(number, s) for s in states}
        if view is not None and any(rows.any() for rows in known.values()):
            parts.append(_one_recording(simulator, grid, number, theta, known))
    residual, jacobian, input_side, state, recording, centre, row = (
        np.concatenate(part) for part in zip(*parts, strict=True)
    )
    return WeakSystem(
        residual=residual,
        jacobian=jacobian,
        input_side=input_side,
        state=state.astype(int),
        recording=recording.astype(int),
        centre=centre,
        row=row.astype(int),
        theta=theta,
        half_width=grid.half_width,
    )


def _one_recording(
    simulator: Simulator,
    grid: WeakGrid,
    number: int,
    theta: np.ndarray,
    known: Mapping[str, np.ndarray],
) -> tuple[np.ndarray, ...]:
    model, item, view = simulator.model, grid.prepared[number], grid.views[number]
    assert view is not None
    own = values_of(model, item.recording.name)
    given = np.isfinite(own)
    theta = np.where(given, own, theta)
    states = tuple(s for s, rows in known.items() if rows.any())
    path = known_states(model, item, theta, simulator)
    x = tuple(np.where(np.isfinite(c), c, 0.0) for c in path.T)
    u = tuple(centred(column, model.input_hold) for column in item.inputs.T)
    env = simulator.environment(item.time, x, u, tuple(theta))
    widths = width_scales(simulator, env)

    value, silent, slope = _pieces(simulator, item.time, (x, u), theta, widths, states)
    rows = [np.flatnonzero(known[s]) for s in states]
    blocks = []
    for state, mine in zip(states, rows, strict=True):
        parts = _equation(model, view, item, state, value, silent, slope)
        blocks.append([part[view.valid][mine] for part in parts])
    order = np.concatenate(rows)
    return (
        np.concatenate([b[0] for b in blocks]),
        np.concatenate([b[1] for b in blocks]) * ~given,
        np.concatenate([b[2] for b in blocks]),
        np.repeat([model.states.index(s) for s in states], [r.size for r in rows]),
        np.full(order.size, number),
        view.centres[view.valid][order],
        grid.first[number] + order,
    )


Pieces = tuple[dict, dict, dict]
"""Forces and masses along a recording, forces without inputs, and slopes by the parameters."""


def _pieces(
    simulator: Simulator,
    time: np.ndarray,
    signals: tuple[tuple, tuple],
    theta: np.ndarray,
    widths: tuple[float, ...],
    states: tuple[str, ...],
) -> Pieces:
    x, u = signals
    order = list(simulator.model.parameters)
    field = Field(simulator, [float(v) for v in theta], widths, order)
    at = Point(time, list(x), list(u))
    with np.errstate(all="ignore"):
        found, masses = field.forces(at), field.masses(at)
        still = Point(time, list(x), [0.0 * a for a in u])
        quiet = field.forces(still)
        balance = Balance.of(simulator.model)
        if balance is not None:
            gains = field.evaluated(balance.gains, at)
            forces, weighed = balance.weighed(gains, found, time.size)
            found, masses = found | forces, masses | weighed  # rows of [inertia] keep their own
            quiet |= balance.weighed(gains, quiet, time.size)[0]

    def wide(value: Any) -> np.ndarray:
        return np.broadcast_to(np.asarray(value, dtype=float), time.shape)

    def table(slopes: Mapping[str, Any]) -> np.ndarray:
        columns = np.zeros((time.size, theta.size))
        for name in order:
            if name in slopes:
                columns[:, order.index(name)] = slopes[name]
        return columns

    return (
        {
            "forces": {s: wide(found[s][0]) for s in states},
            "mass": {key: wide(v) for key, (v, _) in masses.items()},
        },
        {s: wide(quiet[s][0]) for s in states},
        {
            "forces": {s: table(found[s][1]) for s in states},
            "mass": {key: table(by) for key, (_, by) in masses.items()},
        },
    )


def centred(u: np.ndarray, hold: str) -> np.ndarray:
    """Return an input as the quadrature needs it: a held one jumps at its sample, so take the mean.

    The sample at t_k of a zero-order hold acts from t_k on; the trapezoid rule would let it act
    half a sample earlier.
    """
    if hold != "zero":
        return u
    return np.concatenate([u[:1], 0.5 * (u[:-1] + u[1:])])


def _equation(
    model: Model,
    view: WeakView,
    item: Prepared,
    state: str,
    value: dict,
    silent: dict,
    slope: dict,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residual, its derivative and the input side of one equation."""
    force = value["forces"][state]
    residual = view.integrate(force)
    jacobian = view.integrate(np.nan_to_num(slope["forces"][state]))
    row, balance = tuple(model.inertia.get(state, ())), Balance.of(model)
    if balance is not None and state in balance.states:
        row = balance.row(state)
    for column in row or (state,):
        mass = value["mass"][(state, column)] if row else np.ones_like(force)
        residual = residual - inertia_force(model, view, item, column, mass[:, None])[:, 0]
        if row:
            by_theta = slope["mass"][(state, column)]
            jacobian = jacobian - inertia_force(model, view, item, column, by_theta)
    with np.errstate(invalid="ignore"):  # a law may be infinite with and without the input
        driven = force - silent[state]
    return residual, jacobian, view.integrate(driven)


def inertia_force(
    model: Model, view: WeakView, item: Prepared, state: str, mass: np.ndarray
) -> np.ndarray:
    """Return int phi m dx/dt for mass columns m (samples, columns), by parts.

    int phi m dv/dt = - int phi' m v - int phi m' v; where v = dq/dt and q is measured, once
    more: = int phi'' m q + int phi' m' q - int phi m' v. A constant mass needs no m'.
    """
    index = model.states.index(state)
    v = np.nan_to_num(item.states.values[:, index])
    parent = model.kinematic_parent(state)
    varying = np.ptp(mass, axis=0) > 1e-12 * (np.abs(mass).max(axis=0) + 1e-300)
    rate = np.where(varying, np.gradient(mass, item.time, axis=0), 0.0)
    moment = view.integrate(rate * v[:, None]) if varying.any() else 0.0
    if parent in item.states.measured and state not in item.states.measured:
        q = np.nan_to_num(item.states.measured[parent])
        twice = view.integrate(mass * q[:, None], 2)
        # integrate(., 1) = - int phi' (.)
        return twice - view.integrate(rate * q[:, None], 1) - moment
    signal = np.nan_to_num(item.states.measured.get(state, v))
    return view.integrate(mass * signal[:, None], 1) - moment
