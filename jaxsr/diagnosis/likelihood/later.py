"""Laws that come to a search later: written for what it leaves, and weighed as all others are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.likelihood.course import Course
from jaxsr.diagnosis.likelihood.loop import better, first_table, grown, inexact, lawful, weighed
from jaxsr.diagnosis.likelihood.state import Members, State
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.super_model import SuperModel

MANY = 3
"""Members of a leader from which laws are written before more are added: few plants lack as many
effects, and a law that has no name asks for as many as may be."""


@dataclass(frozen=True, eq=False)
class Written:
    """A law that was written.

    Attributes
    ----------
    law : Candidate
    values : ndarray, shape (its constants,)
        That it was written with.
    rest : tuple of int
        Candidates of the search that stay beside it.
    base : ndarray, shape (free parameters,)
        Those of the given model beside which it was written.
    """

    law: Candidate
    values: np.ndarray
    rest: Members
    base: np.ndarray


Write = Callable[[State, Course], Sequence[Written]]
"""Writes laws for what a search leaves."""


def with_laws(
    state: State,
    course: Course,
    write: Write,
    tell: Callable[[State], None] | None = None,
) -> State:
    """Weigh laws that are written beside the members that stay with each, and grow what leads.

    Once more as long as a law leads about whose path none were written: what is left there is
    smaller. Where none is new larger sets are asked, and where a law leads that leaves a force,
    those of named mechanisms too.

    Parameters
    ----------
    state : State
        At the end of a search along `course`, for a leader of fewer than `MANY` members.
    tell : callable, optional
        Hears what is known before each step.
    """
    named, written, asked = state, list[Written](), set[Members]()

    def due(state: State) -> bool:
        new = state.leader.members not in asked and not state.work.stop()
        return new and (not asked or lawful(state))

    while due(state):
        asked.add(state.leader.members)
        if laws := write(state, course):
            written += laws
            state = grown(_asked(state, course, laws), tell, MANY)
        if due(state):
            continue
        if inexact(state):
            # Named sets are not yet as large as they may be: what was to come may leave less.
            named = grown(named, tell)
            rivals = _widened(named, course, written).known
            known = {m: better(state.known.get(m), h) for m, h in rivals.items()}
            state = replace(state, known={**state.known, **known})
        state = grown(state, tell)
    return state


def _asked(state: State, course: Course, laws: Sequence[Written]) -> State:
    """Estimate every law beside what stays with it."""
    first = len(state.work.super_model.candidates)
    state = _widened(state, course, laws)
    for number, law in enumerate(laws, first):
        begun = state.leader.theta.copy()
        begun[state.work.super_model.base_index()] = law.base
        near = replace(state.leader, theta=begun)
        state = weighed(state, (*law.rest, number), near)
    return state


def _widened(state: State, course: Course, laws: Sequence[Written]) -> State:
    """Return what is known, with laws as further candidates at the values they were written with.

    Numbers and names of the candidates before stay.
    """
    before = state.work.super_model
    every = SuperModel.build(before.given, [*before.candidates, *(w.law for w in laws)])
    null = course.null
    args = course.prepared, course.seconds, null.noise, state.work.stop, null.share
    work, first = Workspace.build(every, *args), len(state.work.theta)
    theta = work.theta.copy()
    for number, written in enumerate(laws, len(before.candidates)):
        theta[every.index(number)] = written.values
    known = {
        members: None if h is None else replace(h, theta=np.append(h.theta, theta[first:]))
        for members, h in state.known.items()
    }
    return replace(state, work=work, table=first_table(work, course.null), known=known)
