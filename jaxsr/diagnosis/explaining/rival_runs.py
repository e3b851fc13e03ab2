"""Free runs of the sets that were weighed beside the answer, for a reader who asks for them."""

from __future__ import annotations

import numpy as np

from jaxsr.diagnosis.explaining.ingredients import Ingredients
from jaxsr.diagnosis.shooting.reduced import lean

MOST = 3
"""Sets that are run."""
SPARE = 0.1
"""Share of the time budget that has to be left for each of them."""

RivalRuns = dict[tuple[str, ...], list[np.ndarray]]
"""Labels of a set to what it simulates, one array (samples, outputs) for each recording."""


def rival_runs(parts: Ingredients) -> RivalRuns:
    """Run the best sets beside the chosen one and re-calibration over the headline's horizon.

    None where the search worked on a part of the recordings, and as long as time is left.
    """
    if parts.whole is not None:
        return {}
    budget, problem = parts.case.budget, parts.arena.problem
    model = parts.arena.super_model
    horizon = None if parts.headline == parts.horizons[-1] else parts.headline
    entries = sorted(parts.entries, key=lambda e: e.fit.cost)
    found: RivalRuns = {}
    for entry in entries:
        labels = tuple(sorted(model.candidates[i].label for i in entry.members))
        shown = entry is parts.chosen or not entry.members or not entry.fit.usable
        if shown or labels in found:
            continue
        if len(found) == MOST or budget.remaining < SPARE * budget.seconds:
            break
        own = lean(model, problem.simulator, entry.stepping or problem.stepping, entry.members)
        run = own.free_run(parts.case.prepared, entry.fit.theta, horizon, parts.case.prepared)
        found[labels] = run.simulated
    return found
