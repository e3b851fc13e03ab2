"""Problems whose jumps are switched exactly, so that no width of a rounded jump is in the way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.shooting.integration import steady, with_steps
from jaxsr.models.least_squares import Problem
from jaxsr.models.switching import switchable


def switched(problem: Problem, theta: np.ndarray, least: int = 1) -> Problem | None:
    """Return the problem with jumps switched inside explicit steps; None where that cannot be.

    Jumps in inputs or readings stay rounded. What is stiff beside its jumps needs implicit steps,
    which know of no switches.

    Parameters
    ----------
    theta : ndarray, shape (parameters,)
        At which the steps are stable.
    least : int
        Fewest steps between two samples.
    """
    which = set(switchable(problem.simulator))
    if not which:
        return None
    widths = tuple(0.0 if i in which else w for i, w in enumerate(problem.stepping.widths))
    stepping = replace(problem.stepping, widths=widths, smooth=None)
    found = steady(with_steps(replace(problem, stepping=stepping), "rk4", least), theta)
    return found if found.stepping.method == "rk4" else None


def rounded(problem: Problem, width: float, theta: np.ndarray) -> Problem:
    """Return the problem with its jumps rounded over `width` times the sharpest that data tell."""
    widths = tuple(width * w for w in problem.stepping.widths)
    if not widths:
        return problem
    return steady(replace(problem, stepping=replace(problem.stepping, widths=widths)), theta)
