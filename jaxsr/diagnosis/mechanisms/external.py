"""Forces from outside that no column records: a push in a window of time."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.motion import Motion
from jaxsr.diagnosis.mechanisms.site import Site, compose

CONCENTRATED = 0.3
"""Share of the residual's power that one push must remove."""
PROMINENT = 36.0
"""What a push removes over what one of its length usually removes in its recording: chi-squared
of one degree over its median. The largest of 200 windows of white noise gets there in one of 100
recordings."""
MOST = 2
_WINDOWS = 500
"""Centres and widths looked at in a recording, about."""
LONGEST = 0.1
"""Length of a push over the length of the recording."""

Window = tuple[float, float, tuple[str, ...]]
"""Centre, width, and the recordings in which nothing pushes."""


def external(site: Site) -> Iterator[Candidate]:
    """Yield a push of Gaussian shape, where the residual is concentrated in time."""
    for centre, width, quiet in _windows(site):
        yield push(site, centre, width, quiet, _WINDOWS * (1 + len(quiet)), _longest(site))


def push(
    site: Site, centre: float, width: float, quiet: tuple[str, ...], tried: int, longest: float
) -> Candidate:
    """Return a push around a centre, absent in the `quiet` recordings.

    What acts for longer than `longest` seconds is no push.
    """
    time, v = site.model.time, site.state
    most = max(min(4.0 * width, longest), 1.5 * width)
    return Candidate(
        "transient_force",
        "external",
        f"external:{v}",
        (
            ParameterSpec("J", _times_second(site.force_unit)),
            ParameterSpec("t0", "s", centre - 3 * width, centre + 3 * width, centre, False),
            ParameterSpec("dt", "s", width / 4.0, most, width, False),
        ),
        "Something that no column records pushed {site} once, with impulse J around t0.",
        # 0.5642 = 1/sqrt(pi): the integral of the push over time is J.
        terms=((v, f"+ 0.564189583547756*{{J}}/{{dt}}*exp(-(({time} - {{t0}})/{{dt}})**2)"),),
        quiet=quiet,
        tried=tried,
        source="Goldstein, Classical Mechanics (1980), section 1.1 (impulse)",
    )


def _longest(site: Site) -> float:
    """Longest push in seconds."""
    if site.motion is None:
        return np.inf
    edges, time = site.motion.edges, site.motion.signals["t"]
    return LONGEST * max(float(np.ptp(time[a:b])) for a, b in pairwise(edges))


def _times_second(unit: str | None) -> str | None:
    return compose(f"{unit}*s", []) if unit else None


def _windows(site: Site) -> list[Window]:
    """Return the pushes that the residual shows best.

    In a single recording only where one window holds most of what is left: a push has a time of
    its own, and a force that acts all along would otherwise pass for one. In several, where a
    window of one recording stands out of all others of its length there.
    """
    motion = site.motion
    if motion is None:
        return [(1.0, 0.5, ())]
    if site.state not in motion.residual:
        return []
    found = []
    for number, name in enumerate(motion.recordings):
        others = tuple(n for n in motion.recordings if n != name)
        share, ratio, centre, width = _strongest(site, motion, number)
        if (ratio if others else share) > (PROMINENT if others else CONCENTRATED):
            found.append((share, (centre, width, others)))
    found.sort(key=lambda item: -item[0])
    return [window for _, window in found[:MOST]]


def _strongest(site: Site, motion: Motion, number: int) -> tuple[float, float, float, float]:
    """Share of the residual's power, ratio to the median window, centre and width of a push."""
    own = slice(motion.edges[number], motion.edges[number + 1])
    time = motion.signals["t"][own]
    span = float(time[-1] - time[0])
    shortest = 4.0 * motion.spacing
    best = (0.0, 0.0, 0.0, 0.0)
    if shortest > LONGEST * span:
        return best
    for width in np.geomspace(shortest, max(LONGEST * span / 2.0, shortest), 4):
        centres = np.arange(time[0] + width, time[-1], max(width, span / 200.0))
        if centres.size < 3:
            continue
        pushes = np.zeros((motion.edges[-1], centres.size))
        pushes[own] = np.exp(-(((time[:, None] - centres) / width) ** 2))
        shares = motion.shares(site.state, pushes)
        k = int(np.argmax(shares))
        usual = float(np.median(shares)) + 1e-300
        found = (float(shares[k]), float(shares[k]) / usual, float(centres[k]), float(width))
        best = max(best, found, key=lambda f: f[1] if len(motion.recordings) > 1 else f[0])
    return best
