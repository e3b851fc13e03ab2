"""Forces from outside that no column records: a push in a window of time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from jaxsr.diagnosis.candidates import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import Site

CONCENTRATED = 0.3
"""Share of the residual's power that one push must remove."""
LONGEST = 0.1
"""Length of a push over the length of the recording."""


def external(site: Site) -> Iterator[Candidate]:
    """Yield a push of Gaussian shape, where the residual is concentrated in time."""
    time, v, f = site.model.time, site.state, site.force_unit
    for centre, width in _windows(site):
        yield Candidate(
            "transient_force",
            "external",
            f"external:{v}",
            (
                ParameterSpec("J", _times_second(f)),
                ParameterSpec("t0", "s", centre - 3 * width, centre + 3 * width, centre, False),
                ParameterSpec("dt", "s", width / 4.0, 4.0 * width, width, False),
            ),
            "Something that no column records pushed {site} once, with impulse J around t0.",
            # 0.5642 = 1/sqrt(pi): the integral of the push over time is J.
            terms=((v, f"+ 0.564189583547756*{{J}}/{{dt}}*exp(-(({time} - {{t0}})/{{dt}})**2)"),),
            source="Goldstein, Classical Mechanics (1980), section 1.1 (impulse)",
        )


def _times_second(unit: str | None) -> str | None:
    return f"{unit}*s" if unit else None


def _windows(site: Site) -> list[tuple[float, float]]:
    """Centre and width of the push that removes most of the residual.

    Only where a single window of the only recording holds most of what is left: a push has a
    time of its own, and a force that acts all along would otherwise pass for one.
    """
    motion, time = site.motion, site.signal("t")
    if motion is None or time is None:
        return [(1.0, 0.5)]
    if motion.recordings > 1 or site.state not in motion.residual:
        return []
    span, best = float(time[-1] - time[0]), (0.0, 0.0, 0.0)
    for width in np.geomspace(
        4.0 * motion.spacing, max(LONGEST * span / 2.0, 4.0 * motion.spacing), 4
    ):
        for centre in np.arange(time[0] + width, time[-1], max(width, span / 200.0)):
            push = np.exp(-(((time - centre) / width) ** 2))[:, None]
            best = max(best, (motion.share(site.state, push)[0], float(centre), float(width)))
    return [best[1:]] if best[0] > CONCENTRATED else []
