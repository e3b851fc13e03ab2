"""Weak columns of candidates, each evaluated alone: the screening's cost grows with their number.

Differentiating one model that holds every candidate carries every derivative through every
term; a candidate's own term, evaluated once a coefficient, says the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from jaxsr._deadline import ask
from jaxsr.diagnosis.mechanisms import Motion, Threshold
from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.screening.weak_grid import WeakGrid
from jaxsr.diagnosis.screening.weak_system import WeakSystem, centred, inertia_force
from jaxsr.expressions import evaluate
from jaxsr.models import Model
from jaxsr.models.segments import Prepared


class WeakColumns:
    """Signals of all recordings, end to end, and their integrals against the test functions."""

    def __init__(self, grid: WeakGrid) -> None:
        self.grid, self.model, self.prepared = grid, grid.model, grid.prepared
        model = grid.model
        names = [model.time, *model.states, *model.inputs]
        parts = [dict(zip(names, _signals(model, item), strict=True)) for item in grid.prepared]
        self.signals = {n: np.concatenate([part[n] for part in parts]) for n in names}

    def inertia(self, state: str, mass: np.ndarray) -> np.ndarray:
        """Return the rows of mass * d(state)/dt for a mass along the samples."""
        parts, edges = [np.zeros(0)], self.grid.edges
        for view, item, a, b in zip(
            self.grid.views, self.prepared, edges[:-1], edges[1:], strict=True
        ):
            if view is not None:
                column = inertia_force(self.model, view, item, state, mass[a:b, None])
                parts.append(column[view.valid, 0])
        return np.concatenate(parts)


def motion_of(columns: WeakColumns, system: WeakSystem) -> Motion:
    """Return the signals and what re-calibration leaves of every equation.

    `system` is the weak view of the given model. All free parameters are estimated jointly; the
    columns of each equation that they can reproduce are kept for projections.
    """
    model = columns.model
    free = [i for i, p in enumerate(model.parameters.values()) if p.free]
    a = system.jacobian[:, free]
    size = np.sqrt((a**2).sum(0)) + 1e-300
    step = np.linalg.lstsq(a / size, -system.residual, rcond=1e-9)[0] if free else np.zeros(0)
    # residual = forces - inertia: what is missing has the other sign.
    missing = -(system.residual + (a / size) @ step)
    residual, basis, rows_of = {}, {}, {}
    for index in np.unique(system.state):
        rows, name = system.state == index, model.states[index]
        left, strength, _ = np.linalg.svd((a / size)[rows], full_matrices=False)
        residual[name], rows_of[name] = missing[rows], system.row[rows]
        basis[name] = left[:, strength > 1e-9 * strength.max(initial=1e-300)]
    grid = columns.grid
    signals = {**columns.signals, "t": columns.signals[model.time]}
    return Motion(
        signals=signals,
        recordings=tuple(p.recording.name for p in columns.prepared),
        edges=grid.edges,
        integrate=grid.integrate,
        centre=grid.centre,
        spacing=system.half_width / 4.0,
        residual=residual,
        basis=basis,
        rows=rows_of,
    )


def with_candidates(
    columns: WeakColumns, system: WeakSystem, super_model: SuperModel
) -> WeakSystem:
    """Extend the weak view of the given model by a column for every candidate's coefficient.

    Inner constants have no effect while the coefficients are neutral; their columns are zero.
    For a `Threshold` the secant from its neutral value to its seed stands in.
    """
    order = list(super_model.model.parameters)
    known = len(super_model.given.parameters)
    jacobian = np.zeros((system.residual.size, len(order)))
    jacobian[:, :known] = system.jacobian
    place = {name: i for i, name in enumerate(order)}
    values = {n: p.value for n, p in super_model.given.parameters.items()}
    environment = {**columns.signals, **values}
    for candidate, names in zip(super_model.candidates, super_model.names, strict=True):
        ask()
        if candidate.fixed_parameter is not None or candidate.states:
            continue
        for spec in candidate.parameters:
            if spec.coefficient:
                rows = _effect(columns, system, candidate, names, spec, environment)
                jacobian[:, place[names[spec.name]]] = np.nan_to_num(rows)
    theta = np.array([p.value for p in super_model.model.parameters.values()])
    return replace(system, jacobian=jacobian, theta=theta)


def _effect(
    columns: WeakColumns,
    system: WeakSystem,
    candidate: Candidate,
    names: Mapping[str, str],
    spec: ParameterSpec,
    environment: Mapping[str, np.ndarray | float],
) -> np.ndarray:
    """Derivative of the residual by one coefficient."""
    model, rows = columns.model, np.zeros(system.residual.size)
    step = spec.seed - spec.neutral if isinstance(spec, Threshold) else 1.0
    own = {names[s.name]: s.neutral for s in candidate.parameters}
    moved = {**own, names[spec.name]: spec.neutral + step}

    def slope(template: str) -> np.ndarray:
        term = model.term(template.format(**names).removeprefix("+ "), extra=tuple(own))
        with np.errstate(all="ignore"):
            high, low = (np.asarray(evaluate(term, {**environment, **p})) for p in (moved, own))
        full = np.broadcast_to((high - low) / step, columns.signals[model.time].shape)
        return np.nan_to_num(full, posinf=0.0, neginf=0.0)

    for state, template in candidate.balancing(model):
        mine = system.state == model.states.index(state)
        if mine.any():
            rows[mine] += columns.grid.integrate(slope(template))[system.row[mine]]
    for row, column, template in candidate.inertia:
        mine = system.state == model.states.index(row)
        if mine.any():
            rows[mine] -= columns.inertia(column, slope(template))[system.row[mine]]
    quiet = [r for r, p in enumerate(columns.prepared) if p.recording.name in candidate.quiet]
    rows[np.isin(system.recording, quiet)] = 0.0
    return rows


def _signals(model: Model, item: Prepared) -> list[np.ndarray]:
    """Time, states and inputs along a recording, as the weak view takes them."""
    states = [np.where(np.isfinite(c), c, 0.0) for c in item.states.values.T]
    return [item.time, *states, *(centred(c, model.input_hold) for c in item.inputs.T)]
