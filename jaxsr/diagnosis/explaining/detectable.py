"""The smallest effect of each mechanism that these recordings would show."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.special

from jaxsr.diagnosis.explaining.ingredients import Ingredients
from jaxsr.diagnosis.explaining.responses import Responses
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.site import Threshold, sites_of
from jaxsr.diagnosis.shooting.arena import Arena
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.uncertainty import Sensitivities
from jaxsr.expressions import evaluate
from jaxsr.models import Model

POWER = 0.95
"""Share of such recordings in which the smallest effect would be found."""
LEVELS = 40
"""Values of a threshold that are tried, each farther by one ratio from where it does nothing."""
NEAREST = 1e-6
"""The first of them, over the largest signal."""
SHARE = 0.1
"""Share of the time left in which thresholds are followed."""
LEAVES = 0.02
"""Of the largest signal: no limit is sought below."""


def standard_errors(threshold: float) -> float:
    r"""Return how many standard errors an effect must have to be found.

    .. math:: z(p/2) + z(1 - \mathrm{POWER})

    A two-sided test at the level `threshold` then finds it in `POWER` of all recordings.
    """
    return float(scipy.special.ndtri(POWER) - scipy.special.ndtri(0.5 * threshold))


def detectable_rows(parts: Ingredients, table: Sensitivities) -> dict[str, Any]:
    """Return the smallest effect of each mechanism that these recordings would show.

    By the tangent at the chosen set, free parameters and starts projected out. Left out is what
    these recordings do not tell about: an effect of a size outside its bounds, and one that, with
    nothing to take its place, would move the readings by more than all that they vary: so far from
    the estimate the tangent says nothing. What a force that depends on the motion does is compared
    with the simulated motion, which noise does not enlarge. Thresholds have no tangent where they
    do nothing; their effect is followed from there on.
    """
    super_model = parts.arena.super_model
    needed = standard_errors(parts.detection.threshold)
    measured, simulated = _variation(parts.arena, parts.chosen)
    rows: dict[str, Any] = {}
    for k, number in enumerate(table.candidates):
        candidate = super_model.candidates[number]
        spec = next((s for s in candidate.parameters if s.coefficient), None)
        if spec is None or isinstance(spec, Threshold) or candidate.replaced:
            continue
        value = needed * float(table.error[k])
        free = max(spec.high - spec.neutral, spec.neutral - spec.low)
        most = simulated if _depends_on_motion(candidate, super_model.given) else measured
        if value * float(table.size[k]) <= most and value <= free:
            row = {"parameter": spec.name, "value": value, "unit": spec.unit}
            _put(rows, candidate.label, row | ({"beside": spec.neutral} if spec.neutral else {}))
    noise = float(np.sqrt(table.variance))
    for label, row in _thresholds(parts, table, needed * noise):
        _put(rows, label, row)
    return rows


def _variation(arena: Arena, entry: Entry) -> tuple[float, float]:
    """Return how far the weighted readings, measured and simulated, lie from their means."""
    segments, scale = arena.problem.segments, arena.problem.scale[:, None, None]
    seen = np.isfinite(segments.outputs)
    measured = np.where(seen, segments.outputs, 0.0) / scale
    count = np.maximum(seen.sum((1, 2), keepdims=True), 1)
    lengths = []
    for values in (measured, np.where(seen, measured - entry.fit.residual, 0.0)):
        mean = values.sum((1, 2), keepdims=True) / count
        lengths.append(float(np.linalg.norm(np.where(seen, values - mean, 0.0))))
    return lengths[0], lengths[1]


def _depends_on_motion(candidate: Candidate, model: Model) -> bool:
    """Whether a force of a candidate is another one for another motion."""
    names = {spec.name: spec.name for spec in candidate.parameters}
    names |= {state.name: state.name for state in candidate.states}
    symbols = re.findall(r"\w+", " ".join(t.format(**names) for _, t in candidate.terms))
    return bool(candidate.states or candidate.inertia or set(symbols) & set(model.states))


def _put(rows: dict[str, Any], label: str, row: dict[str, Any]) -> None:
    """Keep the variant of a mechanism with the smallest value."""
    if label not in rows or row["value"] < rows[label]["value"]:
        rows[label] = row


def _thresholds(
    parts: Ingredients, table: Sensitivities, needed: float
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the rows of the candidates whose first constant is a threshold, by label.

    The first variant of each, which is the hard one: a soft limit bends what lies far below it.
    """
    arena, chosen = parts.arena, parts.chosen
    if chosen.fit.path is None:
        return
    sites = sites_of(arena.super_model.given, {})
    wanted: dict[str, tuple[int, Candidate, Threshold]] = {}
    for number in table.candidates:
        candidate = arena.super_model.candidates[number]
        spec = candidate.parameters[0] if candidate.parameters else None
        known = {state for state, _ in candidate.terms} <= {site.state for site in sites}
        if isinstance(spec, Threshold) and not candidate.states and known:
            wanted.setdefault(candidate.label, (number, candidate, spec))
    if not wanted:
        return
    left = parts.case.budget.share(SHARE)
    responses = parts.case.failures.attempt(
        "following thresholds", lambda: Responses.of(arena, chosen, sites), None
    )
    for label, (number, candidate, spec) in wanted.items():
        if responses is None or left.exhausted:
            return
        effect = ThresholdEffect(arena, chosen, responses, number, candidate)
        row = _threshold_row(effect, spec, needed)
        if row is not None:
            yield label, row


def _threshold_row(
    effect: ThresholdEffect, spec: Threshold, needed: float
) -> dict[str, Any] | None:
    """Return the first value of a threshold, from where it does nothing, that shows."""
    if spec.neutral < 0.0:  # a limit at the bottom has no size that it would show from
        return None
    limit = spec.neutral > 0.0
    top = effect.largest() if limit else spec.high
    ratios = np.geomspace(NEAREST, 1.0 - LEAVES if limit else 1.0, LEVELS)
    sizes = np.sqrt(effect.shown(top * (1.0 - ratios if limit else ratios)))
    at = first_above(np.log(ratios), np.log(np.maximum(sizes, 1e-300)), float(np.log(needed)))
    if at is None:
        return None
    value = float(top * (1.0 - np.exp(at) if limit else np.exp(at)))
    if not spec.low <= value <= spec.high:
        return None
    row = {"parameter": spec.name, "value": value, "unit": spec.unit}
    return row | ({"limit": True} if limit else {})


def first_above(x: np.ndarray, y: np.ndarray, level: float) -> float | None:
    """Return where a polygon first rises above a level; None where it does not.

    Parameters
    ----------
    x, y : ndarray, shape (points,)
        x rising.
    """
    above = np.flatnonzero(y >= level)
    if not above.size:
        return None
    k = int(above[0])
    if k == 0:
        return float(x[0])
    share = (level - y[k - 1]) / (y[k] - y[k - 1])
    return float(x[k - 1] + share * (x[k] - x[k - 1]))


@dataclass(frozen=True, eq=False)
class ThresholdEffect:
    """What a threshold does to the readings of an entry, to first order in its force."""

    arena: Arena
    entry: Entry
    responses: Responses
    number: int
    candidate: Candidate

    def shown(self, levels: np.ndarray) -> np.ndarray:
        """Return the squared effect on the weighted readings, parameters and starts projected out.

        Parameters
        ----------
        levels : ndarray, shape (levels,)
            Values of the threshold.
        """
        responses, segments = self.responses, self.responses.segments
        power, cross = np.zeros(levels.size), np.zeros((levels.size, len(responses.inverse)))
        forces, readings = self._forces(levels), self._readings(levels)
        for s in range(segments.number):
            count = int(segments.count[s])
            g = readings[:, :, :count, s]
            for site, force in forces.items():
                g = g + responses.to(site, s, force[:, : count - 1, s].T)
            seen = responses.parts[s].projected(g, responses.residual[:, :count, s])
            power += np.einsum("lr,lr->l", seen.flat, seen.flat)
            cross += seen.cross
        return np.maximum(power - np.einsum("lp,pq,lq->l", cross, responses.inverse, cross), 0.0)

    def largest(self) -> float:
        """Return the largest size of what is limited: an input, or a reading."""
        kind, _, place = self.candidate.site.partition(":")
        model, segments = self.arena.super_model.given, self.arena.problem.segments
        if kind == "input":
            return float(np.abs(segments.inputs[model.inputs.index(place)]).max())
        shown = evaluate(model.reading_terms[place], self._signals(middle=False))
        seen = np.isfinite(segments.outputs[model.outputs.index(place)])
        return float(np.abs(np.broadcast_to(shown, seen.shape)[seen]).max(initial=0.0))

    def _forces(self, levels: np.ndarray) -> dict[int, np.ndarray]:
        """Forces in the middle of the steps, (levels, samples - 1, segments), by number of site."""
        found: dict[int, np.ndarray] = {}
        order = [site.state for site in self.responses.sites]
        for state, template in self.candidate.terms:
            value = self._value(template, levels, self._signals(middle=True))
            site = order.index(state)
            found[site] = found.get(site, 0.0) + value
        return found

    def _readings(self, levels: np.ndarray) -> np.ndarray:
        """What changes in the weighted readings, (levels, outputs, samples, segments)."""
        model, problem = self.arena.super_model.given, self.arena.problem
        found = np.zeros((levels.size, *problem.segments.outputs.shape))
        for output, template in self.candidate.readings:
            old = f"({model.readings[output]})"
            change = template.replace("{old}", old) + f" - {old}"
            k = model.outputs.index(output)
            value = self._value(change, levels, self._signals(middle=False))
            found[:, k] = value / problem.scale[k]
        return np.where(problem.segments.weights > 0.0, found, 0.0)

    def _value(self, template: str, levels: np.ndarray, signals: dict[str, Any]) -> np.ndarray:
        """Evaluate a template for every level, shape (levels, samples, segments)."""
        names = self.arena.super_model.names[self.number]
        (threshold,) = (names[spec.name] for spec in self.candidate.parameters[:1])
        text = template.format(**names)
        text = f"0 {text}" if text.startswith(("+", "-")) else text
        term = self.arena.super_model.given.term(text, "", tuple(names.values()))
        shape = next(iter(signals.values())).shape
        found = evaluate(term, {**signals, **self._values(), threshold: levels[:, None, None]})
        return np.broadcast_to(found, (levels.size, *shape))

    def _values(self) -> dict[str, float]:
        super_model = self.arena.super_model
        return dict(zip(super_model.model.parameters, self.entry.fit.theta.tolist(), strict=True))

    def _signals(self, middle: bool) -> dict[str, Any]:
        """States, inputs and time at the samples, or in the middle of the steps between them."""
        model, segments = self.arena.super_model.given, self.arena.problem.segments
        x, u, time = self.responses.path, segments.inputs, segments.time
        if middle:
            x, time = 0.5 * (x[:, 1:] + x[:, :-1]), 0.5 * (time[1:] + time[:-1])
            u = segments.stages[1].mean(axis=2)
        signals = dict(zip(model.states, x, strict=False)) | dict(zip(model.inputs, u, strict=True))
        return {model.time: time, **signals}
