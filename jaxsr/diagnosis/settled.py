"""The decision by evidence.

The posterior (`diagnosis.likelihood`) weighs every mechanism that was offered together with a
latent force on every equation. Where its search came to an end, free runs estimate the leading set,
what it competes with and re-calibration, for the report, and must bear it out. What is claimed then
is told by the posterior and two costs (`diagnosis.verdict`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import chain, combinations

import numpy as np
from scipy.special import fdtrc

from jaxsr._result import StoppedBy
from jaxsr.diagnosis.calibrating.horizon import Start
from jaxsr.diagnosis.calibrating.opening import opening
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.compared import RECALIBRATION, SEVERAL, UNNAMED
from jaxsr.diagnosis.decision import Decision
from jaxsr.diagnosis.explanations import labels_of
from jaxsr.diagnosis.free_runs import FreeRuns
from jaxsr.diagnosis.judging.detection import SIGNIFICANCE, detect_in_noise
from jaxsr.diagnosis.judging.leading import best_so_far
from jaxsr.diagnosis.judging.nesting import inner_of
from jaxsr.diagnosis.judging.nesting import plainest as no_richer
from jaxsr.diagnosis.judging.noise_ratio import (
    ABOVE_NOISE,
    ratios_to_noise,
    residual_to_noise,
    root_mean_square,
    sensor_noise,
)
from jaxsr.diagnosis.judging.parsimony import fewest
from jaxsr.diagnosis.laws.written import Writer
from jaxsr.diagnosis.likelihood.abreast import many
from jaxsr.diagnosis.likelihood.course import Course
from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis
from jaxsr.diagnosis.likelihood.later import Written
from jaxsr.diagnosis.likelihood.posterior import Posterior, posterior
from jaxsr.diagnosis.likelihood.sensor_noise import Noise
from jaxsr.diagnosis.likelihood.state import State
from jaxsr.diagnosis.mechanisms.super_model import SuperModel, one_of_each
from jaxsr.diagnosis.shooting.arena import (
    Arena,
    in_sharpest_widths,
    neutral_values,
)
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.widths import WIDEST
from jaxsr.diagnosis.thinning import for_evidence
from jaxsr.diagnosis.verdict import Claim

REMOVED = 0.3
"""Share of the re-calibrated error up to which a mismatch counts as explained."""
WEIGHING = 0.75
"""Share of the time left that the posterior may take."""
RIVALS, TOLD = 4, 1e-3
"""Sets beside the leading one that the report compares it with, and from which probability on; the
first of them whatever it has."""

Renamed = Mapping[str, str]
"""Labels, and those that are told in their place."""


def weighed(case: Case, rng: np.random.Generator) -> Posterior | None:
    """Return the posterior; None where it cannot be had, or not in time."""
    model = case.simulator.model
    if case.search.exhausted:
        return None
    patience = case.search.share(WEIGHING)
    told = case.prepared if case.quiet else for_evidence(model, case.prepared)
    case.progress.stage("weighing mechanisms by the evidence of the recordings")

    def stop() -> bool:
        return patience.exhausted

    def tell(state: State) -> None:
        null, leader = state.known[()], state.leader
        labels = (state.work.super_model.candidates[i].label for i in leader.members)
        lacking = null.share if null is not None else 0.0
        left = leader.share / lacking if lacking > 0.0 else float("nan")
        text = best_so_far(labels, left, "the force that re-calibration lacks")
        case.progress.update(min(patience.elapsed / patience.seconds, 1.0), text)

    writer = Writer(rng, lambda: patience.remaining)

    def write(state: State, course: Course) -> Sequence[Written]:
        return case.failures.attempt("writing laws", lambda: writer(state, course), [])

    with np.errstate(all="ignore"):  # a law may be no number anywhere: such sets lose
        return case.failures.attempt(
            "weighing mechanisms",
            lambda: posterior(model, told, case.seen, stop, tell, write),
            None,
        )


def _left_over(arena: Arena, entry: Entry, noise: Noise) -> float:
    """Largest ratio, over the outputs, of what a set leaves to the noise of the sensor.

    That noise is what neighbouring samples tell, or what the evidence does: a bias that wanders
    shows in no difference of neighbours.
    """
    told = np.sqrt(noise.white + noise.coloured)
    return max(
        min(ratio, root_mean_square(entry.fit.residual[k]) * arena.problem.scale[k] / told[k])
        for k, ratio in enumerate(ratios_to_noise(arena, entry))
    )


def borne_out(found: Decision, leader: Hypothesis) -> bool:
    """Whether free runs bear a decision out.

    They do not where the set follows the recordings worse than re-calibration, or leaves more than
    the sensors' noise, which the evidence takes for noise. Where it has a force beside the set,
    that is what free runs gather of it, and where its noise is that which neighbouring samples
    tell, how round free runs take corners: the set stands then as long as they detect it and it
    explains the mismatch.

    Parameters
    ----------
    leader : Hypothesis
        Of the evidence.
    """
    arena, chosen, null = found.arena, found.chosen, found.null
    if not chosen.follows_as_well_as(null):
        return False
    if residual_to_noise(arena, chosen) <= ABOVE_NOISE:
        return True
    if not (leader.settled and (leader.share > 0.0 or _as_told(arena, leader.noise))):
        return False
    return found.detection.detected and chosen.fit.cost < REMOVED**2 * null.fit.cost


def _as_told(arena: Arena, noise: Noise) -> bool:
    """Whether the evidence takes no more for noise than neighbouring samples tell."""
    sizes = np.sqrt(noise.white + noise.coloured)
    return all(size <= ABOVE_NOISE * sensor_noise(arena, k) for k, size in enumerate(sizes))


def above_noise(found: Decision, noise: Noise) -> bool:
    """Whether re-calibration leaves more than the sensors' noise, at the rate of the detection.

    Neighbouring samples tell that noise by as many of its values.

    Parameters
    ----------
    noise : Noise
        That the evidence has of the sensors.
    """
    null = found.null
    count = max(int(np.count_nonzero(null.fit.residual[0])), 1)
    return bool(fdtrc(count, count, _left_over(found.arena, null, noise) ** 2) < SIGNIFICANCE)


def answered(found: Decision, claim: Claim, free: Collection[str]) -> Decision:
    """Return a decision with a claim, and its leading set as the chosen one.

    Wrong values of `free` parameters are re-calibration's.
    """
    wanted = claim.leading - {f"wrong_value@parameter:{name}" for name in free}
    every = found.arena.super_model.candidates
    of = {frozenset(every[i].label for i in e.members): e for e in reversed(found.entries)}
    return replace(found, claim=claim, chosen=of.get(wanted, found.chosen))


def plainest(found: Decision, stop: Callable[[], bool]) -> tuple[Decision, Renamed]:
    """Return a decision with the fewest members that matter, and their laws no richer than needed.

    Where free runs leave more than the sensors' noise, something acts that nobody named. What
    members explain together, or a law beyond the one inside it, may imitate it, if it is less than
    that (`judging.parsimony`). One of the claimed verdict stays. With it come the labels of richer
    laws that are told by those of the laws inside.
    """
    arena, entries, chosen = found.arena, found.entries, found.chosen
    if residual_to_noise(arena, chosen) <= ABOVE_NOISE:
        return found, {}
    every, members = arena.super_model.candidates, {*chosen.members}
    inside = [e for e in entries if {*e.members} < members]
    verdict = found.claim.verdict
    inside = [e for e in inside if any(every[i].verdict is verdict for i in e.members)]
    few = fewest(chosen, arena, inside)
    entries, plain = no_richer(arena, few, entries, stop)
    richer = (i for i in few.members if i not in plain.members)
    inner = {every[i].label: inner_of(every, i) for i in richer}
    renamed = {label: every[i].label for label, i in inner.items() if i is not None}
    return replace(found, entries=entries, chosen=plain), renamed


def decided_by_evidence(case: Case, found: Posterior) -> Decision:
    """Return the decision on the leading set, without what is claimed.

    What decides comes first: the leading set, its parts, and laws inside theirs. Sets that they are
    only compared with have the time that is left.
    """
    leader, null = found.leader, next(h for h in found.hypotheses if not h.members)
    own, rivals = [leader, *_inside(found)], _rivals(found)
    shown = [h for h in dict.fromkeys([*own, *rivals]) if h.members]
    super_model, starts = _starts(case, found, [null, *shown])
    arena, entry, headline, starts = opening(case, super_model, starts)
    case.so_far.append((arena, entry, headline.seconds))
    case.compared.reach(RECALIBRATION)
    if found.timely:
        case.compared.tell(c.label for c in super_model.candidates)
        case.compared.reach(SEVERAL, UNNAMED)
    else:
        case.compared.tell(found.asked)
    arena = as_wide_as_a_jump(arena, leader.width)
    asked = [frozenset(h.members) for h in found.hypotheses]
    pairs = list(zip(starts[1:], shown, strict=True))
    runs = FreeRuns.of(case, arena, found)
    arena, entries = runs.deciding(
        arena,
        runs.begun(arena, entry, found, starts[0][1]),
        [start for start, h in pairs if h in own],
        {start[0] for start, h in pairs if frozenset(h.members) not in asked},
    )
    wanted = starts[1][0] if leader.members else ()
    count = len({c.label for c in found.candidates})
    stopped = StoppedBy.CONVERGED
    if not found.timely:
        stopped = StoppedBy.INTERRUPTED if case.budget.interrupted else StoppedBy.BUDGET

    def decision(arena: Arena, entries: list[Entry]) -> Decision:
        re_calibrated = next(e for e in entries if not e.members)
        chosen = next(e for e in entries if e.members == wanted)
        detection = detect_in_noise(re_calibrated, chosen, count)
        return Decision(arena, entries, chosen, headline.seconds, stopped, detection)

    sound = borne_out(decision(arena, entries), leader)
    beside = [start for start, h in pairs if h in rivals]
    return replace(decision(*runs.beside(arena, entries, beside)), borne_out=sound)


def as_wide_as_a_jump(arena: Arena, width: float | None) -> Arena:
    """Return the arena with jumps as wide as the evidence has them, as far as they are jumps.

    The explained model jumps: what friction explains by being none is not borne out.
    """
    if width is None:
        return arena
    return in_sharpest_widths(arena, float(np.clip(width, 1.0, WIDEST)))


def _rivals(found: Posterior) -> list[Hypothesis]:
    """Return what the report compares the leading set with."""
    leader = found.leader
    every = zip(found.hypotheses, found.probabilities, strict=True)
    others = [(h, p) for h, p in every if labels_of(found, h) != labels_of(found, leader)]
    others = [(h, p) for h, p in others if h.members][:RIVALS]
    return [h for k, (h, p) in enumerate(others) if k == 0 or p >= TOLD]


def _inside(found: Posterior) -> list[Hypothesis]:
    """Return sets of some members of the leader, the smallest first: they are the cheapest.

    What was not estimated begins where the leader is; of a large leader that is too much.
    """
    leader, known = found.leader, {frozenset(h.members): h for h in reversed(found.hypotheses)}
    equations = {c.site for c in found.candidates if c.mechanism == "constant_force"}
    if many(len(equations), leader.members):
        parts = [s for s in known if s and s < {*leader.members}]
        return [known[s] for s in sorted(parts, key=len)]
    sets = chain.from_iterable(
        combinations(leader.members, count) for count in range(1, len(leader.members))
    )
    return [known.get(frozenset(s)) or replace(leader, members=s) for s in sets]


def _starts(
    case: Case, found: Posterior, shown: Sequence[Hypothesis]
) -> tuple[SuperModel, list[Start]]:
    """Return a super-model of these hypotheses and all that a report compares, and their values.

    With them come the laws inside the leader's. Where time ended the search, nothing else does:
    memories that nobody speaks for are dear.
    """
    own = [found.candidates[i] for i in dict.fromkeys(i for h in shown for i in h.members)]
    others = one_of_each(found.candidates) if found.timely else ()
    inner = [inner_of(found.candidates, i) for i in found.leader.members]
    others = [found.candidates[i] for i in inner if i is not None] + [*others]
    candidates = own + [c for c in dict.fromkeys(others) if c not in own]
    super_model = SuperModel.build(case.simulator.model, candidates)
    order = {name: k for k, name in enumerate(super_model.model.parameters)}
    starts: list[Start] = []
    for item in shown:
        theta = neutral_values(super_model)
        members = tuple(sorted(own.index(found.candidates[i]) for i in item.members))
        there = {n: n for n in case.simulator.model.parameters if n in item.constants}
        for i in item.members:
            here = super_model.names[own.index(found.candidates[i])]
            there |= {item.names[i][name]: here[name] for name in here}
        for name, full in there.items():
            if name in item.constants:
                theta[order[full]] = item.constants[name][0]
        starts.append((members, theta))
    return super_model, starts
