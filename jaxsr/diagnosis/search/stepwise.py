"""Growing sets in free run: every mechanism tried beside the leaders, the best of them in full."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.compared import SEVERAL, Compared
from jaxsr.diagnosis.contest.arena import Arena, neutral_values
from jaxsr.diagnosis.contest.enter import enter, shifting_members
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.contest.estimation import CONTEST_TOLERANCE
from jaxsr.diagnosis.judging.criteria import criterion, independent_residuals
from jaxsr.diagnosis.judging.detection import detect_in_noise
from jaxsr.diagnosis.judging.noise_ratio import LIMITED, residual_to_noise
from jaxsr.diagnosis.judging.plausible import plausible
from jaxsr.diagnosis.mechanisms.site import Threshold, grows_in_proportion
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.screening.screen import redundant
from jaxsr.diagnosis.search.nesting import continued, simplified
from jaxsr.diagnosis.search.tangents import tangent_about

QUICK, QUICK_THRESHOLD, QUICK_HIDDEN = 2, 10, 6
"""Iterations by which a mechanism is judged before it is estimated in full; a threshold has to be
moved to where it hardly acts, and where a state hides, its path has to be found first."""
FULL = (8, 5, 4)
"""Mechanisms estimated in full, by the size of the set."""
BROKEN = 0.9
"""Share of the gain promised by one iteration, missed by which an estimate begins anew."""
MOST_BROKEN = 2
"""Starts of a mechanism that miss it, after which no others are estimated."""
OUT_OF_REACH = 30.0
"""Cost, relative to the best so far, from which neither widths nor finer steps are sought, nor the
simpler law inside."""
PARENTS = {False: 2, True: 3}
"""Sets of different mechanisms that grow on; more where all leave far more than the noise."""
BEHIND = 4.0
"""Cost, relative to the leader's, from which a set does not grow on where the leader is near the
noise."""
WORTH = 0.3
"""Share of the best gain, quick or known, from which a mechanism is estimated in full."""
PUNCTUAL = 0.98
"""Cost that a delay leaves, relative to the leader's, from which no lag of that input is tried."""
VARIANT = 0.7
"""Share of a mechanism's best quick gain from which another start of it is tried as well."""


def grow(
    arena: Arena,
    entries: Sequence[Entry],
    exhausted: Callable[[], bool],
    tell: Callable[[float, str], None] = lambda share, text: None,
    compared: Compared | None = None,
) -> Iterator[list[Entry]]:
    """Yield the entries and those of larger sets found on the way, size by size.

    One iteration from a leader's estimate, all parameters moving with it, tells what a mechanism
    can gain (the tangent view); the best of each round are estimated until they settle. Growth
    ends where Schwarz's criterion asks for no more, unless a mismatch far above the noise is left:
    effects that hide each other show together. What was asked of each mechanism beside
    re-calibration is kept in `compared`.
    """
    found = {e.members: e for e in entries}
    leaders, record = [found[()]], Compared() if compared is None else compared
    for size, most in enumerate(FULL, start=1):
        for leader in leaders:
            if exhausted():
                break
            # what one linearisation tells comes first: it may leave nothing to find
            own = record if not leader.members else Compared()
            quick = expected(arena, leader, found, own)
            _estimate(arena, leader, quick, most, found, exhausted, own)
            if size < len(FULL) and leader is leaders[0]:
                quick += tried(arena, leader, quick, found, exhausted, tell, own)
                _estimate(arena, leader, quick, most, found, exhausted, own)
            if leader.members:
                record.reach(SEVERAL)
        yield list(found.values())
        if exhausted():
            return
        known = [e for e in found.values() if not e.members or plausible(arena, e)]
        n = independent_residuals(min(known, key=lambda e: e.fit.cost))
        known.sort(key=lambda e: criterion(arena.super_model, e, n))
        far = residual_to_noise(arena, known[0]) > LIMITED
        if size == 1 and not far and not _detected(arena, found[()], known[0]):
            record.reach(SEVERAL)
            return
        distinct: dict[tuple[str, ...], Entry] = {}
        for entry in (e for e in known if len(e.members) == size):
            labels = tuple(arena.super_model.candidates[i].label for i in entry.members)
            distinct.setdefault(labels, entry)
        leaders = list(distinct.values())[: PARENTS[far]]
        if not far:
            leaders = [e for e in leaders if e.fit.cost < BEHIND * leaders[0].fit.cost]
        if not leaders or (leaders[0] is not known[0] and not far):
            record.reach(SEVERAL)
            return


def _detected(arena: Arena, null: Entry, best: Entry) -> bool:
    """Whether a mechanism stands out of the noise, given how many were tried."""
    every = arena.super_model.candidates
    count = len({c.label for c in every}) * max((every[i].tried for i in best.members), default=1)
    return detect_in_noise(null, best, count).detected


def _estimate(
    arena: Arena,
    leader: Entry,
    quick: Sequence[Trial],
    most: int,
    found: dict[tuple[int, ...], Entry],
    exhausted: Callable[[], bool],
    compared: Compared,
) -> None:
    """Estimate the promising trials until they settle, and enter them in `found`.

    Those that time cuts short or does not allow are kept in `compared`.
    """
    known = (e.fit.cost for e in found.values() if e.fit.usable and plausible(arena, e))
    reached = min(known, default=leader.fit.cost)
    worth, broken = OUT_OF_REACH * reached, Counter[tuple[str, ...]]()
    for trial in promising(arena.super_model, leader, quick, most, reached=reached):
        if trial.members in found:
            continue
        if exhausted():
            compared.leave(arena.super_model, set(trial.members) - set(leader.members))
            continue
        labels = tuple(arena.super_model.candidates[i].label for i in trial.members)
        if broken[labels] == MOST_BROKEN:
            continue
        full, missed = _in_full(arena, leader, trial, worth, exhausted)
        if exhausted() and not full.fit.converged:
            compared.leave(arena.super_model, set(trial.members) - set(leader.members))
        broken[labels] += missed
        found[full.members] = full
        _without_idle(arena, full, found)
        if full.fit.cost <= worth:
            _simpler(arena, full, found, exhausted)
        for start in _wider_forms(arena.super_model, leader, full, found):
            if exhausted():
                break
            wide = enter(arena, start.members, start.theta, full.fit.path, exhausted)
            found[wide.members] = wide


def _in_full(
    arena: Arena, leader: Entry, trial: Trial, worth: float, exhausted: Callable[[], bool]
) -> tuple[Entry, bool]:
    """Estimate a trial until it settles; tell whether it missed its promise from every path."""
    start = trial.members, trial.theta
    least = BROKEN * leader.fit.cost + (1.0 - BROKEN) * trial.cost
    path = leader.fit.path if trial.path is None else trial.path
    full = enter(arena, *start, path, exhausted, worth=worth)
    if full.fit.cost > least:
        # the leader's path may lead astray, where what is new hardly acts
        again = enter(arena, *start, None, exhausted, worth=worth)
        full = min(full, again, key=lambda e: e.fit.cost)
    return full, bool(full.fit.cost > least)


def _wider_forms(
    super_model: SuperModel,
    leader: Entry,
    full: Entry,
    found: Mapping[tuple[int, ...], Entry],
) -> list[Trial]:
    """Start the forms of the newest mechanism that have more constants where the plain one ended.

    A threshold that begins far from its place hides what the further constants would gain.
    """
    (number,) = set(full.members) - set(leader.members)
    plain, names = super_model.candidates[number], super_model.names[number]
    forms: dict[tuple[tuple[str, str], ...], int] = {}  # one of those that differ by their seeds
    for other, candidate in enumerate(super_model.candidates):
        if candidate.label == plain.label and set(names) < set(super_model.names[other]):
            forms.setdefault(candidate.terms, other)
    trials = []
    for other in forms.values():
        members = tuple(sorted({*leader.members, other}))
        theta = continued(super_model, full.fit.theta, number, other, {n: n for n in names})
        if members not in found:
            trials.append(Trial(members, full.fit.cost, theta))
    return trials


def _without_idle(arena: Arena, full: Entry, found: dict[tuple[int, ...], Entry]) -> None:
    """Enter a set without members whose estimated share is nothing, from where it ended.

    Beside them the others may have left a local minimum.
    """
    super_model, theta = arena.super_model, full.fit.theta
    neutral = neutral_values(super_model)
    own = {i: super_model.index(i, coefficients_only=True) for i in full.members}
    rest = tuple(
        i for i in full.members if not own[i] or any(theta[j] != neutral[j] for j in own[i])
    )
    if not rest or rest == full.members:
        return
    if rest not in found or full.fit.cost < (1.0 - CONTEST_TOLERANCE) * found[rest].fit.cost:
        entry = enter(arena, rest, theta, full.fit.path, near=True)
        if rest not in found or entry.fit.cost < found[rest].fit.cost:
            found[rest] = entry


def _simpler(
    arena: Arena,
    full: Entry,
    found: dict[tuple[int, ...], Entry],
    exhausted: Callable[[], bool],
) -> None:
    """Enter a set with the simpler law that is inside one of its members, from where it ended.

    The simpler one may have been left in a corner of its cost, or for want of time.
    """
    for members, start in simplified(arena.super_model, full.members, full.fit.theta):
        known = found.get(members)
        if known is None or not (known.fit.converged and known.fit.usable):
            entry = enter(arena, members, start, full.fit.path, exhausted, near=True)
            if known is None or entry.fit.cost < known.fit.cost:
                found[members] = entry


@dataclass(frozen=True)
class Trial:
    """What a set is expected to reach, and where its estimation starts."""

    members: tuple[int, ...]
    cost: float
    theta: np.ndarray
    path: np.ndarray | None = None


def expected(
    arena: Arena,
    leader: Entry,
    found: Mapping[tuple[int, ...], Entry],
    compared: Compared | None = None,
) -> list[Trial]:
    """Add every mechanism that grows in proportion to a set, in one linearisation."""
    numbers = [i for i in _beside(arena, leader, found) if _proportional(arena, i)]
    trials = _tangent(arena, leader, numbers)
    if compared is not None:
        compared.tell(arena.super_model, numbers)
    return trials


def tried(
    arena: Arena,
    leader: Entry,
    quick: Sequence[Trial],
    found: Mapping[tuple[int, ...], Entry],
    exhausted: Callable[[], bool],
    tell: Callable[[float, str], None],
    compared: Compared | None = None,
) -> list[Trial]:
    """Add every other mechanism to a set, by a few iterations.

    A lag delays slow motion: where a delay of the same input promises next to nothing in `quick`,
    it is left out.
    """
    super_model, record = arena.super_model, Compared() if compared is None else compared
    numbers = [i for i in _beside(arena, leader, found) if not _proportional(arena, i)]
    punctual = _punctual(super_model, leader, quick)
    hidden = any(p.states.hidden for p in arena.prepared)
    trials = []
    for number in numbers:
        if exhausted():
            break
        candidate = super_model.candidates[number]
        if candidate.mechanism == "actuator_lag" and candidate.site in punctual:
            record.tell(super_model, [number])
            continue
        tell(number / len(super_model.candidates), candidate.label)
        members = tuple(sorted({*leader.members, number}))
        start = super_model.seeded((number,), leader.fit.theta)
        threshold = any(isinstance(p, Threshold) for p in candidate.parameters)
        most = QUICK_HIDDEN if hidden else QUICK_THRESHOLD if threshold else QUICK
        # a memory alone is tried without samples before a segment
        place = arena if shifting_members(super_model, members) else replace(arena, wide=None)
        entry = enter(place, members, start, leader.fit.path, exhausted, most)
        if not exhausted():
            record.tell(super_model, [number])
        if entry.fit.usable:
            trials.append(Trial(members, entry.fit.cost, entry.fit.theta, entry.fit.path))
    return trials


def _beside(arena: Arena, leader: Entry, found: Mapping[tuple[int, ...], Entry]) -> Iterator[int]:
    """Yield the candidates that make a new set with a leader."""
    for number in range(len(arena.super_model.candidates)):
        members = tuple(sorted({*leader.members, number}))
        if members not in found and not redundant(arena.super_model, members):
            yield number


def _proportional(arena: Arena, number: int) -> bool:
    """Whether one linearisation tells what a candidate does.

    The course of a memory is known where the motion is.
    """
    candidate = arena.super_model.candidates[number]
    hidden = any(p.states.hidden for p in arena.prepared)
    return grows_in_proportion(candidate) and not (hidden and candidate.states)


def _punctual(super_model: SuperModel, leader: Entry, quick: Sequence[Trial]) -> set[str]:
    """Return the inputs whose delay promises next to nothing beside a leader.

    With one input and one output, the delay of the sensor stands for both.
    """
    model, sites = super_model.given, set[str]()
    single = len(model.inputs) == len(model.outputs) == 1
    for trial in quick:
        (new,) = set(trial.members) - set(leader.members)
        candidate = super_model.candidates[new]
        if candidate.delays and trial.cost > PUNCTUAL * leader.fit.cost:
            sites.add(f"input:{model.inputs[0]}" if single else candidate.site)
    return sites


def _tangent(arena: Arena, leader: Entry, numbers: Sequence[int]) -> list[Trial]:
    """Expect costs from one linearisation, parameters and starts moving along.

    Adding columns C to columns B lowers the cost by g' (C'C - C'B (B'B)^-1 B'C)^-1 g, g the
    moment of C with the residual, starts projected out of all of them.
    """
    super_model = arena.super_model
    if not numbers:
        return []
    own = {i: super_model.index(i, coefficients_only=True) for i in numbers}
    base = [int(j) for j in leader.fit.active]
    tangent = tangent_about(arena, leader)
    active, place, theta = np.array(list(tangent.columns)), tangent.columns, tangent.theta
    hessian, gradient = (a.sum(0) for a in tangent.fit.normal_equations())
    size = np.sqrt(np.maximum(np.diag(hessian), 0.0))
    size = np.where(size > 0, size, np.inf)
    hessian, gradient = hessian / size / size[:, None], gradient / size
    low, high = arena.bounds
    known = [place[j] for j in base]
    if not np.isfinite(hessian[np.ix_(known, known)]).all():
        return []  # along this path nothing tells how the set's own parameters act
    inverse = np.linalg.pinv(hessian[np.ix_(known, known)], rcond=1e-10, hermitian=True)
    trials = []
    for number in numbers:
        new = [place[j] for j in own[number]]
        cross = hessian[np.ix_(new, known)] @ inverse
        left = hessian[np.ix_(new, new)] - cross @ hessian[np.ix_(known, new)]
        pull = gradient[new] - cross @ gradient[known]
        if not (np.isfinite(left).all() and np.isfinite(pull).all()):
            continue  # a law that is no number somewhere along the path promises nothing
        step = np.linalg.lstsq(left + 1e-9 * np.eye(len(new)), pull, rcond=1e-9)[0]
        value = theta.copy()
        at = active[new]
        value[at] += step / size[new]
        inside = (value[at] >= low[at]) & (value[at] <= high[at])
        gain = float(step @ pull) if np.isfinite(step).all() and inside.any() else 0.0
        value[at] = np.clip(value[at], low[at], high[at])
        members = tuple(sorted({*leader.members, number}))
        trials.append(Trial(members, max(leader.fit.cost - gain, 1e-300), value))
    return trials


def promising(
    super_model: SuperModel,
    leader: Entry,
    quick: Sequence[Trial],
    most: int,
    worth: float = WORTH,
    reached: float = np.inf,
) -> list[Trial]:
    """Pick the best few mechanisms, and of each the variants that may turn out best.

    Each must gain a share `worth` of what the best of them does, or a set that `reached` a cost.
    """
    best: dict[tuple[str, ...], list[Trial]] = {}
    for trial in sorted(quick, key=lambda t: t.cost):
        labels = tuple(super_model.candidates[i].label for i in trial.members)
        best.setdefault(labels, []).append(trial)
    ranked = sorted(best.values(), key=lambda trials: trials[0].cost)
    if not ranked:
        return []

    def gain(trial: Trial) -> float:
        return float(np.log(leader.fit.cost / trial.cost))

    least = worth * max(gain(ranked[0][0]), float(np.log(leader.fit.cost) - np.log(reached)))
    chosen = [trials for trials in ranked[:most] if gain(trials[0]) > least >= 0]
    return [t for trials in chosen for t in trials if gain(t) > VARIANT * gain(trials[0])]
