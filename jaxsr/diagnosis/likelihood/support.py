"""Which candidates of a model with many equations the readings speak for at all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence

import numpy as np

from jaxsr.diagnosis.likelihood.course import Course
from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import Threshold
from jaxsr.expressions import evaluate
from jaxsr.models import Model

MOST = 120
"""Candidates up to which all become columns: a table's cost grows with their number."""
SITES = 3
"""Equations at which memories are offered where candidates are more than that: those with the
largest residual forces."""


def supported(model: Model, course: Course, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the forces of which the readings are most evidence, and all others; all where few.

    Each is weighed by its best coefficient, along the path of re-calibration and to first order
    (`Response.gains`): smoothed forces tell nothing where they were taken for noise.
    Of those at one place that differ in their inner constants alone, one comes before the second
    of any: what re-calibration does most of adds little, and is asked all the same. A limit of
    an actuator that is sharp is another law than a round one. What is no force along an equation (a
    sensor, a wrong value, a mass) stays, and so does a constant force along each; where that is
    much, `MOST` is exceeded by half for what is a force.

    Parameters
    ----------
    candidates : sequence of Candidate
        Of any number.
    """
    if len(candidates) <= MOST:
        return list(candidates)
    signals = {**course.motion.signals, **{n: p.value for n, p in model.parameters.items()}}
    loud = sorted(course.motion.residual, key=lambda s: -_power(course, s))[:SITES]
    kept, ranked = [], []
    for number, candidate in enumerate(candidates):
        forces = bool(candidate.terms) and not candidate.readings and not candidate.inertia
        if candidate.states and candidate.terms:
            if candidate.terms[0][0] in loud:
                kept.append(number)
        elif not forces or candidate.mechanism == "constant_force":
            kept.append(number)
        else:
            ranked.append(number)
    gains = _gains(model, course, [candidates[i] for i in ranked], signals)
    ranked = sorted(zip(gains, ranked, strict=True), reverse=True)
    turns, taken = Counter[Hashable](), list[tuple[int, int]]()
    for place, (_, number) in enumerate(ranked):
        law = _law(candidates[number])
        taken.append((turns[law], place))
        turns[law] += 1
    room = max(MOST - len(kept), MOST // 2)  # many sensors are no reason to ask about no force
    kept += [ranked[place][1] for _, place in sorted(taken)[:room]]
    return [candidates[i] for i in sorted(kept)]


def _law(candidate: Candidate) -> Hashable:
    """Return what variants have in common: of an actuator the formula, of a force its label."""
    label = candidate.label
    return (label, candidate.terms) if candidate.site.startswith("input:") else label


def _power(course: Course, state: str) -> float:
    """Return the mean square of what is missing along an equation, in that of its net force."""
    missing = course.motion.residual[state]
    return float(missing @ missing) / max(missing.size, 1) / course.size[state] ** 2


def _gains(
    model: Model,
    course: Course,
    candidates: Sequence[Candidate],
    signals: Mapping[str, np.ndarray | float],
) -> list[float]:
    """Return the log evidence that the best coefficient of each candidate adds."""
    response, forces, owner = course.response(), list[Mapping[str, np.ndarray]](), list[int]()
    for number, candidate in enumerate(candidates):
        names = candidate.names(set(model.symbols), "__0")
        for spec in candidate.parameters:
            if not spec.coefficient:
                continue
            force: dict[str, np.ndarray] = {}
            for state, template in candidate.terms:
                if state in response.states:
                    slope = _slope(model, candidate, names, spec, template, signals)
                    force[state] = force[state] + slope if state in force else slope
            forces.append(force)
            owner.append(number)
    best = np.full(len(candidates), -np.inf)
    np.maximum.at(best, owner, response.gains(forces))
    return best.tolist()


def _slope(
    model: Model,
    candidate: Candidate,
    names: Mapping[str, str],
    spec: ParameterSpec,
    template: str,
    signals: Mapping[str, np.ndarray | float],
) -> np.ndarray:
    """Return the derivative of a term by a coefficient along the motion, shape (samples,)."""
    step = spec.seed - spec.neutral if isinstance(spec, Threshold) else 1.0
    own = {names[s.name]: s.neutral for s in candidate.parameters}
    moved = {**own, names[spec.name]: spec.neutral + step}
    term = model.term(template.format(**names).removeprefix("+ "), extra=tuple(own))
    with np.errstate(all="ignore"):
        high, low = (np.asarray(evaluate(term, {**signals, **p})) for p in (moved, own))
        slope = np.broadcast_to((high - low) / step, np.shape(signals["t"]))
    return np.nan_to_num(slope, posinf=0.0, neginf=0.0)
