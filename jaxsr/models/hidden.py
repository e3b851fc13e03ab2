"""States that no sensor tells: where the equations lead them beside the states that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxsr._deadline import ask
from jaxsr.models.field import Field, Point
from jaxsr.models.filter_bank import bends, found_along
from jaxsr.models.inputs import stage_inputs
from jaxsr.models.model import FREE, Model
from jaxsr.models.simulator import Simulator
from jaxsr.models.states import StateEstimate

LARGEST = 1e6
"""Size, in units of the first guess, from which a course is no longer taken for one."""
ASKED = 64
"""Samples after which it is asked whether there is time for more."""


def with_hidden(
    model: Model,
    estimate: StateEstimate,
    time: np.ndarray,
    inputs: np.ndarray,
    start: np.ndarray | None = None,
    outputs: np.ndarray | None = None,
) -> StateEstimate:
    """Return the estimate with its hidden states integrated, the known ones inserted.

    At every sample the known states are put back to what the sensors say (direct insertion), so
    that what is hidden follows as it does in the machine where its own motion dies out. What
    [initial] gives starts there, another coordinate at zero, a state of another kind from its first
    guess; all of them from `start`, shape (states,), where that is known. Where the model depends
    on them otherwise than in a line, they are sought in the readings, `outputs` of shape (samples,
    outputs), if these are given (`filter_bank`).
    """
    hidden = [i for i, s in enumerate(model.states) if s in estimate.hidden]
    if not hidden or not model.formulas:
        return estimate
    simulator = Simulator(model)
    field = Field(simulator, simulator.values())
    values = estimate.values.copy()
    for i in hidden:
        name = model.states[i]
        rate = model.equation_terms[name]
        integrates = rate.is_variable and rate.name in model.states
        coordinate = model.kinematic_parent(name) is not None or integrates
        if coordinate and model.initial.get(name, FREE) == FREE:
            values[:, i] = 0.0
        if start is not None:
            values[0, i] = start[i]
    begun = 0
    if outputs is not None and time.size > 2 and bends(model, estimate.hidden):
        with np.errstate(all="ignore"):
            found = found_along(model, replace(estimate, values=values), time, inputs, outputs)
        if np.isfinite(found).all():
            begun = len(found) - 1
            values[: len(found), hidden] = found[:, hidden]
    limit = LARGEST * (1.0 + np.abs(estimate.values).max())
    tables = [stage_inputs(time, u, model.input_hold, 1) for u in inputs.T]
    stages = [[table[s][:, 0] for table in tables] for s in range(3)]
    with np.errstate(all="ignore"):
        for k in range(begun, time.size - 1):
            if k % ASKED == 0:
                ask()
            x = _stepped(field, list(values[k]), time[k], time[k + 1] - time[k], stages, k)
            moved = np.array([x[i] for i in hidden])
            if not np.isfinite(moved).all() or np.abs(moved).max() > limit:
                return estimate
            values[k + 1, hidden] = moved
    return replace(estimate, values=values)


def _stepped(field: Field, x: list, t: float, h: float, stages: list, k: int) -> list:
    """One step of the classical Runge-Kutta method."""

    def at(share: float, rates: list | None, stage: int) -> list:
        own = x if rates is None else [a + share * h * b for a, b in zip(x, rates, strict=True)]
        return field.rates(Point(t + share * h, own, [u[k] for u in stages[stage]]))

    k1 = at(0.0, None, 0)
    k2 = at(0.5, k1, 1)
    k3 = at(0.5, k2, 1)
    k4 = at(1.0, k3, 2)
    return [
        a + h / 6 * (b + 2 * c + 2 * d + e) for a, b, c, d, e in zip(x, k1, k2, k3, k4, strict=True)
    ]
