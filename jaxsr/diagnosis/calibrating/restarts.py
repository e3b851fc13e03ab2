"""Re-calibration from several starts: the given values, and a design that fills the bounds.

A least-squares estimate ends in the valley that it began in. One from which two starts come to the
same end is believed; elsewhere more starts are tried, over short segments first, whose cost has
fewer valleys and takes less time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from jaxsr.diagnosis.shooting.arena import Arena, neutral_values
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.entry import Entry

DRAWS = 8
"""Starts of the design beside the middle of the bounds."""
SHORT_ITERATIONS = 10
"""Iterations over short segments: they only have to tell one valley from another."""
SAME = 1e-3
"""Relative difference in cost up to which two estimates ended in the same valley."""
DECADES = 1e-3
"""Least value of a parameter between 0 and a bound, relative to the bound, where starts are
spread evenly over orders of magnitude."""
TOUCHING = 1e-6
"""Distance from a bound, relative to the bounds' width, at which an estimate lies on it."""


@dataclass(frozen=True, eq=False)
class Restarts:
    """Where a re-calibration may begin anew.

    Attributes
    ----------
    arena : Arena
        In which the estimates count.
    short : callable
        Returns the arena of short segments; asked only where two starts do not suffice.
    stop : callable
        Whether to take what is known.
    iterations : int
        Of an estimate that counts.
    """

    arena: Arena
    short: Callable[[], Arena]
    stop: Callable[[], bool]
    iterations: int

    def best(self, first: Entry) -> Entry:
        """Return the best of an estimate, that from the given values, and those from more starts.

        More are tried until the best valley has been reached twice, away from every bound.
        """
        if not first.fit.active.size:
            return first
        ends = [first, self._estimate(neutral_values(self.arena.super_model))]
        if not self._settled(ends):
            for theta in self._promising():
                if self.stop():
                    break
                ends.append(self._estimate(theta))
                if self._settled(ends):
                    break
        return min(ends, key=lambda e: e.fit.cost)  # the first of equals

    def _estimate(self, theta: np.ndarray) -> Entry:
        return enter(self.arena, (), theta, None, self.stop, self.iterations)

    def _settled(self, ends: list[Entry]) -> bool:
        """Whether two starts came to the same end, the best one, inside the bounds."""
        costs = sorted(e.fit.cost for e in ends)
        best = min(ends, key=lambda e: e.fit.cost)
        if not np.isfinite(costs[1]) or touched(self.arena, best).size:
            return False
        return costs[1] <= (1.0 + SAME) * costs[0]

    def _promising(self) -> Iterator[np.ndarray]:
        """Yield where starts of the design come to over short segments, the best first."""
        place, base = self.short(), self.arena.super_model.base_index()
        neutral, found = neutral_values(self.arena.super_model), []
        low, high = (bound[base] for bound in self.arena.bounds)
        for values in design(low, high):
            if self.stop():
                break
            theta = neutral.copy()
            theta[base] = values
            fit = enter(place, (), theta, None, self.stop, SHORT_ITERATIONS).fit
            if fit.usable:
                found.append((fit.cost, fit.theta))
        found.sort(key=lambda item: item[0])
        yield from (theta for _, theta in found)


def design(low: np.ndarray, high: np.ndarray, draws: int = DRAWS) -> np.ndarray:
    """Return the middle of the bounds and a Latin hypercube inside them.

    Evenly over orders of magnitude where a bound's sign is that of all values, else evenly.

    Parameters
    ----------
    low, high : ndarray, shape (parameters,)
        Finite bounds.
    draws : int

    Returns
    -------
    ndarray, shape (1 + draws, parameters)

    References
    ----------
    McKay, Beckman & Conover, Technometrics 21 (1979).
    """
    from scipy.stats import qmc  # loading it takes half a second: only where starts are asked

    cube = qmc.LatinHypercube(low.size, rng=np.random.default_rng(0)).random(draws)
    share = np.concatenate([np.full((1, low.size), 0.5), cube])
    negative = high <= 0.0
    near, far = np.where(negative, -high, low), np.where(negative, -low, high)
    signed = near >= 0.0
    near = np.where(signed, np.maximum(near, DECADES * far), 1.0)
    with np.errstate(all="ignore"):
        spaced = near * (np.where(signed, far, 1.0) / near) ** share
    spaced = np.where(negative, -spaced, spaced)
    return np.clip(np.where(signed, spaced, low + share * (high - low)), low, high)


def touched(arena: Arena, entry: Entry) -> np.ndarray:
    """Return the positions of the given model's free parameters that lie on a bound."""
    base = np.array(arena.super_model.base_index(), dtype=int)
    low, high = (bound[base] for bound in arena.bounds)
    value, room = entry.fit.theta[base], TOUCHING * (high - low)
    return base[(value <= low + room) | (value >= high - room)]
