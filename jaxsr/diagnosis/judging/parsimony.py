"""Names no richer than what a set leaves allows.

Where free runs leave more than the sensors' noise, something acts that nobody named. What a law
with more constants explains beyond a simpler one may imitate it, if it is less than that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr._result import Verdict
from jaxsr.diagnosis.judging.noise_ratio import ratios_to_noise
from jaxsr.diagnosis.judging.refine import Estimate
from jaxsr.diagnosis.shooting.arena import Arena, neutral_values
from jaxsr.diagnosis.shooting.entry import Entry


def simpler(chosen: Entry, arena: Arena, inside: Sequence[Entry]) -> Entry | None:
    """Return the best set with the law inside a richer one in the place of that.

    Parameters
    ----------
    chosen : Entry
        The set, as free runs chose it.
    arena : Arena
    inside : sequence of Entry
        The sets with one of its laws in a simpler form.

    Returns
    -------
    Entry or None
        None where each explains as much less as `chosen` leaves.
    """
    fewer = [e for e in inside if e.constants < chosen.constants and e.fit.usable]
    enough = [e for e in fewer if left_for_gained(arena, chosen, e) >= 1.0]
    return min(enough, key=lambda e: e.fit.cost, default=None)


def fewest(chosen: Entry, arena: Arena, inside: Sequence[Entry]) -> Entry:
    """Return the smallest set that explains as much but for what the chosen one leaves.

    Parameters
    ----------
    chosen : Entry
    arena : Arena
    inside : sequence of Entry
        Sets of some of its members.

    Returns
    -------
    Entry
        Of sets as small the one that leaves least; `chosen` where all explain too little.
    """
    usable = [e for e in inside if e.fit.usable]
    enough = [e for e in usable if left_for_gained(arena, chosen, e) >= 1.0]
    return min(enough, key=lambda e: (len(e.members), e.fit.cost), default=chosen)


def fewer_do(chosen: Entry, arena: Arena, inside: Sequence[Entry], than: int) -> bool:
    """Whether fewer members than some number are `fewest`, whatever sets of more would leave.

    Parameters
    ----------
    chosen : Entry
    arena : Arena
    inside : sequence of Entry
        Sets that were estimated. Those of some of its members count in which each of its verdicts
        has one: whatever is claimed, they say it.
    than : int
    """
    every = arena.super_model.candidates

    def verdicts(entry: Entry) -> set[Verdict]:
        return {every[i].verdict for i in entry.members}

    fewer = [e for e in inside if {*e.members} < {*chosen.members} and len(e.members) < than]
    fewer = [e for e in fewer if verdicts(e) == verdicts(chosen)]
    return fewest(chosen, arena, fewer) is not chosen


def without_given(
    chosen: Entry, arena: Arena, entries: Sequence[Entry], best: Estimate
) -> Entry | None:
    """Return a set without wrong values whose intervals, in `best`, hold what was given.

    None where there are none, where nothing would be left, and where that set was not estimated.
    """
    candidates, given = arena.super_model.candidates, neutral_values(arena.super_model)
    for number in chosen.members:
        name = candidates[number].fixed_parameter
        if name is not None:
            place = best.positions[name]
            rest = {*chosen.members} - {number}
            without = next((e for e in entries if rest and {*e.members} == rest), None)
            if without and abs(best.theta[place] - given[place]) <= best.told[place]:
                return without
    return None


def left_for_gained(arena: Arena, whole: Entry, rest: Entry) -> float:
    r"""Return what a set leaves above the noise, for what it explains beyond another.

    .. math:: \min_k \frac{\lVert r_k \rVert^2 (1 - 1/\rho_k^2)}
        {\lVert r'_k \rVert^2 - \lVert r_k \rVert^2}

    with the residuals :math:`r_k` of output k, those of the other set :math:`r'_k`, and the ratio
    :math:`\rho_k` of the first to the sensor's noise; over the outputs where it explains more.

    Parameters
    ----------
    arena : Arena
    whole, rest : Entry
        The set, and the one with fewer constants.

    Returns
    -------
    float
        Infinite where it explains no more in any output.
    """
    ratios = ratios_to_noise(arena, whole)
    shares = [np.inf]
    for own, others, ratio in zip(whole.fit.residual, rest.fit.residual, ratios, strict=True):
        left, gained = np.sum(own**2), np.sum(others**2) - np.sum(own**2)
        if gained > 0.0:
            shares.append(float(left * max(1.0 - ratio**-2, 0.0) / gained))
    return min(shares)
