"""Pushes from outside, located in free run: where and when one would lower the cost most."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from jaxsr.diagnosis.contest.arena import Arena
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.judging.criteria import independent_residuals
from jaxsr.diagnosis.locating.responses import Responses, surely
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.external import CONCENTRATED, LONGEST, push
from jaxsr.diagnosis.mechanisms.site import Site

MOST = 2
CENTRES = 100
"""Centres looked at in a segment for each width."""
SHORTEST = 4.0
"""Shortest push in samples."""


@dataclass(frozen=True)
class _Push:
    """A window in one recording and what a push there gains."""

    site: Site
    recording: int
    centre: float
    width: float
    gain: float


def push_candidates(
    arena: Arena, entry: Entry, responses: Responses, stop: Callable[[], bool] = lambda: False
) -> list[Candidate]:
    r"""Propose pushes in single recordings beside an entry.

    A force of Gaussian shape along an equation, in the window (t0, dt) of one recording, moves
    the readings by J g; free parameters and the segment's start, which move along, are projected
    out of g. To first order the cost falls by :math:`(g^T r)^2 / g^T g`, which is compared with
    what windows usually gain and with the best of as many windows of noise.
    """
    found, gains = [], []
    for push_, gain in _scanned(arena, responses):
        if stop():
            break
        found.append(push_)
        gains.append(gain)
    if not found:
        return []
    every = np.concatenate(gains)
    independent = independent_residuals(entry)
    # Where more than noise is left, windows usually gain more than chi-squared's median.
    usual = float(np.median(every)) * independent / entry.fit.cost
    sure = surely(entry.fit.cost, independent / max(usual / 0.455, 1.0), every.size)
    single = len({p.recording.name for p in arena.prepared}) == 1
    least = max(sure, CONCENTRATED * entry.fit.cost if single else 0.0)
    best = sorted((p for p in found if p.gain > least), key=lambda p: -p.gain)
    names = [p.recording.name for p in arena.prepared]
    chosen: dict[tuple[str, int], _Push] = {}
    for item in best:
        chosen.setdefault((item.site.state, item.recording), item)
    return [
        push(
            p.site,
            p.centre,
            p.width,
            tuple(n for n in names if n != names[p.recording]),
            every.size,
            _longest(arena),
        )
        for p in list(chosen.values())[:MOST]
    ]


def _scanned(arena: Arena, responses: Responses) -> Iterator[tuple[_Push, np.ndarray]]:
    """Yield the best push of every equation, segment and width, and the gains of all windows."""
    segments = responses.segments
    longest = 0.5 * _longest(arena)
    for s in range(segments.number):
        count = int(segments.count[s])
        time = segments.time[:count, s]
        step = float(np.median(np.diff(time)))
        shortest = SHORTEST * step
        for width in np.geomspace(shortest, max(longest, shortest), 4):
            span = time[-1] - time[0] - width
            if span <= 0:
                continue
            number = int(np.clip(span / width * 2.0, 1, CENTRES))
            centres = time[0] + width / 2.0 + span * (np.arange(number) + 0.5) / number
            middle = 0.5 * (time[1:] + time[:-1])
            shape = np.exp(-(((middle[:, None] - centres) / width) ** 2)) / width / np.sqrt(np.pi)
            for j, site in enumerate(responses.sites):
                gains = _gains(responses, j, s, shape)
                k = int(np.argmax(gains))
                best = _Push(
                    site, int(segments.recording[s]), float(centres[k]), width, float(gains[k])
                )
                yield best, gains


def _longest(arena: Arena) -> float:
    """Longest push in seconds."""
    return LONGEST * max(float(p.time[-1] - p.time[0]) for p in arena.prepared)


def _gains(responses: Responses, site: int, segment: int, shape: np.ndarray) -> np.ndarray:
    """How much the cost falls with each of the pushes `shape` (samples - 1, pushes)."""
    g = responses.to(site, segment, shape)
    residual = responses.residual[:, : g.shape[-1], segment]
    seen = responses.parts[segment].projected(g, residual)
    power = np.einsum("wr,wr->w", seen.flat, seen.flat)
    power -= np.einsum("wp,pq,wq->w", seen.cross, responses.inverse, seen.cross)
    score = seen.score - seen.cross @ responses.pull
    clear = power > 1e-4 * seen.raw
    return np.where(clear, score**2 / np.where(clear, power, 1.0), 0.0)
