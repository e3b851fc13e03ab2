"""Findings that values of the model are wrong."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr._deadline import OutOfTime
from jaxsr._progress import Repeated
from jaxsr.diagnosis.explaining.explain import CONFUSED, Weight, wrong_value_row
from jaxsr.diagnosis.explaining.ingredients import Ingredients
from jaxsr.diagnosis.explaining.wrong_values import (
    Wrong,
    angle,
    completed,
    fewest,
    frozen,
    shares,
    without,
)
from jaxsr.diagnosis.judging.noise_ratio import LIMITED, residual_to_noise
from jaxsr.diagnosis.judging.refine import Estimate, Ground, refine
from jaxsr.diagnosis.shooting.arena import neutral_values
from jaxsr.diagnosis.shooting.blocks import column_sizes
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.uncertainty import RANK

REFINING = 0.15
"""Share of the time left that leading estimates out of corners and checking them may take."""
WEIGHING = 0.5
"""Share of the time left in which values are estimated without each of them."""
TOLD = 1e-3
"""Probability from which other values are told as alternatives."""


@dataclass(frozen=True, eq=False)
class ToldValues:
    """Values that are wrong, and what else may be instead of them.

    Attributes
    ----------
    estimate : Estimate
        That the findings stand on.
    names : tuple of str
    weights : tuple of Weight
        What each of them matters.
    rivals : tuple of (Wrong, float)
        Other sets of values and their probabilities; the first is the one that is told.
    """

    parts: Ingredients
    estimate: Estimate
    names: tuple[str, ...]
    weights: tuple[Weight, ...]
    rivals: tuple[tuple[Wrong, float], ...] = ()

    def rows(self, each: Mapping[str, float], some: float) -> list[dict[str, Any]]:
        """Return the findings.

        Parameters
        ----------
        each : dict of str to float
            Probability that a value is wrong, of those that re-calibration asks for.
        some : float
            That any of them is, which other sets of values share.
        """
        return [
            self._row(name, weight, some if self.rivals else each[name])
            for name, weight in zip(self.names, self.weights, strict=True)
        ]

    def _row(self, name: str, weight: Weight, probability: float) -> dict[str, Any]:
        own = sum(p for w, p in self.rivals if name in w.names) if self.rivals else 1.0
        row = wrong_value_row(self.parts, self.estimate, name, weight, own * probability)
        others = []
        for rival, share in self.rivals:
            if name in rival.names or share < TOLD:
                continue
            order = list(rival.arena.super_model.model.parameters)
            theta = rival.entry.fit.theta
            values = {n: float(theta[order.index(n)]) for n in rival.names}
            site = next(n for n in rival.names if n not in self.names)
            other = {"mechanism": "wrong_value", "site": f"parameter:{site}"}
            others.append({**other, "probability": share * probability, "parameters": values})
        return {**row, "alternatives": others}

    @property
    def confusable(self) -> tuple[list[Any], ...]:
        """Values of other sets that do nearly the same in the sensors, with the angle in degrees.

        A larger set holds the effect of a smaller one where a factor is common to all of it.
        """
        if not self.rivals:
            return ()
        told, rows = self.rivals[0][0], list[list[Any]]()
        near = sorted((angle(told, w), k, w) for k, (w, _) in enumerate(self.rivals) if k)
        seen = set(told.names)
        for degrees, _, rival in near:
            for name in (n for n in rival.names if n not in seen and degrees < CONFUSED):
                pair = [f"wrong_value@parameter:{n}" for n in (told.names[0], name)]
                rows.append([*pair, round(degrees, 2)])
                seen.add(name)
        return tuple(rows)


def told_values(
    parts: Ingredients, recalibrated: Estimate, names: list[str], given: float
) -> ToldValues:
    """Return the fewest values that explain what re-calibration does.

    Where it asks for several. Where it leaves more than noise, or there is no time, all of them.

    Parameters
    ----------
    names : list of str
        What re-calibration asks for.
    given : float
        Squared error of the given values.
    """
    found: list[Wrong] = []
    noisy = residual_to_noise(recalibrated.arena, recalibrated.entry) <= LIMITED
    if len(names) > 1 and noisy and parts.whole is None:
        budget = parts.case.budget.share(REFINING)
        found = parts.case.failures.attempt(
            "finding the fewest wrong values",
            lambda: fewest(parts.arena, parts.null, names, lambda: budget.exhausted),
            [],
        )
    if not found or set(found[0].names) == set(names):
        weights = tuple(_weights(parts, names, given))
        return ToldValues(parts, recalibrated, tuple(names), weights)
    best, rivals = found[0], tuple(zip(found, map(float, shares(found)), strict=True))
    costs = [without(best, name, parts.null) for name in best.names]
    weights = tuple(Weight.of(given, cost, best.entry.fit.cost) for cost in costs)
    estimate = recalibrated
    if not set(best.names) <= set(names):
        grid = parts.case.seen.grid if parts.case.seen else None
        budget = parts.case.budget.share(REFINING)
        ground = Ground(best.arena, parts.case.prepared, (parts.headline,), grid, budget, budget)
        estimate = completed(best, refine(ground, best.entry, thorough=False), parts.arena)
    return ToldValues(parts, estimate, best.names, weights, rivals)


def _weights(parts: Ingredients, names: Sequence[str], given: float) -> Iterator[Weight]:
    """Yield what each value matters: by an estimate as long as there is time for one more."""
    pace = Repeated(parts.case.budget.share(WEIGHING))
    for name in names:
        if not pace.too_long():
            with contextlib.suppress(OutOfTime):
                yield weight_of_value(parts, name, given)
                continue
        yield expected_weight(parts, name, given)


def expected_weight(parts: Ingredients, name: str, given: float) -> Weight:
    r"""Return what the value of one parameter matters, by the linearisation at re-calibration.

    With H = J'J, the starts projected out, holding parameter j at \delta from its estimate, and
    moving all others to where that hurts least, adds \delta^2 / (H^{-1})_{jj} to the squared
    error.
    """
    fit = parts.null.fit
    at = list(parts.arena.super_model.model.parameters).index(name)
    total, place = fit.normal_equations()[0].sum(0), list(fit.active).index(at)
    away = neutral_values(parts.arena.super_model)[at] - fit.theta[at]
    if not np.isfinite(total).all():
        return Weight.of(given, given, fit.cost)
    size = column_sizes(total)
    inverse = np.linalg.pinv(total / size / size[:, None], rcond=RANK, hermitian=True)
    spread = inverse[place, place] / size[place] ** 2
    more = away**2 / spread if spread > 0.0 else 0.0
    return Weight.of(given, min(fit.cost + more, max(given, fit.cost)), fit.cost)


def weight_of_value(parts: Ingredients, name: str, given: float) -> Weight:
    """Return what the value of one parameter matters: the others are estimated with it as given."""
    arena, null = frozen(parts.arena, (name,)), parts.null
    theta = null.fit.theta.copy()
    at = list(arena.super_model.model.parameters).index(name)
    theta[at] = neutral_values(arena.super_model)[at]
    budget = parts.case.budget.share(REFINING)
    cost = given
    if len(parts.case.simulator.model.free_parameters) > 1:
        cost = enter(arena, (), theta, null.fit.path, lambda: budget.exhausted).fit.cost
    return Weight.of(given, cost, null.fit.cost)
