"""Members of a set that are no findings beside its others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr.diagnosis.contest.arena import Arena, neutral_values
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.judging.noise_ratio import ratios_to_noise
from jaxsr.diagnosis.judging.refine import Estimate


def without_minor(chosen: Entry, arena: Arena, entries: Sequence[Entry]) -> Entry | None:
    """Return a set of mechanisms without the one that explains least, if more is left than that.

    Something that nobody named has a larger share then, which the mechanism may imitate.

    Parameters
    ----------
    chosen : Entry
        The set, as free runs chose it.
    arena : Arena
    entries : sequence of Entry
        Every set that was estimated.

    Returns
    -------
    Entry or None
        None where every mechanism explains more, where nothing would be left, and where that set
        was not estimated.
    """
    candidates = arena.super_model.candidates
    laws = [i for i in chosen.members if candidates[i].fixed_parameter is None]
    smaller = {i: without for i in laws if (without := _without(chosen, i, entries)) is not None}
    doubts = {i: left_for_gained(arena, chosen, without) for i, without in smaller.items()}
    least = max(doubts, key=doubts.__getitem__, default=None)
    return smaller[least] if least is not None and doubts[least] >= 1.0 else None


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
            without = _without(chosen, number, entries)
            if without and abs(best.theta[place] - given[place]) <= best.told[place]:
                return without
    return None


def _without(chosen: Entry, number: int, entries: Sequence[Entry]) -> Entry | None:
    rest = {*chosen.members} - {number}
    return next((e for e in entries if rest and {*e.members} == rest), None)


def left_for_gained(arena: Arena, whole: Entry, rest: Entry) -> float:
    r"""Return what a set leaves above the noise, for what a member of it explains.

    .. math:: \min_k \frac{\lVert r_k \rVert^2 (1 - 1/\rho_k^2)}
        {\lVert r'_k \rVert^2 - \lVert r_k \rVert^2}

    with the residuals :math:`r_k` of output k and without the member :math:`r'_k`, and the ratio
    :math:`\rho_k` of the first to the sensor's noise; over the outputs that the member explains.

    Parameters
    ----------
    arena : Arena
    whole, rest : Entry
        The set with the member and without it.

    Returns
    -------
    float
        Infinite where it explains none.
    """
    ratios = ratios_to_noise(arena, whole)
    shares = [np.inf]
    for own, others, ratio in zip(whole.fit.residual, rest.fit.residual, ratios, strict=True):
        left, gained = np.sum(own**2), np.sum(others**2) - np.sum(own**2)
        if gained > 0.0:
            shares.append(float(left * max(1.0 - ratio**-2, 0.0) / gained))
    return min(shares)
