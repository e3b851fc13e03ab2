"""Laws without a name in the weak view: the evolution reads them off what the sensors show."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.contest.arena import Arena, neutral_values
from jaxsr.diagnosis.contest.enter import active_parameters
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.laws.naming import named
from jaxsr.diagnosis.laws.unnamed import FORCES, Law, as_candidate, estimable, law_of, sizes_of
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.screening.weak_system import WeakSystem, weak_system
from jaxsr.evolution import SearchConfig, propose
from jaxsr.evolution.propose import Proposal

SECONDS, SHARE = 12.0, 0.5
"""Longest search, and its share of the time left: what it finds is to be estimated as well."""
WORTH = 0.7
"""Residual sum of squares in the weak view, relative to that without, a proposal must reach."""
BESIDE = 0.1
"""Weight of the other equations, each relative to the size of what it leaves."""


def propose_unnamed(
    case: Case, arena: Arena, entry: Entry, rng: np.random.Generator
) -> tuple[Law, tuple[int, ...]] | None:
    """Search one law for the equation that keeps most, in the place of `entry`'s forces there.

    Where `entry` has forces at all, only their equations are asked. Returns the candidate with
    its coefficients, and the members of `entry` that stand elsewhere; None where no law of at
    most `unnamed.MAX_TERMS` terms removes enough.
    """
    every = arena.super_model.candidates
    at = {i: every[i].site.partition(":")[2] for i in entry.members}
    forces = [i for i in entry.members if every[i].family in (*FORCES, "external")]
    if case.screened is None or case.search.exhausted:
        return None
    system = _view(case, arena, _without(arena, entry, forces))
    names, states = case.simulator.model.states, np.unique(system.state)
    if not states.size:  # members bring states along without which no equation can be read off
        return None
    places = {at[i] for i in forces} & {names[i] for i in states}
    state = names[_worst_state(system, [i for i in states if not places or names[i] in places])]
    rest = tuple(i for i in entry.members if i not in forces or at[i] != state)
    proposal = propose_instead(case, arena, entry, state, rest, rng)
    return None if proposal is None else (proposal, rest)


def propose_instead(
    case: Case,
    arena: Arena,
    chosen: Entry,
    state: str,
    rest: tuple[int, ...],
    rng: np.random.Generator,
) -> Law | None:
    """Search one law for an equation in the place of all that was chosen there beside `rest`.

    The shortest description of the data among the proposals, by its name where it has one; None
    where none removes enough.
    """
    if case.screened is None or case.search.exhausted:
        return None
    system = _view(case, arena, _without(arena, chosen, set(chosen.members) - set(rest)))
    index = case.simulator.model.states.index(state)
    if not (system.state == index).any():
        return None
    good = _search(case, arena, system, rest, index, rng)
    if not good:
        return None
    site = next(s for s in sites_of(case.simulator.model, {}) if s.state == state)
    law = law_of(good[0], sizes_of(case.simulator.model, case.prepared))
    return named(site, law, _signals(case)) or (
        as_candidate(case.simulator.model, case.prepared, index, good[0]),
    )


def _signals(case: Case) -> dict[str, np.ndarray]:
    """Return the states as the sensors show them, and time."""
    model = case.simulator.model
    states = np.concatenate([item.states.values for item in case.prepared])
    time = np.concatenate([item.time for item in case.prepared])
    return {**dict(zip(model.states, states.T, strict=True)), model.time: time}


def _without(arena: Arena, entry: Entry, members: Iterable[int]) -> np.ndarray:
    """Parameters of an entry, its `members` put to nothing."""
    theta, neutral = entry.fit.theta.copy(), neutral_values(arena.super_model)
    for number in members:
        own = arena.super_model.index(number)
        theta[own] = neutral[own]
    return theta


def _view(case: Case, arena: Arena, theta: np.ndarray) -> WeakSystem:
    assert case.screened is not None
    return weak_system(arena.problem.simulator, case.screened.grid, theta)


def _search(
    case: Case,
    arena: Arena,
    system: WeakSystem,
    members: tuple[int, ...],
    state: int,
    rng: np.random.Generator,
) -> list[Proposal]:
    """Return the proposals of few terms that remove enough, the shortest description first.

    States enter in units of their size: constants and exponents are searched near one. The other
    equations stand beside with little weight: alone, one without an input would hold for any
    forces and inertias that vanish together.
    """
    assert case.screened is not None
    seconds = min(SECONDS, SHARE * case.search.remaining)
    if not seconds > 0.0:
        return []
    rows, sizes = system.state == state, sizes_of(case.simulator.model, case.prepared)
    weight = np.zeros(rows.size)
    for index in np.unique(system.state):
        own = system.state == index
        rms = float(np.sqrt(np.mean(system.residual[own] ** 2))) + 1e-300
        weight[own] = (1.0 if index == state else BESIDE) / rms
    grid = case.screened.grid

    def view(columns: np.ndarray) -> np.ndarray:
        full = np.zeros((rows.size, columns.shape[1]))
        full[rows] = weight[rows, None] * grid.integrate(columns)[system.row[rows]]
        return full

    # Inputs stay out: one that cancels the drive makes every equation hold trivially.
    variables = {
        name: np.concatenate([np.nan_to_num(item.states.values[:, i]) for item in case.prepared])
        / sizes[name]
        for i, name in enumerate(case.simulator.model.states)
    }
    active = active_parameters(arena.super_model, members)
    found = propose(
        rng,
        -weight * system.residual,
        variables,
        view=view,
        fixed=weight[:, None] * system.jacobian[:, active],
        config=SearchConfig(population=120, generations=25),
        budget=seconds,
    )
    return [p for p in found if estimable(p) and p.relative_loss < WORTH]


def _worst_state(system: WeakSystem, states: Iterable[int]) -> int:
    """Return which equation has the largest residual relative to what its terms bring."""
    share = {}
    terms = system.jacobian * system.theta
    for state in states:
        rows = system.state == state
        brought = np.sum(terms[rows] ** 2) + np.sum(system.input_side[rows] ** 2)
        share[int(state)] = float(np.sum(system.residual[rows] ** 2) / max(brought, 1e-300))
    return max(share, key=lambda s: share[s])
