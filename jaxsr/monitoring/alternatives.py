"""What may be different when a machine stops following its model: filters that expect more.

Each is a likelihood of its own. A force at one equation of motion that the model does not know
(friction, load, stiffness, a push), steady or brisk; a sensor that drifts away, or grows noisy.
How large they are is settled by what they cost in normal running: a change as small as can be
noticed at all, and one that shows at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.likelihood.sensor_noise import Noise
from jaxsr.monitoring.following import Filter, Follower
from jaxsr.monitoring.normal import Normal

STEADY, BRISK = 48.0, 6.0
"""Samples for which an unknown force keeps its sign."""
DRIFTING = 96.0
"""The same of a sensor's error."""
COSTS = (0.5, 4.0)
"""Logarithms of the ratio that one block of normal running costs an alternative: the least that
tells anything apart, and enough to be told at once."""
SIZES = np.geomspace(1e-7, 10.0, 25)
"""Sizes that are tried, in the net force along an equation or the deviation of a reading."""

Logs = Callable[[Sequence[Filter]], np.ndarray]
"""Log densities of normal running under some filters, shape (filters, blocks)."""


@dataclass(frozen=True, eq=False)
class Alternative:
    """A way to depart from normal running.

    Attributes
    ----------
    site : str
        ``equation:STATE`` or ``output:NAME``.
    kind : str
        In words.
    filter : Filter
        What it expects.
    normal : Filter
        The normal running that is most like it, within what the estimate leaves open.
    """

    site: str
    kind: str
    filter: Filter
    normal: Filter


def alternatives(follower: Follower, normal: Normal, logs: Logs) -> list[Alternative]:
    """Return what is weighed against normal running.

    Parameters
    ----------
    follower : Follower
    normal : Normal
    logs : callable
        Log densities of the blocks of normal running that `normal` rests on.
    """
    usual, found = logs([normal.filter])[0], list[Alternative]()
    for site, kind, sized in _ways(follower, normal.filter):
        filters = [sized(size) for size in SIZES]
        costs = np.nanmean(usual - logs(filters), axis=1)
        sizes = [s for cost in COSTS if (s := _size(costs, cost)) is not None]
        for size in dict.fromkeys(sizes):
            changed = sized(size)
            gains = np.nan_to_num(logs([changed])[0] - usual, nan=-np.inf)
            found.append(Alternative(site, kind, changed, normal.least_favourable(gains)))
    return found


def _size(costs: np.ndarray, cost: float) -> float | None:
    """Return the size at which costs, which rise with it, cross one; None where they never do."""
    above = np.flatnonzero(costs >= cost)
    if not above.size:
        return None
    last = int(above[0])
    if last == 0:
        return float(SIZES[0])
    share = (cost - costs[last - 1]) / (costs[last] - costs[last - 1])
    return float(SIZES[last - 1] * (SIZES[last] / SIZES[last - 1]) ** share)


def _ways(
    follower: Follower, normal: Filter
) -> Iterator[tuple[str, str, Callable[[float], Filter]]]:
    """Yield every way to depart: where, how, and the filter of a size."""
    spread = follower.spread
    for k, site in enumerate(follower.sites):
        for samples in (STEADY, BRISK):
            if follower.size[k] > 0.0:
                yield site, "an unknown force", _pushed(normal, k, follower.size[k], samples)
    for k, output in enumerate(follower.model.outputs):
        site = f"output:{output}"
        yield site, "a sensor that drifts", _drifting(normal, k, spread[k])
        yield site, "a sensor that grew noisy", _noisy(normal, k, spread[k])


def _pushed(normal: Filter, k: int, size: float, samples: float) -> Callable[[float], Filter]:
    def sized(share: float) -> Filter:
        scale = normal.scale.copy()
        scale[k] = np.hypot(scale[k], share * size)
        return replace(normal, scale=scale, decay=float(np.exp(-1.0 / samples)))

    return sized


def _drifting(normal: Filter, k: int, spread: float) -> Callable[[float], Filter]:
    noise, own = normal.noise, -1.0 / np.log(normal.noise.correlation[k])

    def sized(share: float) -> Filter:
        # One coloured part is all that a sensor has: its time is that of both, by their variances.
        slow, before = (share * spread) ** 2, noise.coloured[k]
        samples = (before * own + slow * DRIFTING) / (before + slow)
        parts = noise.white[k], before + slow, float(np.exp(-1.0 / samples))
        return replace(normal, noise=_with(noise, k, *parts))

    return sized


def _noisy(normal: Filter, k: int, spread: float) -> Callable[[float], Filter]:
    noise = normal.noise

    def sized(share: float) -> Filter:
        white = noise.white[k] + (share * spread) ** 2
        return replace(
            normal, noise=_with(noise, k, white, noise.coloured[k], noise.correlation[k])
        )

    return sized


def _with(noise: Noise, sensor: int, white: float, coloured: float, correlation: float) -> Noise:
    """Return the noise with that of one sensor replaced."""
    parts = noise.white.copy(), noise.coloured.copy(), noise.correlation.copy()
    for part, value in zip(parts, (white, coloured, correlation), strict=True):
        part[sensor] = value
    return Noise(*parts)
