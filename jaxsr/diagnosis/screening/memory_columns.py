"""Weak columns of mechanisms with memory: their states run along the recorded motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.screening.weak_grid import WeakGrid
from jaxsr.diagnosis.screening.weak_system import WeakSystem, weak_system
from jaxsr.models.simulator import Simulator

TOGETHER = 4
"""Memories that are integrated in one model: each adds states to all of its derivatives."""


def with_memory(
    system: WeakSystem,
    super_model: SuperModel,
    grid: WeakGrid,
    stop: Callable[[], bool] = lambda: False,
) -> WeakSystem:
    """Fill the columns of every candidate that brings a state along.

    The state is integrated along the recorded motion at the inner constants' first values; the
    coefficient of its force, or the switch of a lag, is then linear as in any other mechanism.

    Parameters
    ----------
    system : WeakSystem
        Rows of the given model, columns of `super_model`; those to fill may hold anything.
    stop : callable
        Asked between a few memories and the next: the columns of those left out are zero.
    """
    numbers = [i for i, c in enumerate(super_model.candidates) if c.states]
    jacobian = system.jacobian.copy()
    for number in numbers:
        jacobian[:, super_model.index(number)] = 0.0
    for first in range(0, len(numbers), TOGETHER):
        if stop():
            break
        few = numbers[first : first + TOGETHER]
        alone = SuperModel.build(super_model.given, [super_model.candidates[i] for i in few])
        theta = np.array([p.value for p in alone.model.parameters.values()], dtype=float)
        found = weak_system(Simulator(alone.model), grid, theta)
        for k, number in enumerate(few):
            target = super_model.index(number, coefficients_only=True)
            jacobian[:, target] = found.jacobian[:, alone.index(k, coefficients_only=True)]
    return replace(system, jacobian=jacobian)
