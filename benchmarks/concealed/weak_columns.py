"""Weak columns of candidates: what sparse regression of the residual forces chooses from.

Differentiating one model that holds every candidate carries every derivative through every
term; a candidate's own term, evaluated once a coefficient, says the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.mechanisms import Threshold
from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.weak.residual_motion import signals_of
from jaxsr.diagnosis.weak.weak_grid import WeakGrid
from jaxsr.diagnosis.weak.weak_system import WeakSystem, inertia_force
from jaxsr.expressions import evaluate


class WeakColumns:
    """Signals of all recordings, end to end, and their integrals against the test functions."""

    def __init__(self, grid: WeakGrid) -> None:
        self.grid, self.model, self.prepared = grid, grid.model, grid.prepared
        self.signals = signals_of(grid)

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
