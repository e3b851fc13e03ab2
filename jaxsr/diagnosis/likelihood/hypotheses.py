"""Sets of mechanisms as hypotheses, each at its mode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.contest.integration import steady
from jaxsr.diagnosis.contest.reduced import Reduced, lean
from jaxsr.diagnosis.likelihood.estimate import Belief, Estimate, Scales, estimated
from jaxsr.diagnosis.likelihood.kalman import Noise
from jaxsr.diagnosis.likelihood.noise import likeliest
from jaxsr.diagnosis.likelihood.steps import resolved
from jaxsr.diagnosis.likelihood.table import Table
from jaxsr.diagnosis.likelihood.workspace import Workspace, first_noise, start_of
from jaxsr.diagnosis.mechanisms.candidate import UNLIMITED
from jaxsr.diagnosis.mechanisms.site import Threshold
from jaxsr.models.least_squares import Problem
from jaxsr.models.segments import build_segments

WIDEST, SHARPEST, COARSE, FINER = 4.0, 0.015, 4.0, (2.0, 1.4)
"""Widths of jumps that are tried, in the sharpest that the data can tell: the smoothest first, by
a coarse factor, and two finer ones about the best."""
STANDING = 4.0
"""Distance from the largest reading, in deviations of the noise, in which a sensor stands at its
limit."""
SHARPENED, CLEAR = 0.5, 1.0
"""Log evidence that a sharper jump must gain to be sharpened further, and another noise to be
taken."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A set of mechanisms at its mode.

    Attributes
    ----------
    members : tuple of int
        Candidates of the super-model.
    log_evidence : float
    share : float
        Size of the latent force left, as a share of the net force.
    constants : dict of str to (float, float)
        Value and posterior deviation, by names of the super-model.
    names : dict of int to dict of str to str
        Member to its constants' own names and those of the super-model.
    theta : ndarray
        All parameters of the super-model.
    path : ndarray, shape (states of the given model, samples, pieces)
    noise : Noise
        That makes its innovations likeliest.
    """

    members: tuple[int, ...]
    log_evidence: float
    share: float
    constants: dict[str, tuple[float, float]]
    names: dict[int, dict[str, str]]
    theta: np.ndarray
    path: np.ndarray
    settled: bool
    noise: Noise


def hypothesis(
    work: Workspace,
    table: Table,
    members: Sequence[int],
    path: np.ndarray | None = None,
    noise: Noise | None = None,
) -> Hypothesis | None:
    """Estimate a set from where the table leads it; None where nothing finite comes of it.

    Parameters
    ----------
    members : sequence of int
        Candidates of the super-model.
    path : ndarray, optional
        Of the given model's states; what the recordings have by default.
    noise : Noise, optional
        Of the sensors, to begin with; that of the table by default.
    """
    model = work.super_model
    members = tuple(sorted(members))
    helpers = work.helpers
    theta = model.switched(members, model.seeded(members, work.theta))
    chosen = list(model.base_index())
    for i in members:
        chosen += [j for j in model.index(i) if j not in chosen]
    reduced = _alone(work, tuple(sorted({*members, *helpers})), theta)
    pushes = [model.index(i, coefficients_only=True)[0] for i in helpers]
    belief = _belief(work, table, chosen, theta)
    own = reduced.problem.segments.course.copy()
    start = start_of(own)
    start[: len(table.scales.start)] = table.scales.start
    if path is not None:
        own[: len(path)] = path
    scales = replace(table.scales, start=start, noise=noise or table.scales.noise)
    places = reduced.active(np.array(chosen, int)), reduced.active(np.array(pushes, int))
    sharp = any(model.candidates[i].sharp for i in members)
    values = theta[reduced.parameters]
    hidden = beyond_limits(work, members)
    if hidden.any():
        values, own = _led_on(reduced.problem, hidden, sharp, values, own, places, belief, scales)
    found = _at_its_mode(reduced.problem, sharp, values, own, *places, belief, scales)
    if found is None:
        return None
    # Beside what was missing, the noise is another than beside re-calibration.
    noise, gain = likeliest(found[0], found[1], places[1], scales)
    if gain > CLEAR:
        scales = replace(scales, noise=noise)
        problem, best = found
        found = problem, estimated(problem, best.theta, best.path, *places, belief, scales) or best
    best = found[1]
    values = theta.copy()
    values[reduced.parameters] = best.theta
    names = list(model.model.parameters)
    constants = {
        names[j]: (float(values[j]), float(best.mode.deviation[k])) for k, j in enumerate(chosen)
    }
    known = len(model.given.states)
    return Hypothesis(
        members,
        best.log_evidence,
        best.share,
        constants,
        {i: model.names[i] for i in members},
        values,
        best.path[:known],
        best.settled,
        scales.noise,
    )


def _at_its_mode(
    problem: Problem,
    sharp: bool,
    values: np.ndarray,
    path: np.ndarray,
    at: np.ndarray,
    helpers: np.ndarray,
    belief: Belief,
    scales: Scales,
) -> tuple[Problem, Estimate] | None:
    """Iterate; jumps from wide to sharp as long as that is more probable, then in finer steps."""
    tried: dict[float, tuple[Problem, Estimate]] = {}

    def better(factor: float, than: float | None) -> bool:
        """Estimate with jumps of some width, from where another one led."""
        begun = (values, path) if than is None else (tried[than][1].theta, tried[than][1].path)
        with np.errstate(all="ignore"):
            try:
                stepped = _stepped(problem, factor, *begun, scales)
                found = estimated(stepped, *begun, at, helpers, belief, scales)
            except (np.linalg.LinAlgError, FloatingPointError):
                return False
        if found is None:
            return False
        tried[factor] = stepped, found
        before = -np.inf if than is None else tried[than][1].log_evidence
        return found.log_evidence > before + SHARPENED

    if not sharp:
        return tried[1.0] if better(1.0, None) else None
    best = WIDEST
    if not better(best, None):
        return None
    while best > SHARPEST and better(best / COARSE, best):
        best /= COARSE
    for step in FINER:
        for factor in (step, 1.0 / step):
            if better(best * factor, best):
                best *= factor
                break
    return tried[best]


def _stepped(
    problem: Problem, factor: float, theta: np.ndarray, path: np.ndarray, scales: Scales
) -> Problem:
    """Widen or sharpen the jumps of a problem, and step it finely enough for that."""
    stepping = problem.stepping
    if stepping.widths:
        widths = tuple(factor * w for w in stepping.widths)
        problem = replace(problem, stepping=replace(stepping, widths=widths))
        problem = steady(problem, theta)
    return resolved(problem, theta, path, scales.noise, scales.start)


def beyond_limits(work: Workspace, members: Sequence[int]) -> np.ndarray:
    """Return which samples stand at the limit of a sensor that members say it has.

    Returns
    -------
    ndarray of bool, shape (outputs, samples, pieces)
    """
    outputs = work.narrow.segments.outputs
    found = np.zeros(outputs.shape, bool)
    noise = np.sqrt(first_noise(work.prepared).white)
    for i in members:
        candidate = work.super_model.candidates[i]
        for (output, _), spec in zip(candidate.readings, candidate.parameters, strict=False):
            if isinstance(spec, Threshold):
                k = work.super_model.given.outputs.index(output)
                with np.errstate(invalid="ignore"):
                    found[k] |= np.abs(outputs[k]) > spec.seed - STANDING * noise[k]
    return found


def _led_on(
    problem: Problem,
    hidden: np.ndarray,
    sharp: bool,
    values: np.ndarray,
    path: np.ndarray,
    places: tuple[np.ndarray, np.ndarray],
    belief: Belief,
    scales: Scales,
) -> tuple[np.ndarray, np.ndarray]:
    """Return constants and the path on which the other samples lead beyond a sensor's limit.

    Along a path that follows a sensor at its limit, one half of the samples would pull it there.
    """
    segments = problem.segments
    outputs = np.where(hidden, np.nan, segments.outputs)
    blind = replace(problem, segments=replace(segments, outputs=outputs))
    found = _at_its_mode(blind, sharp, values, path, *places, belief, scales)
    return (values, path) if found is None else (found[1].theta, found[1].path)


def _alone(work: Workspace, members: Sequence[int], theta: np.ndarray) -> Reduced:
    """Return the problem of the given model with `members` alone; their states run beside."""
    own = lean(work.super_model, work.narrow.simulator, work.narrow.stepping, members)
    values, count = theta[own.parameters], own.stepping.substeps
    model = own.simulator.model
    segments = build_segments(model, work.prepared, work.rows, count, theta=values)
    problem = Problem(own.simulator, own.stepping, segments, work.narrow.scale)
    return Reduced(problem, own.parameters, np.arange(0))


def _belief(work: Workspace, table: Table, chosen: Sequence[int], theta: np.ndarray) -> Belief:
    """Beliefs of parameters of the super-model: those of the table, where it has them."""
    names = list(work.super_model.model.parameters)
    parameters = list(work.super_model.model.parameters.values())
    rows = []
    for j in chosen:
        if names[j] in table.names:
            k, known = table.names[names[j]], table.belief
            rows.append((known.mean[k], known.deviation[k], known.low[k], known.high[k]))
            continue
        low, high = parameters[j].bounds or (-UNLIMITED, UNLIMITED)
        value = theta[j]
        size = abs(value) if value else min(high - low, 1.0)
        rows.append((value, size, low - 1e-12 * size, high + 1e-12 * size))
    columns = np.array(rows, dtype=float).reshape(-1, 4).T
    return Belief(*columns)
