"""Contenders: the sets of mechanisms that enter the contest, and where they start."""

from __future__ import annotations

import numpy as np

from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.contest.arena import neutral_values
from jaxsr.diagnosis.mechanisms import force_candidates, sensor_candidates
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.memory import memory_candidates
from jaxsr.diagnosis.mechanisms.shapes import shapes
from jaxsr.diagnosis.mechanisms.site import Threshold, grows_in_proportion, sites_of
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.mechanisms.timing import timing_candidates
from jaxsr.diagnosis.screening.screen import STEEPEST, ScreenedSet
from jaxsr.diagnosis.setup import Screened, input_samples, sample_step, state_scale
from jaxsr.models import Model

SINGLES, PAIRS, LARGER = 3, 3, 3
VARIANTS = 2
"""Starts of one mechanism that the free run compares."""
BRIEF = frozenset({"overflow"})
"""Mechanisms that act too briefly for the weak view to choose among their variants."""
STARTS = {True: 8, False: 2}
"""The same where a state hides, and no weak view has chosen among them: those that one
linearisation judges, and those that are estimated one by one."""
SEEDED = frozenset(
    "position_dependent_friction end_stop harmonic_force position_ripple parametric_excitation "
    "transient_force".split()
)
"""Mechanisms whose inner constants are found from the residual forces alone."""
Start = tuple[tuple[int, ...], np.ndarray]
"""Members of a set and the parameter values its estimation starts from."""


def leading_sets(case: Case) -> list[ScreenedSet]:
    """Pick the sets that enter the contest: the best of each size, distinct mechanisms first."""
    if case.screened is None:
        return []
    screening, super_model = case.screened.screening, case.screened.super_model
    chosen: list[ScreenedSet] = []
    for size, number in ((1, SINGLES), (2, PAIRS), (3, LARGER)):
        seen: set[frozenset[str]] = set()
        for item in (s for s in screening.sets if len(s.members) == size):
            labels = frozenset(super_model.candidates[i].label for i in item.members)
            if labels in seen or not screened_plausible(super_model, item):
                continue
            seen.add(labels)
            chosen.append(item)
            if len(seen) == number:
                break
    # A larger set is worth a contest only where it gains clearly in the weak view.
    best = {
        n: min((s.error for s in chosen if len(s.members) == n), default=np.inf) for n in (1, 2)
    }
    limit = 0.98
    keep = [s for s in chosen if len(s.members) == 1]
    keep += [s for s in chosen if len(s.members) == 2 and best[2] < limit * best[1]]
    below = min(best.values())
    keep += [s for s in chosen if len(s.members) == 3 and s.error < limit * below]
    # Behind the leader the quick ones first: where estimates are slow, time ends with the others.
    keep.sort(key=lambda s: s.error)
    keep[1:] = sorted(keep[1:], key=lambda s: (len(s.members), s.error))
    return keep


def screened_plausible(super_model: SuperModel, item: ScreenedSet) -> bool:
    """Whether a screened set obeys the order Fs >= Fc and names asymmetry beside friction only."""
    chosen = [super_model.candidates[i] for i in item.members]
    order = list(super_model.model.parameters)
    for number, candidate in zip(item.members, chosen, strict=True):
        names = super_model.names[number]
        if candidate.mechanism == "stribeck_friction":
            fc, fs = (item.values[order.index(names[n])] for n in ("Fc", "Fs"))
            if not fc <= fs <= STEEPEST * fc:
                return False
        if candidate.mechanism == "asymmetric_friction" and not _has_friction(
            super_model.given, candidate, chosen
        ):
            return False
    return True


def _has_friction(given: Model, candidate: Candidate, chosen: list[Candidate]) -> bool:
    """Whether friction in the set or a velocity term in the model stands beside the asymmetry."""
    beside = {
        "viscous_damping",
        "coulomb_friction",
        "stribeck_friction",
        "position_dependent_friction",
        "load_dependent_friction",
    }
    if any(c.site == candidate.site and c.mechanism in beside for c in chosen):
        return True
    state = candidate.site.partition(":")[2]
    term = given.equation_terms[state]
    return state in term.variables


def contenders(case: Case, sets: list[ScreenedSet]) -> tuple[SuperModel, list[Start]]:
    """Build the super-model of all contenders, and where the leading sets' estimation starts.

    The first entry is re-calibration alone, the second the leading set of the weak view.
    """
    given = case.simulator.model
    duration = max(float(p.time[-1]) for p in case.prepared)
    timing = timing_candidates(given, sample_step(case.prepared), duration)
    sensors = [*sensor_candidates(given, _readings(case)), *timing]
    if case.screened is None:
        super_model = SuperModel.build(given, [*_unscreened(case), *sensors])
        return super_model, [((), neutral_values(super_model))]
    screened = case.screened
    used = sorted({i for s in sets for i in s.members} | _best_variants(screened))
    chosen = [screened.super_model.candidates[i] for i in used]
    seen = set(screened.grid.observable)
    if seen < set(given.dynamic_states):
        chosen += [c for c in _unscreened(case) if c.terms and not seen & {s for s, _ in c.terms}]
    super_model = SuperModel.build(given, [*chosen, *sensors])
    empty = carried(screened, super_model, used, screened.screening.empty)
    starts = [((), empty)]
    starts += [
        (tuple(used.index(i) for i in s.members), carried(screened, super_model, used, s))
        for s in sets
    ]
    return super_model, starts


def carried(
    screened: Screened, super_model: SuperModel, used: list[int], item: ScreenedSet
) -> np.ndarray:
    """Return the values of a screened set in a super-model of the candidates `used`."""
    order, full = list(super_model.model.parameters), list(screened.super_model.model.parameters)
    theta = neutral_values(super_model)
    for j in screened.super_model.base_index():
        theta[order.index(full[j])] = item.values[j]
    for i in item.members:
        for own, name in screened.super_model.names[i].items():
            target = super_model.names[used.index(i)][own]
            theta[order.index(target)] = item.values[full.index(name)]
    return theta


def _readings(case: Case) -> dict[str, np.ndarray]:
    """Samples of every output over all recordings."""
    values = np.concatenate([p.outputs for p in case.prepared])
    return dict(zip(case.simulator.model.outputs, values.T, strict=True))


def _unscreened(case: Case) -> list[Candidate]:
    """Return forces that do not need their equation read off the sensors.

    Where a state hides, inner constants that only the residual forces show have no data to start
    from.
    """
    given = case.simulator.model
    scale, step = state_scale(given, case.prepared), sample_step(case.prepared)
    forces = [
        *force_candidates(given, scale, inputs=input_samples(given, case.prepared)),
        *memory_candidates(given, scale, step),
        *(c for site in sites_of(given, scale) for c in shapes(site)),
    ]
    kept: dict[tuple[str, bool], list[Candidate]] = {}
    for candidate in forces:
        if candidate.mechanism not in SEEDED:
            quick = grows_in_proportion(candidate) and not candidate.states
            kept.setdefault((candidate.label, quick), []).append(candidate)
    return [c for (_, quick), variants in kept.items() for c in variants[: STARTS[quick]]]


def _best_variants(screened: Screened) -> set[int]:
    """Of every mechanism the variants that fit best in the weak view.

    Where noise hides whether a threshold is met, those that change the motion least: a threshold
    that cuts off most of a signal would have been seen.
    """
    super_model, screening = screened.super_model, screened.screening
    error = {s.members[0]: s.error for s in screening.sets if len(s.members) == 1}
    by_label: dict[str, list[int]] = {}
    for number, candidate in enumerate(super_model.candidates):
        if number not in screening.blind:
            by_label.setdefault(candidate.label, []).append(number)
    chosen: set[int] = set()
    for numbers in by_label.values():
        brief = super_model.candidates[numbers[0]].mechanism in BRIEF
        ranked = sorted(numbers, key=lambda i: (error.get(i, np.inf), _reach(screened, i)))
        # A wall on the left is no start for one on the right.
        forms = {super_model.candidates[i].terms: i for i in reversed(ranked)}
        chosen |= set(ranked if brief else [*ranked[:VARIANTS], *forms.values()])
    return chosen


def _reach(screened: Screened, number: int) -> float:
    """Size of the effect of a threshold at its seed; 0 for anything else."""
    candidate = screened.super_model.candidates[number]
    ends = [p for p in candidate.parameters if isinstance(p, Threshold)]
    columns = screened.super_model.index(number, coefficients_only=True)
    sizes = [float(np.linalg.norm(screened.system.jacobian[:, k])) for k in columns]
    # A sensor may have a limit at both ends; nothing but thresholds stands beside one.
    steps = (abs(end.seed - end.neutral) for end in ends)
    return max((step * size for step, size in zip(steps, sizes, strict=False)), default=0.0)
