"""The weak view of a simulator: generalised forces against test functions, linearised."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

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
    theta : ndarray, shape (parameters,)
    half_width : float
    """

    residual: np.ndarray
    jacobian: np.ndarray
    input_side: np.ndarray
    state: np.ndarray
    recording: np.ndarray
    centre: np.ndarray
    theta: np.ndarray
    half_width: float

    def at(self, theta: np.ndarray) -> np.ndarray:
        """Return the residual at other parameter values, to first order."""
        return self.residual + self.jacobian @ (theta - self.theta)

    def only(self, states: np.ndarray) -> WeakSystem:
        """Return the equations of some states alone."""
        rows = np.isin(self.state, states)
        names = "residual", "jacobian", "input_side", "state", "recording", "centre"
        return replace(self, **{name: getattr(self, name)[rows] for name in names})


def observable_states(simulator: Simulator, prepared: Sequence[Prepared]) -> tuple[str, ...]:
    """Return the dynamic states whose equation needs no hidden state."""
    hidden = set().union(*(item.states.hidden for item in prepared))
    model = simulator.model
    names, balance = [], Balance.of(model)
    for state in model.dynamic_states:
        used = set(model.equation_terms[state].variables) | {state}
        if balance is not None and state in balance.states:
            beside = balance.row(state)
            used |= set(beside).union(*(model.equation_terms[s].variables for s in beside))
        for column, term in model.inertia_terms.get(state, {}).items():
            used |= term.variables | {column}
        if not used & hidden:
            names.append(state)
    return tuple(names)


def weak_system(
    simulator: Simulator,
    prepared: Sequence[Prepared],
    theta: np.ndarray,
    half_width: float,
    spacing: float | None = None,
) -> WeakSystem:
    """Build the weak view of every observable equation over all recordings."""
    states = observable_states(simulator, prepared)
    parts = [
        _one_recording(simulator, item, np.asarray(theta, float), half_width, spacing, states)
        for item in prepared
    ]
    rows = [p[0].size for p in parts]
    return WeakSystem(
        residual=np.concatenate([p[0] for p in parts]),
        jacobian=np.concatenate([p[1] for p in parts]),
        input_side=np.concatenate([p[2] for p in parts]),
        state=np.concatenate([p[3] for p in parts]),
        centre=np.concatenate([p[4] for p in parts]),
        recording=np.repeat(np.arange(len(parts)), rows),
        theta=np.asarray(theta, float),
        half_width=half_width,
    )


def _one_recording(
    simulator: Simulator,
    item: Prepared,
    theta: np.ndarray,
    half_width: float,
    spacing: float | None,
    states: tuple[str, ...],
) -> tuple[np.ndarray, ...]:
    model = simulator.model
    own = values_of(model, item.recording.name)
    given = np.isfinite(own)
    theta = np.where(given, own, theta)
    present = np.asarray(np.isfinite(item.states.values).all(1))
    for state, signal in item.states.measured.items():
        if state in model.states:
            present = np.asarray(present & np.isfinite(signal))
    view = WeakView.build(item.time, half_width, spacing or half_width / 4, mask=present)
    known = known_states(model, item, theta, simulator)
    x = tuple(np.where(np.isfinite(c), c, 0.0) for c in known.T)
    u = tuple(centred(column, model.input_hold) for column in item.inputs.T)
    env = simulator.environment(item.time, x, u, tuple(theta))
    widths = width_scales(simulator, env)

    describe = _by_formula if simulator.function is None else _by_function
    value, silent, slope = describe(simulator, item.time, (x, u), theta, widths, states)
    blocks = [_equation(model, view, item, s, value, silent, slope) for s in states]
    if not blocks:
        none = np.zeros(0)
        return none, np.zeros((0, len(theta))), none, none.astype(int), none
    good = view.valid
    count = int(good.sum())
    index = [model.states.index(s) for s in states]
    return (
        np.concatenate([b[0][good] for b in blocks]),
        np.concatenate([b[1][good] for b in blocks]) * ~given,
        np.concatenate([b[2][good] for b in blocks]),
        np.repeat(index, count),
        np.tile(view.centres[good], len(states)),
    )


Pieces = tuple[dict, dict, dict]
"""Forces and masses along a recording, forces without inputs, and slopes by the parameters."""


def _by_formula(
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
            forces, masses = balance.weighed(gains, found, time.size)
            found |= forces
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


def _by_function(
    simulator: Simulator,
    time: np.ndarray,
    signals: tuple[tuple, tuple],
    theta: np.ndarray,
    widths: tuple[float, ...],
    states: tuple[str, ...],
) -> Pieces:
    x, u = signals
    model = simulator.model

    def pieces(values: jax.Array, scale: float) -> dict:
        p = tuple(values[i] for i in range(theta.size))
        forces = simulator.forces(time, x, tuple(scale * a for a in u), p, widths)
        like = jnp.zeros_like(jnp.asarray(time))
        chosen = {s: forces[model.states.index(s)] + like for s in states}
        mass = {k: v + like for k, v in simulator.inertia(time, x, u, p).items()}
        return {"forces": chosen, "mass": mass}

    with jax.enable_x64(True):
        at = jnp.asarray(theta)
        value = jax.tree.map(np.asarray, pieces(at, 1.0))
        silent = jax.tree.map(np.asarray, pieces(at, 0.0))["forces"]
        slope = jax.tree.map(np.asarray, jax.jacfwd(lambda v: pieces(v, 1.0))(at))
    return value, silent, slope


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
    return residual, jacobian, view.integrate(force - silent[state])


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
