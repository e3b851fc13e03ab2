"""Probabilities of mechanisms, from the evidences of sets of them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import expit

from jaxsr.diagnosis.likelihood.abreast import laws, many
from jaxsr.diagnosis.likelihood.course import Course, followed
from jaxsr.diagnosis.likelihood.evidence import Mode, modes
from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis, hypothesis
from jaxsr.diagnosis.likelihood.later import MANY, Write, with_laws
from jaxsr.diagnosis.likelihood.loop import MOST_MEMBERS, grown_apart, odds_of_force, search
from jaxsr.diagnosis.likelihood.offered import offered
from jaxsr.diagnosis.likelihood.state import Members, State
from jaxsr.diagnosis.likelihood.table import Table, tabled
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.candidate import UNNAMED, Candidate
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import Seen
from jaxsr.models import Model
from jaxsr.models.segments import Prepared

CERTAIN = 1e-6
"""Deviation of a value held as given, in that of its belief."""
ODDS = 3.0
"""Log odds against a wrong value: twenty to one for a model that is right."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """Hypotheses with their probabilities, the most probable first.

    Attributes
    ----------
    candidates : tuple of Candidate
        What the members of hypotheses count.
    hypotheses : tuple of Hypothesis
    logs : ndarray, shape (hypotheses,)
        Logs of evidence times prior odds.
    wrong : tuple of WrongValue
        Where nothing is missing.
    timely : bool
        Whether the search came to an end of its own.
    asked : frozenset of str
        Labels of mechanisms that the recordings were asked about.
    something_else : float
        Probability of a force that no member of the leading set is, against that of none.
    prepared, rows
        Recordings and pieces of them that paths lie along.
    further : callable
        Returns what another search finds, from the best set that has none of some members; None
        where no other set leads then.
    """

    candidates: tuple[Candidate, ...]
    hypotheses: tuple[Hypothesis, ...]
    logs: np.ndarray
    wrong: tuple[WrongValue, ...] = ()
    timely: bool = True
    asked: frozenset[str] = frozenset()
    something_else: float = 0.0
    prepared: tuple[Prepared, ...] = ()
    rows: tuple[tuple[int, int, int], ...] = ()
    further: Callable[[Members], Posterior | None] = lambda _: None

    @staticmethod
    def of(state: State) -> Posterior:
        """Weigh everything that was estimated."""
        found = [h for h in state.known.values() if h is not None]
        found.sort(key=state.log_posterior, reverse=True)
        logs = np.array([state.log_posterior(h) for h in found])
        timely = found[0].members in state.grown
        return Posterior(
            state.work.super_model.candidates,
            tuple(found),
            logs,
            timely=timely,
            asked=_asked(state),
            prepared=state.work.prepared,
            rows=state.work.rows,
        )

    @property
    def leader(self) -> Hypothesis:
        """The most probable hypothesis."""
        return self.hypotheses[0]

    @property
    def probabilities(self) -> np.ndarray:
        """Those of the hypotheses, over what was estimated, shape (hypotheses,)."""
        weights = np.exp(self.logs - self.logs.max(initial=-np.inf))
        return weights / max(weights.sum(), 1e-300)

    @property
    def nameless(self) -> list[int]:
        """Members of the leader that are laws without a name."""
        members = self.leader.members
        return [i for i in members if self.candidates[i].mechanism == UNNAMED]

    def without(self, numbers: Collection[int]) -> Posterior:
        """Return what is left where members of the leader are set aside.

        What they were found for acts all the same: a force that is left beside others is one.
        """
        kept = [k for k, h in enumerate(self.hypotheses) if not {*h.members} & {*numbers}]
        hypotheses = tuple(self.hypotheses[k] for k in kept)
        left = float(hypotheses[0].share > 0.0)
        return replace(self, hypotheses=hypotheses, logs=self.logs[kept], something_else=left)

    def of_labels(self) -> dict[str, float]:
        """Mechanism and site to the probability that it is part of the truth."""
        mass: dict[str, float] = {}
        for found, probability in zip(self.hypotheses, self.probabilities, strict=True):
            for label in {self.candidates[i].label for i in found.members}:
                mass[label] = mass.get(label, 0.0) + float(probability)
        return dict(sorted(mass.items(), key=lambda item: -item[1]))


@dataclass(frozen=True, eq=False)
class WrongValue:
    """A parameter of the given model that is not what the file says.

    Attributes
    ----------
    probability : float
        That it is not: of freeing it against holding it, those freed before it free.
    """

    name: str
    value: float
    deviation: float
    probability: float


def wrong_values(work: Workspace, null: Hypothesis) -> tuple[WrongValue, ...]:
    """Return the free parameters that the recordings ask to move, the others held as given.

    One after the other is freed, as long as the evidence gains more than the prior odds of one
    parameter among all; a parameter held as given is one that is known for certain. Those that are
    free are estimated at their mode before the next is asked for: what a wrong value does is not
    linear in it, and another one would make up for that.

    Parameters
    ----------
    work : Workspace
        Of no candidates but a push along each equation.
    null : Hypothesis
        Re-calibration alone.
    """
    # About the given values: along what no sensor tells, re-calibration may have gone anywhere.
    table = tabled(work, work.theta, null.path, null.noise, null.decay)
    base, given = list(table.base), work.super_model.given.free_parameters
    free: dict[int, float] = {}
    found: dict[str, tuple[float, float]] = {}
    here = table
    while len(free) < len(base):
        best = _weighed(here, free)
        tried = {k: _weighed(here, {*free, k}) for k in base if k not in free}
        k = max(tried, key=lambda k: tried[k].log_evidence)
        odds = tried[k].log_evidence - best.log_evidence - np.log(len(base)) - ODDS
        if odds <= 0.0:
            break
        free[k], change = float(expit(odds)), tried[k].change
        begun = work.theta.copy()
        begun[work.super_model.base_index()] = here.value[base] + change
        after = hypothesis(work, _held(table, free), (), replace(null, theta=begun))
        if after is None or not after.settled:
            spread = tried[k].deviation
            found = {given[k]: (here.value[k] + change[k], spread[k]) for k in free}
            break
        found = {given[k]: after.constants[given[k]] for k in free}
        here = tabled(work, after.theta, after.path, after.noise, after.decay)
    names = zip(free.values(), (given[k] for k in free), strict=True)
    return tuple(WrongValue(n, float(found[n][0]), float(found[n][1]), p) for p, n in names)


def _weighed(table: Table, free: Collection[int]) -> Mode:
    """Weigh the given model with some of its free parameters free and the others as given."""
    base = list(table.base)
    prior = _held(table, free).prior(base)
    return max(modes(table.grams, base, prior), key=lambda m: m.log_evidence)


def _held(table: Table, free: Collection[int]) -> Table:
    """Return a table in which all but some of the given model's parameters are known."""
    known, deviation = table.belief, table.belief.deviation.copy()
    deviation[[k for k in table.base if k not in free]] *= CERTAIN
    return replace(table, belief=replace(known, deviation=deviation))


def posterior(
    model: Model,
    prepared: Sequence[Prepared],
    seen: Seen | None = None,
    stop: Callable[[], bool] = lambda: False,
    tell: Callable[[State], None] | None = None,
    write: Write | None = None,
) -> Posterior | None:
    """Search by evidence; None where not even re-calibration can be followed.

    Parameters
    ----------
    model : Model
        The given one.
    seen : Seen, optional
        What smoothed signals show, where equations can be read off the sensors.
    stop : callable
        Whether time is over.
    tell : callable, optional
        Hears what is known before each step of the search.
    write : callable, optional
        Writes laws for what a search leaves, which are weighed beside the others.
    """
    course = followed(model, prepared, stop)
    return None if course is None else posterior_along(model, course, seen, stop, tell, write)


def posterior_along(
    model: Model,
    course: Course,
    seen: Seen | None = None,
    stop: Callable[[], bool] = lambda: False,
    tell: Callable[[State], None] | None = None,
    write: Write | None = None,
) -> Posterior | None:
    """Search by evidence from what re-calibration follows (`followed`)."""
    shown = () if seen is None else seen.candidates
    super_model = SuperModel.build(model, offered(model, course, shown))
    known = course.prepared, course.seconds, course.null.noise, stop, course.null.share
    work = Workspace.build(super_model, *known)
    most = MOST_MEMBERS + 1 if write is None else MANY
    state = search(work, course.null, tell, most)
    null = state.known[()]
    if null is None:
        return None
    if write is not None:
        state = with_laws(state, course, write, tell)

    def further(state: State, leading: Members) -> Posterior | None:
        other = grown_apart(state, leading, most)
        if other.leader.members == state.leader.members:
            return None
        return concluded(other if write is None else with_laws(other, course, write, tell))

    def concluded(state: State) -> Posterior:
        found = replace(Posterior.of(state), further=partial(further, state))
        if found.leader.share and found.timely:
            found = replace(found, something_else=float(expit(odds_of_force(state, found.leader))))
        if found.leader.members:
            return found
        pushes = [c for c in super_model.candidates if c.mechanism == "constant_force"]
        alone = Workspace.build(SuperModel.build(model, pushes), *known)
        return replace(found, wrong=wrong_values(alone, null))

    return concluded(state)


def _asked(state: State) -> frozenset[str]:
    """Return the labels of mechanisms that the recordings were asked about.

    Once the rivals of the leading set were estimated, each that was not `due` was: what promises
    nothing by its linearisation is not estimated. Before that, those that were estimated, and the
    laws among which several were chosen at once.
    """
    every, leader = state.work.super_model.candidates, state.leader.members

    def labels(members: Sequence[int]) -> frozenset[str]:
        return frozenset(every[i].label for i in members)

    if leader in state.rivalled or leader in state.grown:
        due = frozenset().union(*map(labels, state.due))
        return labels(range(len(every))) - (due - labels(leader))
    known = frozenset().union(*(labels(m) for m, h in state.known.items() if h is not None))
    large = many(len(state.work.force_states), leader)
    return known | labels(laws(state.work.super_model) if large else ())
