"""Laws without a name in the tangent view: the evolution writes them through the simulator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.contest.arena import Arena
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.judging.criteria import independent_residuals
from jaxsr.diagnosis.laws.naming import named
from jaxsr.diagnosis.laws.tangent import TangentView, cost_left, states_between, surface
from jaxsr.diagnosis.laws.unnamed import (
    FORCES,
    MAX_TERMS,
    UNNAMED,
    Law,
    as_candidate,
    estimable,
    has_a_name,
    law_of,
    length_of,
    sizes_of,
)
from jaxsr.diagnosis.locating.responses import Responses
from jaxsr.diagnosis.mechanisms.site import Site, sites_of
from jaxsr.diagnosis.setup import state_scale
from jaxsr.evolution import SearchConfig, propose
from jaxsr.evolution.config import SizeLimits
from jaxsr.evolution.propose import Proposal
from jaxsr.expressions import evaluate, parse

SECONDS, SHARE = 4.0, 0.25
"""Longest search at one equation, and its share of the time left."""
DEGREES = (7, 3)
"""Degrees in position and rate of the surface that tells where a law may be missing."""
JUMP = 2.0
"""Cost, relative to that of a law that jumps, from which no smooth one goes before it: a jump asks
for other steps of integration, and for all sets anew."""
NEARLY = (0.95, 0.99)
"""Shares of what the best law explains that the simplest laws must explain."""


@dataclass(frozen=True, eq=False)
class Place:
    """An equation at which a law may be missing.

    Attributes
    ----------
    responses : Responses
        To forces along every equation, about the free run of an entry.
    number : int
        Of the equation among those.
    kept : ndarray of bool, shape (active,)
        Parameters that move along.
    acting : ndarray, shape (samples,)
        The forces that the law is to replace.
    entry : Entry
    rest : tuple of int
        Members of the entry that stay beside the law.
    cost : float
        Left by a surface over the position and the rate of the equation, to first order.
    """

    responses: Responses
    number: int
    kept: np.ndarray
    acting: np.ndarray
    entry: Entry
    rest: tuple[int, ...]
    cost: float

    @property
    def site(self) -> Site:
        """The equation."""
        return self.responses.sites[self.number]

    @cached_property
    def view(self) -> TangentView:
        """What is left once the forces that the law is to replace are taken away.

        Dear, and asked for where a law is written only.
        """
        return TangentView.of(self.responses, self.number, self.kept).without(self.acting)


@lru_cache(maxsize=4)
def places(arena: Arena, entry: Entry) -> tuple[Place, ...]:
    """Return the equations of motion, first those at which any law would explain most.

    At each of them the law stands in the place of the entry's own forces there.
    """
    if entry.fit.path is None or not entry.fit.usable:
        return ()
    responses = Responses.of(arena, entry, sites_of(arena.super_model.given, {}))
    variables, found = states_between(responses), list[Place]()
    for number, site in enumerate(responses.sites):
        replaced = tuple(i for i in entry.members if _along(arena, i, site))
        own = [j for i in replaced for j in arena.super_model.index(i)]
        kept = ~np.isin(entry.fit.active, own)
        acting = np.zeros(next(iter(variables.values())).size)
        for i in replaced:
            acting += _force(arena, entry, i, variables)
        along = [variables[s] for s in (site.position, site.state) if s is not None]
        columns = surface(along, DEGREES[-len(along) :])
        cost = cost_left(responses, number, kept, columns, acting)
        rest = tuple(i for i in entry.members if i not in replaced)
        found.append(Place(responses, number, kept, acting, entry, rest, cost))
    return tuple(sorted(found, key=lambda p: p.cost))


def laws_at(case: Case, place: Place, rng: np.random.Generator) -> list[Law]:
    """Return laws of any states that explain what a place keeps, simple ones first.

    To first order about the entry. Where that is far from the noise, costs tell laws apart no
    better than the linearisation holds, and the simplest that explain nearly all go beside the
    shortest description. A law that is a sum of named forces goes by their names.
    """
    seconds = min(SECONDS, SHARE * case.search.remaining)
    if not seconds > 0.0:
        return []
    view, sizes = place.view, sizes_of(case.simulator.model, case.prepared)
    scaled = {name: values / sizes[name] for name, values in view.variables.items()}
    found = propose(
        rng,
        view.target,
        scaled,
        view=view,
        fixed=view.fixed,
        config=SearchConfig(population=120, sizes=SizeLimits(terms=MAX_TERMS)),
        budget=seconds,
    )
    nothing, n = view.cost(np.zeros((view.samples, 0))), independent_residuals(place.entry)
    laws = [(p, p.loss * view.target.size + view.beyond) for p in found if estimable(p)]
    nameless = [law for law in laws if not has_a_name(law[0])]
    state = case.simulator.model.states.index(place.site.state)
    site = replace(place.site, scale=state_scale(case.simulator.model, case.prepared))
    loss = view.loss(min((cost for _, cost in laws), default=nothing), n)
    forms: dict[int, Law] = {}

    def name(proposal: Proposal) -> Law:
        if id(proposal) not in forms:
            law = law_of(proposal, sizes)
            forms[id(proposal)] = named(site, law, view.variables, loss)
        return forms[id(proposal)]

    shortest = chosen_among(laws, nothing, n)
    mechanisms = {tuple(c.label for c, _ in name(p)): name(p) for p in shortest if name(p)}
    rest = [p for p in chosen_among(nameless, nothing, n) if not name(p)]
    return [
        *mechanisms.values(),
        *((as_candidate(case.simulator.model, case.prepared, state, p),) for p in rest),
    ]


def chosen_among(
    laws: Sequence[tuple[Proposal, float]], nothing: float, n: float
) -> list[Proposal]:
    """Return the simplest laws that explain nearly all that any does, and the shortest description.

    `laws` come with their costs, `nothing` is the cost without any, n the number of independent
    residuals. A description is n log(cost) plus twice the nats of the law long.
    """

    def length(law: tuple[Proposal, float]) -> float:
        return n * float(np.log(law[1])) + length_of(law[0], n)

    laws = [law for law in laws if length(law) < n * np.log(nothing)]
    if not laws:
        return []
    smooth = [law for law in laws if not _jumps(law[0])]
    least = min(cost for _, cost in laws)
    if smooth and min(cost for _, cost in smooth) < JUMP * least:
        laws, least = smooth, min(cost for _, cost in smooth)
    simple = [
        min(
            (law for law in laws if nothing - law[1] >= share * (nothing - least)),
            key=lambda law: law[0].size,
        )[0]
        for share in NEARLY
    ]
    short = min(laws, key=length)[0]
    return list({id(p): p for p in (*simple, short)}.values())


def _jumps(proposal: Proposal) -> bool:
    return any(t.op == "sign" for term in proposal.terms for t in term.walk())


def promise(arena: Arena, entry: Entry) -> float:
    """Return the least cost that a law at one equation promises, to first order about an entry."""
    return min((p.cost for p in places(arena, entry)), default=np.inf)


def _along(arena: Arena, number: int, site: Site) -> bool:
    """Whether a candidate is a force along one equation alone that the states tell."""
    candidate, names = arena.super_model.candidates[number], arena.super_model.names[number]
    if candidate.family not in (*FORCES, UNNAMED) or candidate.states or candidate.replaced:
        return False
    if [s for s, _ in candidate.terms] != [site.state]:
        return False
    term = parse(candidate.terms[0][1].format(**names))
    return term.variables <= {*names.values(), *arena.super_model.given.states}


def _force(arena: Arena, entry: Entry, number: int, variables: dict[str, np.ndarray]) -> np.ndarray:
    """Return the force of a member along the view's path."""
    super_model = arena.super_model
    ((_, text),) = super_model.candidates[number].terms
    order, names = list(super_model.model.parameters), super_model.names[number]
    values = {n: float(entry.fit.theta[order.index(n)]) for n in names.values()}
    size = next(iter(variables.values())).size
    force = evaluate(parse(text.format(**names)), {**values, **variables})
    return np.broadcast_to(np.asarray(force, dtype=float), (size,)).copy()


__all__ = ["Place", "laws_at", "places", "promise"]
