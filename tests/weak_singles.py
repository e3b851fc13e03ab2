"""What acts alone in the weak view, by least squares."""

from __future__ import annotations

import numpy as np

from benchmarks.concealed.weak_columns import WeakColumns, with_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import Seen
from jaxsr.diagnosis.weak.weak_system import weak_system
from jaxsr.models import Model, Simulator

OPEN = frozenset({"input_gain", "load_dependent_friction"})


def best_of(model: Model, seen: Seen) -> tuple[str, dict[str, float]]:
    """Return what leaves least of the residual forces beside the free parameters, with its values.

    Left out is what leaves nothing where all free parameters are zero: a gain of the only input,
    and friction of the net force.
    """
    some = [c for c in seen.candidates if c.mechanism not in OPEN]
    built = SuperModel.build(model, some)
    theta = np.array([p.value for p in model.parameters.values()])
    given = weak_system(Simulator(model), seen.grid, theta)
    system = with_candidates(WeakColumns(seen.grid), given, built)
    base, best = list(built.base_index()), (np.inf, 0, system.theta)
    for number in range(len(built.candidates)):
        active = [*base, *built.index(number, coefficients_only=True)]
        columns = -system.jacobian[:, active]
        step = np.linalg.lstsq(columns, system.residual, rcond=1e-12)[0]
        left = float(np.sum((system.residual - columns @ step) ** 2))
        if left < best[0]:
            values = system.theta.copy()
            values[active] += step
            best = left, number, values
    _, number, values = best
    return built.candidates[number].label, built.own_values(number, values)
