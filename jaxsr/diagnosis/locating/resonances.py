"""Hidden resonators, located in free run: with which frequency one would lower the cost most."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from jaxsr.diagnosis.contest.arena import Arena
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.judging.criteria import independent_residuals
from jaxsr.diagnosis.locating.responses import Responses, surely
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.memory import FASTEST, hidden_mode
from jaxsr.diagnosis.mechanisms.site import Site

APART = 1.08
"""Ratio of neighbouring frequencies: a lightly damped resonance is as wide."""
DAMPINGS = (0.05, 0.3)
"""Damping ratios looked at."""
PERIODS = 2.0
"""Fewest periods in the longest recording."""


def resonance_candidates(
    arena: Arena, entry: Entry, responses: Responses, stop: Callable[[], bool] = lambda: False
) -> list[Candidate]:
    """Propose a hidden resonator along every equation that one would help.

    A mass on a spring and a damper reacts with -mh*qh''. Along the recorded motion qh'' follows
    from the frequency and the damping, and the force is linear in mh, which is not negative.
    """
    step = float(np.median(np.diff(arena.prepared[0].time)))
    span = max(float(p.time[-1] - p.time[0]) for p in arena.prepared)
    low, high = 2.0 * np.pi * PERIODS / span, FASTEST / step
    if high <= low:
        return []
    paces = np.geomspace(low, high, int(np.ceil(np.log(high / low) / np.log(APART))) + 1)
    choices = [(pace, damping) for damping in DAMPINGS for pace in paces]
    number = len(choices) * len(responses.sites)
    least = surely(entry.fit.cost, independent_residuals(entry), number)
    found = []
    for j, site in enumerate(responses.sites):
        if site.position is None or not responses.reverses(site):
            continue  # a motion that does not return excites no resonance
        if stop():
            break
        gains, masses = responses.gains(j, _reactions(arena, responses, site, choices), 1)
        gains = np.where(masses[:, 0] > 0.0, gains, 0.0)
        best = int(np.argmax(gains))
        if gains[best] > least:
            found.append(hidden_mode(site, *choices[best], (0.5 * low, high), len(paces)))
    return found


def _reactions(
    arena: Arena, responses: Responses, site: Site, choices: list[tuple[float, float]]
) -> Callable[[int], np.ndarray]:
    """Return the reactions of resonators of mass one in the middle of a segment's steps."""
    at = list(site.model.states).index(site.state)
    whole = []
    for item in arena.prepared:
        speed = np.nan_to_num(item.states.values[:, at])
        rate = 1.0 / float(np.median(np.diff(item.time)))
        whole.append(np.stack([reaction(speed, rate, *c) for c in choices], axis=1))
    segments = responses.segments

    def reactions(s: int) -> np.ndarray:
        first = int(segments.start[s])
        own = whole[segments.recording[s]][first : first + int(segments.count[s])]
        return 0.5 * (own[1:] + own[:-1])

    return reactions


def reaction(speed: np.ndarray, rate: float, pace: float, damping: float) -> np.ndarray:
    """Return -qh'' of a resonator that swings along with a motion, samples at `rate` in 1/s.

    With V the speed, qh'' is s**2*(w**2/s + 2*z*w)*V/(s**2 + 2*z*w*s + w**2). At first the mass
    goes with the motion.
    """

    numerator = [-2.0 * damping * pace, -(pace**2), 0.0]
    denominator = [1.0, 2.0 * damping * pace, pace**2]
    from scipy.signal import bilinear, lfilter  # slow to load, and not always asked for

    b, a = bilinear(numerator, denominator, fs=rate)
    return np.asarray(lfilter(b, a, speed - speed[0]))
