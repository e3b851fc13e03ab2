"""A tree of guards with a submodel at each leaf: how the regions of modes are found."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from jaxsr.discovery.equation import Equation
from jaxsr.discovery.hybrid.guards import Guard, Region, guard_values
from jaxsr.discovery.samples import Samples

_NEAR = 0.05  # of the smaller side's samples: how far the first threshold may be off
_FEWEST = 3  # samples at least
_NEAREST = 8  # samples on either side of a guard on which laws are compared
_GAPS = 3  # samples by which the place where laws meet may be off a threshold found from samples
_STRAIGHT = 0.05  # what a parabola may leave of the difference of two laws
_TOUCHES = 1e-3  # of the difference's range: nearer to zero, a parabola touches it


@dataclass(frozen=True, eq=False)
class Node:
    """One law in a region, or two nodes on either side of a guard.

    Attributes
    ----------
    region : Region
    laws : dict of str to Equation
        Of the states whose law switches; those of the whole region, even where it is split.
    explained : bool
        Whether the laws leave nothing but noise in the region.
    guard : Guard or None
        Holds in ``above``; None at a leaf.
    below, above : Node or None
    """

    region: Region
    laws: Mapping[str, Equation]
    explained: bool
    guard: Guard | None = None
    below: Node | None = None
    above: Node | None = None
    rows: int = field(default=0)

    def leaves(self) -> Iterator[Node]:
        """Yield the leaves, those below a guard first."""
        if self.below is None or self.above is None:
            yield self
            return
        yield from self.below.leaves()
        yield from self.above.leaves()

    def predict(self, state: str, samples: Samples) -> np.ndarray:
        """Return the rate of a state, each sample by the leaf it falls in (rows,)."""
        if self.guard is None or self.below is None or self.above is None:
            return self.laws[state].predict(samples)
        held = self.guard.holds(samples.variables)
        return np.where(
            held, self.above.predict(state, samples), self.below.predict(state, samples)
        )


def clear_of(guard: Guard, samples: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows below and above a guard that are certain to be on their side.

    A threshold found by linear fits may be off by a few samples, and one sample of the other mode
    spoils an exact fit: a twentieth of the smaller side is left out on both.
    """
    values = guard_values(guard.variable, samples.variables)
    order = np.argsort(values, kind="stable")
    place = int(np.searchsorted(values[order], guard.threshold, side="right"))
    margin = max(_FEWEST, round(_NEAR * min(place, len(order) - place)))
    below, above = order[: max(place - margin, 0)], order[place + margin :]
    return np.sort(below), np.sort(above)


def refined_threshold(
    values: np.ndarray, below: np.ndarray, above: np.ndarray, first: float, reach: int
) -> float:
    r"""Return the threshold at which two laws together leave least.

    .. math:: \min_c \sum_{g \le c} e_1^2 + \sum_{g > c} e_2^2,

    halfway between two neighbouring samples.

    Parameters
    ----------
    values : ndarray, (samples,)
        The guard variable g.
    below, above : ndarray, (samples,)
        Residuals :math:`e_1, e_2` of the two laws on all samples.
    first : float
        Threshold to start from.
    reach : int
        Samples by which it may move.
    """
    order = np.argsort(values, kind="stable")
    v = values[order]
    e1, e2 = (np.nan_to_num(e[order] ** 2, nan=1e300, posinf=1e300) for e in (below, above))
    cost = np.concatenate([[0.0], np.cumsum(e1)]) + np.concatenate(
        [np.cumsum(e2[::-1])[::-1], [0.0]]
    )
    start = int(np.searchsorted(v, first, side="right"))
    low, high = max(start - reach, 1), min(start + reach, len(v) - 1)
    if low > high:
        return first
    places = np.arange(low, high + 1)
    places = places[v[places - 1] < v[places]]
    if not len(places):
        return first
    # on clean samples both laws fit next to where they meet: the middle of a plateau is taken
    costs = cost[places]
    good = places[costs <= np.min(costs) * (1.0 + 1e-9) + 1e-300]
    place = int(good[len(good) // 2])
    return float(0.5 * (v[place - 1] + v[place]))


def meeting_point(values: np.ndarray, difference: np.ndarray, first: float) -> float:
    """Return where two laws meet next to a threshold, or the threshold where they do not.

    Laws that join without a jump (a contact, a slack spring) agree at the guard: the root of a
    parabola through their difference on the nearest samples tells the place between two samples.
    Where they join without a bend as well, it touches zero there.

    Parameters
    ----------
    values : ndarray, (samples,)
        The guard variable.
    difference : ndarray, (samples,)
        One law less the other, on all samples.
    first : float
        Threshold found from the samples.
    """
    order = np.argsort(np.abs(values - first), kind="stable")[: 2 * _NEAREST]
    g, d = values[order] - first, difference[order]
    below, above = np.sort(g[g <= 0.0])[::-1], np.sort(g[g > 0.0])
    if min(len(below), len(above)) < _GAPS or not np.all(np.isfinite(d)):
        return first
    for place in _roots(g, d):
        if below[_GAPS - 1] <= place <= above[_GAPS - 1]:
            return first + place
    return first


def _roots(g: np.ndarray, d: np.ndarray) -> Iterator[float]:
    """Yield where a parabola through d(g) crosses zero, the nearest first, or touches it."""
    bend, slope, offset = np.polyfit(g, d, 2)
    if np.std(d - np.polyval((bend, slope, offset), g)) > _STRAIGHT * np.std(d):
        return
    roots = np.roots((bend, slope, offset))
    lowest = offset - 0.25 * slope**2 / bend if bend != 0.0 else np.inf
    if abs(lowest) <= _TOUCHES * np.ptp(d):
        yield float(-0.5 * slope / bend)
    else:
        yield from sorted((float(r.real) for r in roots if r.imag == 0.0), key=abs)
