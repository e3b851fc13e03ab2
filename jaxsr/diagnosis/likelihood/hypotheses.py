"""Sets of mechanisms as hypotheses, each at its mode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.contest.integration import steady
from jaxsr.diagnosis.contest.reduced import reduce
from jaxsr.diagnosis.likelihood.estimate import Belief, Estimate, Scales, estimated
from jaxsr.diagnosis.likelihood.kalman import Noise
from jaxsr.diagnosis.likelihood.noise import likeliest
from jaxsr.diagnosis.likelihood.steps import resolved
from jaxsr.diagnosis.likelihood.workspace import Table, Workspace
from jaxsr.diagnosis.mechanisms.candidate import UNLIMITED
from jaxsr.models.least_squares import Problem

WIDEST, SHARPEST, COARSE, FINER = 4.0, 0.015, 4.0, (2.0, 1.4)
"""Widths of jumps that are tried, in the sharpest that the data can tell: the smoothest first, by
a coarse factor, and two finer ones about the best."""
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
) -> Hypothesis | None:
    """Estimate a set from where the table leads it; None where nothing finite comes of it.

    Parameters
    ----------
    members : sequence of int
        Candidates of the super-model.
    path : ndarray, optional
        Of the given model's states; what the sensors tell by default.
    """
    model = work.super_model
    members = tuple(sorted(members))
    helpers = work.helpers
    theta = model.switched(members, model.seeded(members, work.theta))
    chosen = list(model.base_index())
    for i in members:
        chosen += [j for j in model.index(i) if j not in chosen]
    reduced = reduce(work.problem, model, tuple(sorted({*members, *helpers})))
    pushes = [model.index(i, coefficients_only=True)[0] for i in helpers]
    belief = _belief(work, table, chosen, theta)
    own = reduced.problem.segments.course.copy()
    if path is not None:
        own[: len(path)] = path
    scales = replace(table.scales, start=work.scales.start[reduced.states])
    places = reduced.active(np.array(chosen, int)), reduced.active(np.array(pushes, int))
    sharp = any(model.candidates[i].sharp for i in members)
    values = theta[reduced.parameters]
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


def _belief(work: Workspace, table: Table, chosen: Sequence[int], theta: np.ndarray) -> Belief:
    """Beliefs of parameters of the super-model: those of the table, where it has them."""
    names = list(work.super_model.model.parameters)
    parameters = list(work.super_model.model.parameters.values())
    index = _names_in_table(work, table)
    rows = []
    for j in chosen:
        if names[j] in index:
            k, known = index[names[j]], table.belief
            rows.append((known.mean[k], known.deviation[k], known.low[k], known.high[k]))
            continue
        low, high = parameters[j].bounds or (-UNLIMITED, UNLIMITED)
        value = theta[j]
        size = abs(value) if value else min(high - low, 1.0)
        rows.append((value, size, low - 1e-12 * size, high + 1e-12 * size))
    columns = np.array(rows, dtype=float).reshape(-1, 4).T
    return Belief(*columns)


def _names_in_table(work: Workspace, table: Table) -> dict[str, int]:
    """Names of the super-model's parameters to their places among the table's columns."""
    here = list(work.columns.model.parameters)
    place = {here[j]: k for k, j in enumerate(table.active)}
    found = {n: place[n] for n in work.super_model.given.parameters if n in place}
    for i, there in enumerate(work.place):
        mine, theirs = work.columns.names[i], work.super_model.names[there]
        found |= {theirs[own]: place[mine[own]] for own in mine if mine[own] in place}
    return found
