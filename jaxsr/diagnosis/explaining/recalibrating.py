"""Estimates over all recordings, and that re-calibration does no worse than the given values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxsr._deadline import OutOfTime
from jaxsr.diagnosis.explaining.ingredients import Ingredients
from jaxsr.diagnosis.judging.refine import Estimate
from jaxsr.diagnosis.judging.whole import over_all
from jaxsr.diagnosis.shooting.arena import neutral_values

COMPLETING = 0.25
"""Share of the time left that an estimate over all recordings may take."""
DRAWN_BACK = (1.0, 0.5, 0.25, 0.125)
"""Shares of the way from the given values to an estimate that are tried in turn."""


def completed(parts: Ingredients, estimate: Estimate) -> Estimate:
    """Return an estimate over all recordings, where the search worked on a part of them."""
    if parts.whole is None:
        return estimate
    names = [parts.arena.super_model.candidates[i].label for i in estimate.entry.members]
    what = " + ".join(names) or "re-calibration"
    parts.case.progress.stage(f"estimating {what} over all {parts.whole.samples} samples")
    budget = parts.case.budget.share(COMPLETING)
    return over_all(parts.whole, estimate, lambda: budget.exhausted)


def not_worse(parts: Ingredients, estimate: Estimate) -> Estimate:
    """Return a re-calibration that follows DATA no worse than the given values do.

    Judged by the report's measure over the headline's horizon. An estimate over other segments,
    or one that time cut short, may do worse: on the line to the given values, which are always a
    candidate, it is then drawn back as far as it must be.
    """
    given = neutral_values(parts.arena.super_model)
    horizon = None if parts.headline == parts.horizons[-1] else parts.headline

    def error(theta: np.ndarray) -> float:
        found = estimate.lean.free_run(parts.case.prepared, theta, horizon, parts.case.prepared)
        return found.nrmse if np.isfinite(found.nrmse) else np.inf

    step = estimate.theta - given
    try:
        least = error(given)
        for share in DRAWN_BACK:
            theta = given + share * step
            if error(theta) <= least:
                return replace(estimate, theta=theta)
    except OutOfTime:  # over the search's own segments it did better
        return estimate
    return replace(estimate, theta=given)
