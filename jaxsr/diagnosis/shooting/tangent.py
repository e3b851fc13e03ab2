"""A set's readings linearised about its path, by the coefficients of further candidates too."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.reduced import Reduced, reduce
from jaxsr.models.least_squares import LARGEST, Fit, Problem
from jaxsr.models.shooting import linearise_fit

TOGETHER = 16
"""Candidates that are differentiated by at once: their columns stay in the processor's cache."""


@dataclass(frozen=True, eq=False)
class Tangent:
    """A set's estimate with its derivatives by the coefficients of further candidates.

    Attributes
    ----------
    theta : ndarray, shape (parameters,)
        Of the super-model, the switches of the set on.
    fit : Fit
        Derivatives in the order of `columns`; states of the set's own members alone.
    columns : dict of int to int
        Column of every parameter of the super-model that moves.
    """

    theta: np.ndarray
    fit: Fit
    columns: dict[int, int]

    @staticmethod
    def of(
        problem: Problem,
        super_model: SuperModel,
        members: Sequence[int],
        fit: Fit,
        numbers: Sequence[int],
    ) -> Tangent:
        """Linearise about the path of a set, a few of the candidates `numbers` at a time.

        Those that ask for the same integration stay together.
        """
        every = super_model.candidates
        order = sorted(numbers, key=lambda i: (every[i].stiff, every[i].substeps))
        parts = [[], *(order[k : k + TOGETHER] for k in range(0, len(order), TOGETHER))]
        columns: dict[int, int] = {}
        found, jacobians = [], []
        for together in parts:
            reduced, wide, theta = linearised(problem, super_model, members, fit, together)
            active = reduced.parameters[wide.active]
            new = [k for k, j in enumerate(active) if int(j) not in columns]
            columns |= {int(active[k]): len(columns) + n for n, k in enumerate(new)}
            found.append((wide, theta))
            jacobians.append(wide.jacobian[new])
        own, theta = found[0]
        own = replace(
            own, jacobian=_finite(np.concatenate(jacobians)), by_start=_finite(own.by_start)
        )
        return Tangent(theta, own, columns)


def _finite(slopes: np.ndarray) -> np.ndarray:
    """Put the directions along which a derivative overflows to zero: they promise nothing."""
    rows = slopes.reshape(len(slopes), math.prod(slopes.shape[1:]))
    largest = np.abs(rows).max(axis=1, initial=0.0)
    kept = np.isfinite(largest) & (largest < LARGEST)
    return slopes if kept.all() else np.where(kept[:, None, None, None], slopes, 0.0)


def linearised(
    problem: Problem,
    super_model: SuperModel,
    members: Sequence[int],
    fit: Fit,
    numbers: Sequence[int],
) -> tuple[Reduced, Fit, np.ndarray]:
    """Differentiate a set's estimate by the coefficients of further candidates too.

    Returns
    -------
    reduced : Reduced
        Of the set and the candidates `numbers`.
    fit : Fit
        In its order.
    theta : ndarray, shape (parameters,)
        The values in the order of the super-model, the switches of the set on.
    """
    reduced = reduce(problem, super_model, tuple(sorted({*members, *numbers})))
    further = (j for i in numbers for j in super_model.index(i, coefficients_only=True))
    active = np.array(list(dict.fromkeys([*fit.active.tolist(), *further])), dtype=int)
    theta = super_model.switched(members, fit.theta)
    here = replace(
        fit,
        theta=theta[reduced.parameters],
        path=None if fit.path is None else fit.path[reduced.states],
        x0=fit.x0[reduced.states],
    )
    return reduced, linearise_fit(reduced.problem, here, reduced.active(active)), theta
