"""Laws inside laws: a richer one begins where a simpler one ended, and the other way round."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from jaxsr.diagnosis.judging.parsimony import simpler
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import Arena, neutral_values
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.entry import Entry

INSIDE: Mapping[str, tuple[str, Mapping[str, str | float]]] = {
    "stribeck_friction": ("coulomb_friction", {"Fc": "Fc", "Fs": "Fc"}),
    "position_dependent_friction": ("coulomb_friction", {"Fc": "Fc"}),
    "power_law_drag": ("quadratic_drag", {"kd": "kd", "p": 2.0}),
}
"""A law, the simpler one inside it, and the constants at which the two are the same."""


def inner_of(candidates: Sequence[Candidate], number: int) -> int | None:
    """Return the candidate that is the simpler law inside another, at its site; None without."""
    simpler, _ = INSIDE.get(candidates[number].mechanism, ("", {}))
    label = f"{simpler}@{candidates[number].site}"
    return next((i for i, c in enumerate(candidates) if c.label == label), None)


def simplified(
    super_model: SuperModel, members: Sequence[int], theta: np.ndarray
) -> Iterator[tuple[tuple[int, ...], np.ndarray]]:
    """Yield the sets in which one member is the simpler law inside it, and where they start."""
    order, every = list(super_model.model.parameters), super_model.candidates
    for richer in members:
        inner = inner_of(every, richer)
        if inner is None or inner in members:
            continue
        values = INSIDE[every[richer].mechanism][1]
        start, own = theta.copy(), super_model.own_values(richer, theta)
        start[super_model.index(richer)] = neutral_values(super_model)[super_model.index(richer)]
        for name, value in values.items():
            if isinstance(value, str):
                at = order.index(super_model.names[inner][value])
                start[at] = max(start[at], own[name])
        yield tuple(sorted({*members, inner} - {richer})), start


def plainest(
    arena: Arena, chosen: Entry, entries: Sequence[Entry], stop: Callable[[], bool]
) -> tuple[list[Entry], Entry]:
    """Put the laws inside richer ones in their places as long as what is left allows no richer.

    They are estimated from where those ended, if they were not yet.
    """
    entries = list(entries)
    while True:
        forms = dict(simplified(arena.super_model, chosen.members, chosen.fit.theta))
        for members in sorted(forms.keys() - {e.members for e in entries}):
            if not stop():
                path = chosen.fit.path
                entries.append(enter(arena, members, forms[members], path, stop, near=True))
        fewer = simpler(chosen, arena, [e for e in entries if e.members in forms])
        if fewer is None:
            return entries, chosen
        chosen = fewer
