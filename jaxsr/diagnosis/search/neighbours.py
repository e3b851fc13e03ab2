"""Sets that lack, replace or add one mechanism, and what they leave by one linearisation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.contest.arena import Arena, neutral_values
from jaxsr.diagnosis.contest.blocks import held_back
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.contest.tangent import linearised
from jaxsr.diagnosis.judging.plausible import sound_members
from jaxsr.diagnosis.screening.screen import redundant
from jaxsr.models.least_squares import Fit, squares
from jaxsr.models.levenberg import levenberg_step


@dataclass(frozen=True, eq=False)
class Neighbours:
    """An entry, and how its readings move with the constants of every candidate.

    Attributes
    ----------
    arena : Arena
    centre : Entry
    fit : Fit
        Of the centre, with the derivatives by the free parameters, by the constants of its
        members, and by the coefficients of all other candidates.
    """

    arena: Arena
    centre: Entry
    fit: Fit

    @staticmethod
    def of(arena: Arena, centre: Entry) -> Neighbours:
        """Linearise about an entry."""
        everything = range(len(arena.super_model.candidates))
        reduced, found, theta = linearised(
            arena.problem, arena.super_model, centre.members, centre.fit, everything
        )
        return Neighbours(arena, centre, reduced.restored(found, theta, arena.problem.segments))

    def sets(self) -> Iterator[tuple[int, ...]]:
        """Yield the sets that lack one member, have another in its place, or one more.

        In a member's place come candidates that act on one of its equations.
        """
        members, super_model = self.centre.members, self.arena.super_model
        others = [i for i in range(len(super_model.candidates)) if i not in members]
        acts = [{s for s, _ in c.terms} for c in super_model.candidates]
        for number in members:
            rest = tuple(i for i in members if i != number)
            yield rest
            beside = (i for i in others if acts[i] & acts[number])
            yield from (m for i in beside if not redundant(super_model, m := _with(rest, i)))
        yield from (m for i in others if not redundant(super_model, m := _with(members, i)))

    def entry(self, members: tuple[int, ...]) -> Entry | None:
        """Expect the entry of a set; None where a new member would not keep to physics.

        With r the residual of the centre and J, X the derivatives by constants and starts, the
        set leaves

            min over d, e of || r - J_out d_out - J d - X e ||^2,

        where d_out brings the coefficients that are taken out to their neutral values.
        """
        arena, fit, super_model = self.arena, self.fit, self.arena.super_model
        place = {int(j): k for k, j in enumerate(fit.active)}
        kept, new = set(self.centre.members) & set(members), set(members) - set(self.centre.members)
        base = [j for j in super_model.base_index() if j in place]
        active = {*base, *(j for i in kept for j in super_model.index(i) if j in place)}
        active |= {j for i in new for j in super_model.index(i, coefficients_only=True)}
        theta, residual, neutral = fit.theta.copy(), fit.residual, neutral_values(super_model)
        for number in set(self.centre.members) - kept:
            for j in super_model.index(number, coefficients_only=True):
                residual = residual - fit.jacobian[place[j]] * (neutral[j] - theta[j])
                theta[j] = neutral[j]
        order = np.array(sorted(active), dtype=int)
        columns = fit.jacobian[[place[int(j)] for j in order]]
        here = replace(
            fit,
            theta=super_model.switched(members, theta),
            residual=residual,
            active=order,
            jacobian=columns,
        )
        free = np.full(theta.size, np.inf)
        step, starts = levenberg_step(here, 0.0, -free, free)
        residual = residual - np.tensordot(step, columns, 1)
        residual = residual - np.einsum("xs,xots->ots", starts, fit.by_start)
        here.theta[order] += step
        here = replace(here, x0=fit.x0 + starts, residual=residual, cost=squares(residual))
        errors = held_back(arena.pieces, arena.problem.segments, here)
        known = {"converters": self.centre.converters, "starts": self.centre.starts}
        found = Entry(tuple(sorted(members)), here, errors, **known)
        if not np.isfinite(errors).all() or not new <= set(sound_members(arena, found)):
            return None
        # hundreds are kept: without the derivatives, which nothing asks for any more
        nothing = np.zeros((0, *residual.shape))
        return replace(found, fit=replace(here, jacobian=nothing, by_start=nothing))


def _with(members: tuple[int, ...], number: int) -> tuple[int, ...]:
    return tuple(sorted((*members, number)))
