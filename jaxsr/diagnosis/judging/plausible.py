"""Whether the estimates of a set keep to physics."""

from __future__ import annotations

import numpy as np

from jaxsr.diagnosis.shooting.arena import Arena, in_steps_of
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.uncertainty import half_widths
from jaxsr.diagnosis.shooting.widths import width_of

STEEPEST = 3.0
"""Largest ratio of breakaway to Coulomb friction."""


def plausible(arena: Arena, entry: Entry) -> bool:
    """Whether the estimates keep to physics: no bound is touched, Fs is not below Fc."""
    return entry.fit.usable and sound_members(arena, entry) == entry.members


def sound_members(arena: Arena, entry: Entry) -> tuple[int, ...]:
    """Return the members whose estimates keep to physics."""
    return tuple(i for i in entry.members if _sound(arena, entry, i))


def _sound(arena: Arena, entry: Entry, number: int) -> bool:
    """Whether the estimates of one member keep to physics."""
    super_model, theta = arena.super_model, entry.fit.theta
    order = list(super_model.model.parameters.values())
    candidate, values = super_model.candidates[number], super_model.own_values(number, theta)
    if candidate.physical is not None and not candidate.physical(values):
        return False
    if candidate.mechanism == "stribeck_friction" and not _peaked(arena, entry, number):
        return False
    for spec, index in zip(candidate.parameters, super_model.index(number), strict=False):
        value, parameter = theta[index], order[index]
        low, high = parameter.bounds or (spec.low, spec.high)
        if value <= low or (value >= high and not spec.hard):
            return False
    return True


def _peaked(arena: Arena, entry: Entry, number: int) -> bool:
    """Whether a Stribeck peak is one: Fc <= Fs <= `STEEPEST` Fc, as far as the data tell them.

    It must also hold more than the smoothing of sign() takes away: the area of the peak over
    velocity, (Fs - Fc) vs sqrt(pi)/2, against the area Fc w log 2 that tanh(v/w) lacks.
    """
    super_model = arena.super_model
    values = super_model.own_values(number, entry.fit.theta)
    low, high = values["Fc"], STEEPEST * values["Fc"] + 1e-12
    if not low <= values["Fs"] <= high and entry.fit.jacobian.size:
        half = np.zeros(len(entry.fit.theta))
        half[entry.fit.active] = half_widths(arena, entry.fit)
        of = dict(zip(super_model.names[number], half[super_model.index(number)], strict=False))
        low, high = low - of["Fc"] - of["Fs"], high + STEEPEST * of["Fc"] + of["Fs"]
    if not low <= values["Fs"] <= high:
        return False
    width = width_of(in_steps_of(arena, entry).problem, super_model.candidates[number])
    peak = (values["Fs"] - values["Fc"]) * values["vs"] * 0.5 * np.sqrt(np.pi)
    return peak >= 3.0 * values["Fc"] * width * np.log(2.0)
