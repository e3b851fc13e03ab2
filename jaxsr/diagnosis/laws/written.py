"""Laws without a name for what a search by evidence leaves, written by the evolution.

Several forces at one equation may imitate one that has no name, and so may a force that is left.
What acts there, all together, is read off the path that the evidence follows; the evolution writes
laws for it. Each is a candidate as others are: its evidence is weighed, and its price is the number
of laws that take as many bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain, combinations_with_replacement

import numpy as np

from jaxsr.diagnosis.laws.place import Place
from jaxsr.diagnosis.laws.selection import CLEARLY, laws_of
from jaxsr.diagnosis.laws.unnamed import CUBIC, FORCES, MAX_TERMS, UNNAMED, sizes_of
from jaxsr.diagnosis.likelihood.course import Course, left_over, whole
from jaxsr.diagnosis.likelihood.estimate import Belief
from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis
from jaxsr.diagnosis.likelihood.later import Written
from jaxsr.diagnosis.likelihood.loop import about, forced
from jaxsr.diagnosis.likelihood.state import Members, State
from jaxsr.diagnosis.likelihood.table import Table
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.setup import state_scale
from jaxsr.evolution import SearchConfig, propose
from jaxsr.evolution.config import SizeLimits
from jaxsr.evolution.propose import Proposal
from jaxsr.expressions import evaluate, parse

SEVERAL = 2
"""Forces of a leader at one equation from which one law may stand for them."""
SHARE = 0.25
"""Largest share of the time left that the search at one equation may take."""
CONFIG = SearchConfig(population=120, sizes=SizeLimits(terms=MAX_TERMS))
"""Of the search for a law, which ends by itself where time allows; the population is that of the
search in free run."""


@dataclass(eq=False)
class Writer:
    """Writes laws for what a search by evidence leaves.

    Attributes
    ----------
    rng : numpy.random.Generator
    remaining : callable
        Seconds that are left.
    """

    rng: np.random.Generator
    remaining: Callable[[], float]

    def __call__(self, state: State, course: Course) -> list[Written]:
        """Return laws, and what of the leader stays beside each."""
        found: list[Written] = []
        for place in places(state, course):
            proposed = self._proposed(state.work, course, place)
            found += [
                Written(*law, place.rest, place.base)
                for law in laws_of(state.work, course, place, proposed)
            ]
        return found

    def _proposed(self, work: Workspace, course: Course, place: Place) -> list[Proposal]:
        """Let the evolution explain what acts at a place, re-calibration moving along."""
        model, found = work.super_model.given, list[Proposal]()
        sizes = sizes_of(model, work.prepared)
        none, open_place = np.zeros(len(place.base)), place

        def view(columns: np.ndarray) -> np.ndarray:
            rows = course.motion.integrate(columns)
            return np.concatenate([rows, np.zeros((len(none), rows.shape[1]))])

        while open_place is not None:
            place, seconds = open_place, SHARE * self.remaining()
            if not seconds > 0.0:
                break
            found = propose(
                self.rng,
                np.concatenate([place.force, none]),
                {n: place.signals[n] / sizes[n] for n in (*model.states, *model.inputs)},
                view=view,
                fixed=np.concatenate([place.reach, place.believed]),
                config=CONFIG,
                budget=seconds,
                near=1.0 / CLEARLY,
            )
            best = min(found, key=lambda p: p.loss, default=None)
            open_place = None if best is None else place.held(best.fixed)
        return found


def places(state: State, course: Course) -> list[Place]:
    """Return the equations at which the leader has several forces, or leaves the largest one.

    Where it leaves one, those at which it has any: forces at two equations may imitate a law at
    either. What the leader has elsewhere stays beside a law there, and does not: it may imitate
    the law as well. Beside members with states of their own no path tells what acts, so that these
    do not stay. Where it has but one force, some law must leave clearly less than that does.
    """
    work, leader, null = state.work, state.leader, state.known[()]
    own, every = _forces(work, leader), work.super_model.candidates
    several = [s for s, members in own.items() if len(members) >= SEVERAL]
    left = forced(state)
    if null is None or not (several or left):
        return []
    alone = _Acting.of(work, course, null, state.table)
    if any(every[i].states for i in leader.members):
        return [alone.at(s, ()) for s in several or [alone.largest(state.table)]]
    table = about(work, leader)
    acting = _Acting.of(work, course, leader, table)
    asked = [*several, acting.largest(table), *own] if left else several
    found = list[Place]()
    for name in dict.fromkeys(asked):
        place = acting.at(name, tuple(own.get(name, ())))
        known = place.beside(place.left)
        instead = [alone.at(name, ())] if place.rest else []
        for p in (place, *instead):
            if name in several or _least(p, course) < CLEARLY * known:
                found.append(p)
    return found


def _least(place: Place, course: Course) -> float:
    """Return the mean square that cubic laws of states and inputs leave of what acts at a place.

    Of many, squares or these alone: as many columns as a quarter of the rows.
    """
    model = place.site.model
    known = [place.signals[name] for name in (*model.states, *model.inputs)]
    known = [x / (np.max(np.abs(x)) + 1e-300) for x in known]
    for degree in (CUBIC, 2, 1):
        count = math.comb(len(known) + degree, degree)
        if count <= len(place.force) // 4:
            sets = chain.from_iterable(
                combinations_with_replacement(known, d) for d in range(degree + 1)
            )
            columns = np.stack([np.prod([1.0 + 0.0 * known[0], *s], axis=0) for s in sets], -1)
            return place.beside(place.force, course.motion.integrate(columns))
    return 0.0


def _forces(work: Workspace, found: Hypothesis) -> dict[str, list[int]]:
    """Return the members of a set that are forces along one equation, by its state."""
    every, at = work.super_model.candidates, dict[str, list[int]]()
    for i in found.members:
        if _acts(work, i):
            at.setdefault(every[i].terms[0][0], []).append(i)
    return at


@dataclass(frozen=True, eq=False)
class _Acting:
    """What acts along the path of a set beside the given model.

    Attributes
    ----------
    forces : ndarray, shape (forces, samples, pieces)
        What the set leaves, smoothed.
    columns : ndarray, shape (forces, free parameters, samples, pieces)
        What re-calibration does, as forces.
    signals : dict of str to ndarray, shape (samples,)
    belief : Belief
        Of the free parameters.
    """

    work: Workspace
    course: Course
    found: Hypothesis
    forces: np.ndarray
    columns: np.ndarray
    signals: dict[str, np.ndarray]
    belief: Belief

    @staticmethod
    def of(work: Workspace, course: Course, found: Hypothesis, table: Table) -> _Acting:
        """Read it off the table about the set."""
        model = work.super_model.given
        paths = [whole(work, work.prepared, values) for values in found.path]
        signals = {**course.motion.signals, **dict(zip(model.states, paths, strict=True))}
        return _Acting(work, course, found, *left_over(work, found, table), signals, table.belief)

    @property
    def states(self) -> list[str]:
        """The states along whose equations forces act."""
        return [self.work.super_model.given.states[s] for s in self.work.force_states]

    def largest(self, table: Table) -> str:
        """Return the state along whose equation most is left, in its net force."""
        rms = np.sqrt(np.mean(self.forces**2, axis=(1, 2)))
        return self.states[int(np.argmax(rms / np.maximum(table.scales.size, 1e-300)))]

    def at(self, state: str, own: Members) -> Place:
        """Return an equation, with what is left along it and the forces of its `own` members."""
        work, k = self.work, self.states.index(state)
        left = whole(work, work.prepared, self.forces[k])
        acting = left + sum(_force(work, self.found, i, self.signals) for i in own)
        reach = [whole(work, work.prepared, c) for c in self.columns[k]]
        seen = self.course.motion.integrate(np.stack([acting, left, *reach], -1))
        rest = tuple(i for i in self.found.members if i not in own)
        model = work.super_model.given
        site = next(
            s for s in sites_of(model, state_scale(model, work.prepared)) if s.state == state
        )
        base = self.found.theta[work.super_model.base_index()]
        told = seen[:, 0], seen[:, 1], seen[:, 2:]
        belief = (
            x[: len(base)] for x in (self.belief.deviation, self.belief.low, self.belief.high)
        )
        return Place(site, rest, *told, self.signals, base, *belief)


def _acts(work: Workspace, number: int) -> bool:
    """Whether a candidate is a force along one equation that states and inputs tell."""
    candidate, names = work.super_model.candidates[number], work.super_model.names[number]
    force = candidate.family in (*FORCES, UNNAMED) or candidate.passing
    apart = candidate.replaced or candidate.states or len(candidate.terms) != 1
    if apart or not force:
        return False
    model, term = work.super_model.given, parse(candidate.terms[0][1].format(**names))
    return term.variables <= {*names.values(), *model.states, *model.inputs, model.time, "t"}


def _force(
    work: Workspace, found: Hypothesis, number: int, signals: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Return the force of a member, shape (samples,)."""
    ((_, text),) = work.super_model.candidates[number].terms
    values = {full: found.constants[full][0] for full in found.names[number].values()}
    with np.errstate(all="ignore"):
        force = evaluate(parse(text.format(**found.names[number])), {**signals, **values})
    size = next(iter(signals.values())).size
    return np.nan_to_num(np.broadcast_to(np.asarray(force, dtype=float), (size,)))


__all__ = ["Writer"]
