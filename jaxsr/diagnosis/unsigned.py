"""Sensors that read absolute values: told by the evidence of readings with their signs given back.

The sensor is either as the model says, or rectified: its readings then are those of the model with
signs that nobody recorded (`models.unfolding`). Both re-calibrations follow the same number of
samples beside forces that nobody knows, and their log evidences are compared with the prior odds of
one mechanism among all. What follows works on the readings with their signs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from jaxsr._deadline import never
from jaxsr.diagnosis.likelihood.course import followed
from jaxsr.diagnosis.mechanisms import force_candidates, sensor_candidates
from jaxsr.diagnosis.rectified import Rectified, signed
from jaxsr.diagnosis.setup import prepare, state_scale
from jaxsr.diagnosis.thinning import for_evidence
from jaxsr.models import Model, Simulator
from jaxsr.models.segments import Prepared
from jaxsr.models.unfolding import absolute
from jaxsr.recordings import Recording

BELOW, NEAR = 0.05, 0.1
"""Size of readings on the other side, and of those that are near zero, in the largest."""
DIPS, TURNS = 3, 4
"""Fewest times that readings come near zero and leave it again, and most turns of signs and values.
"""


def one_sided(values: np.ndarray) -> bool:
    """Whether readings return to zero again and again and never go beyond it."""
    values = values[np.isfinite(values)]
    top = float(values.max(initial=0.0))
    if not top > 0.0 or values.min() < -BELOW * top:
        return False
    away = np.concatenate([[False], values > 3.0 * NEAR * top, [False]])
    near = values < NEAR * top
    edges = np.flatnonzero(np.diff(away.astype(int)))
    gaps = zip(edges[1:-1:2], edges[2:-1:2], strict=False)
    return sum(bool(near[a:b].any()) for a, b in gaps) >= DIPS


def rectified_sensors(
    simulator: Simulator, prepared: Sequence[Prepared], stop: Callable[[], bool] = never
) -> tuple[Rectified, ...]:
    """Return the sensors whose readings have lost their signs.

    Only readings that return to zero from one side are looked at: others cost nothing. Once the
    time is over (`stop`), no more sensors are told.
    """
    model = simulator.model
    if model.events:
        return ()
    columns = zip(*(p.outputs.T for p in prepared), strict=True)
    asked = [
        output
        for output, parts in zip(model.outputs, columns, strict=True)
        if absolute(model.reading_terms[output]) is None and one_sided(np.concatenate(parts))
    ]
    if not asked:
        return ()
    found: tuple[Rectified, ...] = ()
    prepared = for_evidence(model, prepared)
    recordings = [p.recording for p in prepared]
    before = _recalibrated(model, recordings, stop)[0]
    for output in asked:
        if stop():  # one evidence without the other tells nothing
            return found
        sensor, changed, after = _best_signs(model, recordings, output, stop)
        scale = state_scale(model, prepared)
        every = [*force_candidates(model, scale), *sensor_candidates(model)]
        odds = after - before - float(np.log(len({c.label for c in every}) + 1))
        if odds > 0.0:
            found = (*found, replace(sensor, log_odds=odds))
            recordings, before = changed, after
    return found


def _best_signs(
    model: Model, recordings: Sequence[Recording], output: str, stop: Callable[[], bool]
) -> tuple[Rectified, list[Recording], float]:
    """Return a sensor with the values that tell its signs, signed recordings, log evidence.

    Signs tell values and values signs, in turns as long as the evidence grows.
    """
    sensor = Rectified(output, 0.0)
    changed = signed(model, recordings, (sensor,))
    best, values = _recalibrated(model, changed, stop)
    for _ in range(TURNS):
        if stop():
            break
        other = replace(sensor, values=values)
        anew = signed(model, recordings, (other,))
        log, values = _recalibrated(model, anew, stop)
        if not log > best:
            break
        sensor, changed, best = other, anew, log
    return sensor, changed, best


def _recalibrated(
    model: Model, recordings: Sequence[Recording], stop: Callable[[], bool]
) -> tuple[float, dict[str, float]]:
    """Return log evidence and values beside unknown forces; none where nothing can be followed."""
    course = None if stop() else followed(model, prepare(model, recordings), stop)
    if course is None:
        return -np.inf, {}
    free = set(model.free_parameters)
    found = course.null.constants
    return course.null.log_evidence, {n: value for n, (value, _) in found.items() if n in free}
