"""The search for what the recordings are evidence of: propose, estimate, compare."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.likelihood.abreast import abreast, many, rivals_of_many, room
from jaxsr.diagnosis.likelihood.additions import (
    MEMORIES,
    PROMISING,
    TRIED,
    additions,
    promises,
    turns,
)
from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis, hypothesis
from jaxsr.diagnosis.likelihood.limits import censored
from jaxsr.diagnosis.likelihood.proposals import (
    forms,
    kin,
    labels,
    pairs,
    plain_of_kin,
    shifts,
    swaps,
)
from jaxsr.diagnosis.likelihood.state import Members, State, believable
from jaxsr.diagnosis.likelihood.table import Table, tabled
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.candidate import UNNAMED

SWAPPED, RIVAL, PAIRED = 3, 12.0, 2
"""Sets with one member exchanged that are estimated about one leader, how far behind it they may
promise to be, and sets with a pair that shows only together."""
MOST_MEMBERS = 4
"""Of a leader of a model of up to three equations of motion, to which nothing is added."""
RENEWED = 1.0
"""Log evidence by which a set must have gained for its rivals to be estimated again; two estimates
of a set that are closer are alike."""
FOLLOWED = 6
"""Times that an estimate that would lead is begun anew where it stopped."""


def begun(work: Workspace, near: Hypothesis | None = None) -> State:
    """Estimate re-calibration alone, from where it led before."""
    table = first_table(work, near)
    null = hypothesis(work, table, (), near)
    if null is not None and null.share:
        null = _without_force_if_likelier(work, table, null)
    return State(work, table, {(): null})


def first_table(work: Workspace, near: Hypothesis | None) -> Table:
    """Return the table about re-calibration, from where it led before."""
    theta = work.theta.copy()
    if near is None:
        return tabled(work, theta, work.narrow.segments.course)
    base = work.super_model.base_index()
    theta[base] = near.theta[base]
    return tabled(work, theta, near.path, near.noise, near.decay)


def search(
    work: Workspace,
    near: Hypothesis | None = None,
    tell: Callable[[State], None] | None = None,
    most: int = MOST_MEMBERS + 1,
) -> State:
    """Grow the leading set until nothing that was offered adds to it, or time is over.

    Where the largest set that is weighed leads, and its rivals do not, it ends: what more is
    missing stays a force. Before that mechanisms with states of their own that were not asked are:
    at the first values of their inner constants they promise less than they keep, and a leader that
    leaves a force imitates what accounts for it.

    Parameters
    ----------
    near : Hypothesis, optional
        Re-calibration as it was estimated before.
    tell : callable, optional
        Hears what is known before each step.
    most : int
        Members of a leader to which nothing is added yet, of up to three equations (`room`).
    """
    state = begun(work, near)
    return state if state.known[()] is None else grown(state, tell, most)


def weighed(state: State, members: Members, near: Hypothesis) -> State:
    """Estimate a set from where another stands."""
    known, due = _estimated(state, near, [members])
    return replace(state, known=known, due=(*state.due, *due))


def lawful(state: State) -> bool:
    """Whether the leader has a law without a name."""
    every = state.work.super_model.candidates
    return any(every[i].mechanism == UNNAMED for i in state.leader.members)


def inexact(state: State) -> bool:
    """Whether the leader has a law without a name and leaves a force: that may be its own error,
    and says nothing for what would be added.
    """
    return lawful(state) and forced(state)


def grown(
    state: State, tell: Callable[[State], None] | None = None, most: int = MOST_MEMBERS + 1
) -> State:
    """Grow the leading set until nothing that was offered adds to it, or time is over.

    Parameters
    ----------
    most : int
        Members of a leader to which nothing is added yet.
    """
    null = state.known[()]
    assert null is not None  # there is no search without re-calibration
    while not state.work.stop() and len(state.leader.members) < room(state.work, most):
        if state.leader.members not in state.grown:
            if tell is not None:
                tell(state)
            state = step(state)
            continue
        left = memories_left(state)
        if not left or not forced(state):
            break
        known, due = _estimated(state, null, left)
        state = replace(state, known=known, due=(*state.due, *due))
    return state


def grown_apart(state: State, leading: Members, most: int = MOST_MEMBERS + 1) -> State:
    """Grow the best set that has no member of a leading one as well.

    A rich law that imitates two others leads before they are asked about together: each alone
    leaves a force, and nothing is added to what does not lead.

    Parameters
    ----------
    leading : tuple of int
        Of which no subset nor what else shares a member is estimated again.
    most : int
        Members of a leader to which nothing is added yet.
    """
    apart = {m: None if {*m} & {*leading} else h for m, h in state.known.items()}
    found = grown(replace(state, known=apart, grown=frozenset(), rivalled={}, due=()), None, most)
    known = {m: better(state.known.get(m), h) for m, h in found.known.items()}
    return replace(found, known=known, grown=state.grown | found.grown)


def memories_left(state: State) -> list[Members]:
    """Return the next mechanisms with states of their own that were asked beside nothing.

    Of each one the start that promises most beside re-calibration.
    """
    null, candidates = state.known[()], state.work.super_model.candidates
    if null is None:
        return []
    asked = {candidates[members[0]].label for members in state.known if len(members) == 1}
    ranked = turns(*promises(state, state.table, null))
    best: dict[str, int] = {}
    for i in (i for i in ranked if candidates[i].states):
        best.setdefault(candidates[i].label, i)
    return [(i,) for label, i in best.items() if label not in asked][:MEMORIES]


def forced(state: State) -> bool:
    """Whether the leader leaves a force: what accounts for it was not found."""
    leader = state.leader
    return leader.share > 0.0 and odds_of_force(state, leader) > PROMISING


def step(state: State) -> State:
    """Estimate what promises most about the leader's path, beside the leader's noise."""
    work, leader = state.work, state.leader
    here = state.table
    if leader.members:
        here = about(work, leader)
    every, size = work.super_model, np.log(state.offered)
    most = room(work, MOST_MEMBERS)
    several = abreast(every, here, leader.members, PROMISING + size)
    several = [s for s in several if len(s) <= most and not inexact(state)]
    if several:
        known, due = _estimated(state, leader, several)
        state = replace(state, known=known, due=due)
        if work.stop() or state.leader.members != leader.members:
            return state
    if leader.log_evidence > state.rivalled.get(leader.members, -np.inf) + RENEWED:
        rivals = _rivals(state, here, leader.members)
        # A rival that is known was estimated beside another noise: the same is due to it.
        known, due = _estimated(state, leader, rivals, again=True)
        if work.stop():  # the rest was not looked at
            return replace(state, known=known, due=due)
        rivalled = {**state.rivalled, leader.members: leader.log_evidence}
        state = replace(state, known=known, rivalled=rivalled, due=())
        if state.leader.members != leader.members:
            return state  # nothing is added to what is not the best of its kind
    if len(leader.members) >= most or inexact(state):
        return replace(state, grown=state.grown | {leader.members})
    plain, others = additions(state, here, leader)
    proposed = [(*leader.members, i) for i in (*plain[:TRIED], *others)]
    proposed += pairs(every, here, leader.members, PAIRED, PROMISING + size)
    forced = np.inf
    while proposed:
        proposed = [p for p in proposed if len(p) <= most]
        state = _added(state, leader, proposed)
        if work.stop() or _completes(work, leader, state.leader):
            return state  # the rest was not looked at
        if leader.share == 0.0 or state.leader.share < leader.share:
            break
        if forced == np.inf:
            forced = odds_of_force(state, leader)
        if forced < PROMISING:
            break
        # None accounts for any of the force that is missing: others are asked as well.
        plain = plain[TRIED:]
        proposed = [(*leader.members, i) for i in plain[:TRIED]]
    return replace(state, grown=state.grown | {leader.members})


def _rivals(state: State, here: Table, members: Members) -> list[Members]:
    """Return what is estimated beside a leader: it less a member, and with one exchanged."""
    every = state.work.super_model
    if many(len(state.work.force_states), members):
        return rivals_of_many(every, here, members, np.log(state.offered), RIVAL)
    rivals = [tuple(m for m in members if m != i) for i in members]
    rivals += swaps(every, here, members, SWAPPED, RIVAL)
    alike = [other for of in (kin, forms, shifts) for other in of(every, members)]
    return rivals + [r for r in alike if r not in rivals]


def _added(state: State, leader: Hypothesis, proposed: Sequence[Members]) -> State:
    """Estimate additions to a set, of laws that jump those that are inside others first.

    About the path of one that leads its kin take a fraction of the time: they are asked there, as
    its rivals, and are due until then.
    """
    every = state.work.super_model
    plain, kindred = plain_of_kin(every, proposed)
    known, due = _estimated(state, leader, plain)
    state = replace(state, known=known, due=due)
    rivals: set[tuple[str, ...]] = set()
    if state.leader.members != leader.members:
        rivals = {labels(every, m) for m in kin(every, state.leader.members)}
    later = tuple(m for m in kindred if labels(every, m) in rivals)
    rest = [m for m in kindred if m not in later]
    if not _completes(state.work, leader, state.leader):
        known, more = _estimated(state, leader, rest)
        state = replace(state, known=known, due=(*due, *more))
    return replace(state, due=(*state.due, *later))


def _estimated(
    state: State,
    leader: Hypothesis,
    proposed: Sequence[Members],
    again: bool = False,
) -> tuple[dict[Members, Hypothesis | None], tuple[Members, ...]]:
    """Return what is known once proposals about a leader are estimated, or estimated `again`.

    Those for which there was no time are returned as well. Additions end with one that leads and
    leaves nothing, where the leader left something: what may stand in its place is told about its
    own path.
    """
    known, due = dict(state.known), []
    for members in proposed:
        members = tuple(sorted(members))
        before = known.get(members)
        if members in known and (before is None or not again):
            continue
        if state.work.stop():
            due.append(members)
            continue
        needed = state.needed(known, members)
        found = hypothesis(state.work, state.table, members, leader, needed)
        found = _followed(state.work, state.table, members, found, needed)
        known[members] = better(before, found)
        if not again and found is not None and found.log_evidence > needed:
            if _completes(state.work, leader, found):
                break
    return known, tuple(due)


def _followed(
    work: Workspace, table: Table, members: Members, found: Hypothesis | None, needed: float
) -> Hypothesis | None:
    """Follow what would lead until it rests: where it stopped, its evidence was a promise.

    An estimate rests as well where, begun anew from where it stopped, it ends with the same
    evidence: beside a corner of friction no step becomes a small one. What it had on its way, and
    has not where its own steps lead, is no evidence of it.
    """
    for _ in range(FOLLOWED):
        if found is None or found.settled or found.log_evidence <= needed or work.stop():
            break
        further = hypothesis(work, table, members, found, needed)
        if further is None:
            break
        alike = abs(further.log_evidence - found.log_evidence) < RENEWED
        found = replace(further, settled=further.settled or alike)
    return found


def _completes(work: Workspace, leader: Hypothesis, found: Hypothesis) -> bool:
    """Whether a set leaves nothing where the one that led before left something.

    Beside re-calibration everything that promises is asked: the first to leave nothing is often the
    richest of several.
    """
    if not leader.members or leader.share == 0.0 or found.share > 0.0 or not found.settled:
        return False
    return believable(work, found)


def _without_force_if_likelier(work: Workspace, table: Table, found: Hypothesis) -> Hypothesis:
    """Return a set with its force, or without any as soon as that is likelier, at rest.

    Noise that keeps its sign and a force that does are two modes: an estimate ends in the one that
    it began in, and the noise of the other takes more than one look.
    """
    best, alone = found, _without_force(work, table, found)
    while alone is not None and alone.log_evidence > best.log_evidence + RENEWED:
        best, alone = alone, _without_force(work, table, alone)
    return best


def about(work: Workspace, found: Hypothesis) -> Table:
    """Return the table of additions about an estimate's path, with its jumps as round as there."""
    known = found.noise, found.decay, found.width, found.steps
    work = censored(work, found.members, found.theta, found.path)
    return tabled(work, found.theta, found.path, *known)


def odds_of_force(state: State, found: Hypothesis) -> float:
    """Return the log odds of the latent force beside a set, against the set without any."""
    alone = _without_force(state.work, state.table, found)
    return np.inf if alone is None else found.log_evidence - alone.log_evidence


def _without_force(work: Workspace, table: Table, found: Hypothesis) -> Hypothesis | None:
    """Estimate a set without a latent force, from where it stands with one, while there is hope."""
    calm = replace(table, scales=replace(table.scales, shares=np.zeros(1)))
    return hypothesis(work, calm, found.members, found, found.log_evidence)


def better(before: Hypothesis | None, after: Hypothesis | None) -> Hypothesis | None:
    """Return the estimate of a set that has more evidence; of two alike, one that came to rest."""
    both = [h for h in (before, after) if h is not None]
    most = max((h.log_evidence for h in both), default=0.0)
    alike = [h for h in both if h.log_evidence > most - RENEWED]
    return max(alike, key=lambda h: (h.settled, h.log_evidence), default=None)
