"""Starts that no sensor tells, where accelerometers or forces alone are measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import Arena
from jaxsr.diagnosis.shooting.estimation import Estimation
from jaxsr.diagnosis.shooting.reduced import Reduced
from jaxsr.models.edits import with_values
from jaxsr.models.hidden import with_hidden
from jaxsr.models.least_squares import Fit
from jaxsr.models.segments import Prepared

CARRIED = 2
"""Times that starts are sought along a whole run of the latest estimate."""


def starts_told(super_model: SuperModel, prepared: Sequence[Prepared]) -> bool:
    """Whether some state is read by a sensor; accelerometers alone read none."""
    states = set(super_model.given.states)
    return any(states - item.states.hidden for item in prepared)


def carried_on(arena: Arena, estimate: Estimation, own: Reduced, found: Fit) -> Fit:
    """Estimate again from where the first start leads through a recording, as long as that helps.

    The model that guessed the starts lacked what is estimated now.
    """
    model = own.problem.simulator.model
    if model.states != arena.super_model.given.states:
        return found
    for _ in range(CARRIED):
        if estimate.stopped() or not found.usable or found.path is None:
            break
        again = estimate(own, found.theta, _whole_runs(arena, own, found, found.path))
        if not again.usable or again.cost >= found.cost:
            break
        found = again
    return found


def _whole_runs(arena: Arena, own: Reduced, found: Fit, path: np.ndarray) -> np.ndarray:
    """Return a path along which every recording is one run from the start of its first segment."""
    segments, model = own.problem.segments, own.problem.simulator.model
    moved = with_values(model, dict(zip(model.parameters, found.theta.tolist(), strict=True)))
    result = path.copy()
    for r, item in enumerate(arena.prepared):
        mine = np.flatnonzero(segments.recording == r)
        if not mine.size:
            continue
        first = int(mine[np.argmin(segments.start[mine])])
        begin = int(segments.start[first])
        rest = slice(begin, None)
        states = replace(item.states, values=item.states.values[rest])
        run = with_hidden(moved, states, item.time[rest], item.inputs[rest], path[:, 0, first])
        for s in mine:
            at = np.arange(segments.time.shape[0]) + int(segments.start[s]) - begin
            result[:, :, s] = run.values[np.minimum(at, len(run.values) - 1)].T
    return result
