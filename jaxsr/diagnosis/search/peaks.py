"""Stribeck peaks beside Coulomb friction: at which velocity one would lower the cost most."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr.diagnosis.contest.arena import Arena, in_steps_of
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.locating.responses import Responses
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.expressions import evaluate, parse

VELOCITIES = 12
"""Widths of a peak looked at, from twice its bound on."""
WIDEST = 0.7
"""Widest peak looked at, relative to its bound: a wider one is a constant."""


def peaked(
    arena: Arena, plain: Entry, inner: int, laws: Sequence[int]
) -> list[tuple[int, dict[str, float]]]:
    """Return the Stribeck law of each form that would help an entry most, and where it starts.

    Beside the friction Fc that the entry has, the peak (Fs - Fc)*exp(-(abs(v)/vs)**n) is linear
    in its height: one linearisation tells what every vs gains. Forms that gain by a dip alone are
    left out.
    """
    super_model = arena.super_model
    law = super_model.candidates[laws[0]]
    sites = sites_of(super_model.given, {})
    at = next((j for j, s in enumerate(sites) if s.name == law.site), None)
    if at is None or plain.fit.path is None or not plain.fit.usable:
        return []
    responses = Responses.of(in_steps_of(arena, plain), plain, sites)
    state = list(super_model.given.states).index(sites[at].state)
    friction = super_model.own_values(inner, plain.fit.theta)["Fc"]
    best: dict[object, tuple[float, int, dict[str, float]]] = {}
    for number in laws:
        width = next(p for p in super_model.candidates[number].parameters if p.name == "vs")
        grid = np.geomspace(2.0 * width.low, WIDEST * width.high, VELOCITIES)
        ((_, text),) = super_model.candidates[number].terms
        term = parse(text.format(Fc="0", Fs="1", vs="vs"))

        def shapes(s: int, term=term, grid=grid) -> np.ndarray:
            speed = responses.path[state, : int(responses.segments.count[s]), s]
            middle = 0.5 * (speed[1:] + speed[:-1])[:, None]
            return np.asarray(evaluate(term, {sites[at].state: middle, "vs": grid}))

        gains, heights = responses.gains(at, shapes, 1)
        gains = np.where(heights[:, 0] > 0.0, gains, 0.0)
        k = int(np.argmax(gains))
        start = {"Fc": friction, "Fs": friction + float(heights[k, 0]), "vs": float(grid[k])}
        form = super_model.candidates[number].terms
        if gains[k] > (best[form][0] if form in best else 0.0):
            best[form] = float(gains[k]), number, start
    return [(number, start) for _, number, start in best.values()]
