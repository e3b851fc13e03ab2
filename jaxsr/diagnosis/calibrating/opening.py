"""The arena in which free runs are estimated, and re-calibration in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.calibrating.horizon import Headline, Outlook, Start
from jaxsr.diagnosis.calibrating.restarts import Restarts
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.compared import RECALIBRATION
from jaxsr.diagnosis.judging.noise_ratio import ABOVE_NOISE, in_noise, residual_to_noise
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import Arena, neutral_values, with_rounded_jumps
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.integration import choose_stepping, with_smooth
from jaxsr.diagnosis.shooting.scoring import horizons
from jaxsr.models import Simulator
from jaxsr.models.states import spread

PATIENCE = 1.0 / 12.0
"""Share of the time budget after which the estimation of one set stops where it is."""
MOST_PATIENCE = 10.0
"""The same in seconds: what takes longer is caught in a law that jumps."""
NULL_ITERATIONS = 120
"""Iterations of re-calibration alone: no mechanism must win because it stopped early."""
RESTARTING = 0.1
"""Share of the time left that re-calibration from other starts may take."""


def opening(
    case: Case,
    super_model: SuperModel,
    starts: list[Start],
) -> tuple[Arena, Entry, Headline, list[Start]]:
    """Lay out the arena of some candidates and estimate re-calibration in it.

    Parameters
    ----------
    case : Case
    super_model : SuperModel
    starts : list of Start
        Re-calibration's, then those of the leading set and of others.

    Returns
    -------
    Arena
    Entry
        Re-calibration alone.
    Headline
        How far the verdict looks ahead.
    list of Start
        From where the given structure simulates best.
    """
    simulator = Simulator(super_model.model)
    case.progress.stage("choosing integration steps and the horizon")
    stepping = choose_stepping(simulator, case.prepared, starts[min(1, len(starts) - 1)][1])
    base = starts[0][1][: len(case.simulator.model.parameters)]
    stepping = with_smooth(stepping, case.simulator, case.prepared, base)
    scale = 0.01 * spread(np.concatenate([p.outputs for p in case.prepared]))

    def stop() -> bool:
        return case.search.exhausted

    outlook = Outlook(super_model, case.prepared, stepping, scale, simulator, stop)
    starts = outlook.usable_starts(starts)
    headline = outlook.headline(starts)
    arena = outlook.first_usable(headline, starts[0][1])
    arena = replace(arena, patience=min(PATIENCE * case.budget.seconds, MOST_PATIENCE))
    arena = with_rounded_jumps(arena)
    case.progress.stage("telling sets of mechanisms from the path of the re-calibrated model")
    arena, null = _recalibrated(arena, headline, starts[0][1], stop)
    restarting = case.search.share(RESTARTING)

    def shortest() -> Arena:
        return with_rounded_jumps(outlook.arena(horizons(case.prepared)[0]))

    restarts = Restarts(arena, shortest, lambda: restarting.exhausted, NULL_ITERATIONS)
    null = case.failures.attempt("starting anew", lambda: restarts.best(null), null)
    if null.fit.converged or not stop():
        case.compared.reach(RECALIBRATION)
    return arena, null, headline, starts


def _recalibrated(
    arena: Arena, headline: Headline, start: np.ndarray, stop: Callable[[], bool]
) -> tuple[Arena, Entry]:
    """Estimate the given structure, from where the weak view or shorter segments lead it.

    What is left above the noise may be the doing of the weights, where the steps of a converter
    pass for motion: with outputs weighed by their noise, the given values are another start.
    """
    entry = enter(arena, (), start, None, stop, NULL_ITERATIONS)
    before = headline.calibrated.get(arena.seconds)
    if before is not None and before.fit.cost < entry.fit.cost:
        entry = enter(arena, (), before.fit.theta, before.fit.path, stop, NULL_ITERATIONS)
    if residual_to_noise(arena, entry) > ABOVE_NOISE:
        weighed, given = in_noise(arena), neutral_values(arena.super_model)
        again = enter(weighed, (), given, None, stop, NULL_ITERATIONS)
        if again.fit.usable and residual_to_noise(weighed, again) <= ABOVE_NOISE:
            return weighed, again
    return arena, entry
