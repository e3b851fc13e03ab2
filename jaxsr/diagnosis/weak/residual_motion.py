"""What re-calibration leaves of every equation that can be read off the sensors."""

from __future__ import annotations

import numpy as np

from jaxsr.diagnosis.mechanisms import Motion
from jaxsr.diagnosis.weak.weak_grid import WeakGrid
from jaxsr.diagnosis.weak.weak_system import WeakSystem, centred
from jaxsr.models import Model
from jaxsr.models.segments import Prepared


def signals_of(grid: WeakGrid) -> dict[str, np.ndarray]:
    """Return time, states and inputs of all recordings, end to end."""
    model = grid.model
    names = [model.time, *model.states, *model.inputs]
    parts = [dict(zip(names, _signals(model, item), strict=True)) for item in grid.prepared]
    return {n: np.concatenate([part[n] for part in parts]) for n in names}


def motion_of(grid: WeakGrid, system: WeakSystem) -> Motion:
    """Return the signals and what re-calibration leaves of every equation.

    `system` is the weak view of the given model. All free parameters are estimated jointly; the
    columns of each equation that they can reproduce are kept for projections.
    """
    model, signals = grid.model, signals_of(grid)
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
    return Motion(
        signals={**signals, "t": signals[model.time]},
        recordings=tuple(p.recording.name for p in grid.prepared),
        edges=grid.edges,
        integrate=grid.integrate,
        centre=grid.centre,
        spacing=system.half_width / 4.0,
        residual=residual,
        basis=basis,
        rows=rows_of,
    )


def _signals(model: Model, item: Prepared) -> list[np.ndarray]:
    """Time, states and inputs along a recording, as the weak view takes them."""
    states = [np.where(np.isfinite(c), c, 0.0) for c in item.states.values.T]
    return [item.time, *states, *(centred(c, model.input_hold) for c in item.inputs.T)]
