r"""Rates of a vector field as a balance of forces: M(x) dx/dt = F, with M the inverse of df/du.

Where forces enter the rates by the columns B of \partial f/\partial u, the weak view weighs
M = B^{-1} times the rates, as it does with the mass matrix of a model file: a force then stands in
its own row, in its own unit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.expressions import Term
from jaxsr.expressions.derivative import ZERO
from jaxsr.models.model import Model

Array = Any
Valued = tuple[Array, dict[str, Array]]


@dataclass(frozen=True)
class Balance:
    """How forces enter the rates of some states.

    Attributes
    ----------
    states : tuple of str
        Those along which forces enter by a known column.
    gains : mapping
        (rate, force) to what the force is multiplied by; zeros are left out.
    """

    states: tuple[str, ...]
    gains: Mapping[tuple[str, str], Term]

    @staticmethod
    def of(model: Model) -> Balance | None:
        """Return the balance of a model, None where no force enters by a factor."""
        if model.vector_field is None or not model.vector_field.columns:
            return Balance._of_formulas(model)
        columns = model.vector_field.columns
        states = tuple(s for s in model.states if s in columns)
        gains = {}
        for state in states:
            for row, factor in columns[state].rows:
                if row in states:
                    gains[row, state] = model.term(factor or "1")
        return Balance(states, {k: g for k, g in gains.items() if g != ZERO})

    @staticmethod
    def _of_formulas(model: Model) -> Balance | None:
        factors = model.force_factors
        if not factors:
            return None
        states = tuple(s for s in model.states if s in factors)
        gains = {(row, s): g for s in states for row, g in factors[s].rows if row in factors}
        return Balance(states, gains)

    def row(self, state: str) -> tuple[str, ...]:
        """Return the states whose rates stand in a state's balance: those coupled to it."""
        reached, new = {state}, {state}
        while new:
            new = {
                s for pair in self.gains for s in pair if reached & set(pair) and s not in reached
            }
            reached |= new
        return tuple(s for s in self.states if s in reached)

    def weighed(
        self, gains: Mapping[tuple[str, str], Valued], rates: Mapping[str, Valued], samples: int
    ) -> tuple[dict[str, Valued], dict[tuple[str, str], Valued]]:
        r"""Return forces and masses with their slopes.

        With B the gains, M = B^{-1}, F = M f:

        .. math:: M' = -M B' M, \quad F' = M (f' - B' F).

        Parameters
        ----------
        gains, rates : mapping
            Values, numbers or shape (samples,), and slopes by name.
        """
        n = len(self.states)
        b, slopes_b = _tables(gains, self.states, samples)
        f = np.stack([np.broadcast_to(rates[s][0], samples) for s in self.states])
        with np.errstate(all="ignore"):
            mass = np.nan_to_num(_inverse(b))
            force = np.einsum("ijt,jt->it", mass, f)
        names = {*slopes_b, *(name for s in self.states for name in rates[s][1])}
        by_force: list[dict[str, Array]] = [{} for _ in self.states]
        by_mass: dict[tuple[int, int], dict[str, Array]] = {
            (i, j): {} for i in range(n) for j in range(n)
        }
        for name in names:
            slope = np.stack(
                [np.broadcast_to(rates[s][1].get(name, 0.0), samples) for s in self.states]
            )
            if name in slopes_b:
                slope = slope - np.einsum("ijt,jt->it", slopes_b[name], force)
                change = -np.einsum("ijt,jkt,klt->ilt", mass, slopes_b[name], mass)
                for i, j in by_mass:
                    by_mass[i, j][name] = change[i, j]
            moved = np.einsum("ijt,jt->it", mass, slope)
            for i in range(n):
                by_force[i][name] = moved[i]
        forces = {s: (force[i], by_force[i]) for i, s in enumerate(self.states)}
        masses = {
            (s, t): (mass[i, j], by_mass[i, j])
            for i, s in enumerate(self.states)
            for j, t in enumerate(self.states)
        }
        return forces, masses


def _tables(
    gains: Mapping[tuple[str, str], Valued], states: Sequence[str], samples: int
) -> tuple[Array, dict[str, Array]]:
    """Return the gains as a matrix a sample, shape (states, states, samples), and its slopes."""
    n = len(states)
    values, slopes = np.zeros((n, n, samples)), dict[str, Array]()
    for (row, column), (value, by) in gains.items():
        place = states.index(row), states.index(column)
        values[place] = value
        for name, slope in by.items():
            slopes.setdefault(name, np.zeros((n, n, samples)))[place] = slope
    return values, slopes


def _inverse(matrix: Array) -> Array:
    """Invert a matrix a sample; those that are singular become zero."""
    moved = np.moveaxis(matrix, 2, 0)
    sound = np.isfinite(moved).all((1, 2))
    sound[sound] = np.linalg.cond(moved[sound]) < 1e12
    result = np.zeros_like(moved)
    result[sound] = np.linalg.inv(moved[sound])
    return np.moveaxis(result, 0, 2)
