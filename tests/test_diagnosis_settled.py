"""The decision by evidence: when it stands, and what it hands to the report."""

from __future__ import annotations

import importlib
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from jaxsr._clock import now
from jaxsr._progress import Budget
from jaxsr._result import StoppedBy, Verdict
from jaxsr.diagnosis import diagnose
from jaxsr.diagnosis import settled as module
from jaxsr.diagnosis.decision import Decision
from jaxsr.diagnosis.explanations import explanations, unnamed, weights_of
from jaxsr.diagnosis.judging.weights import Weights
from jaxsr.diagnosis.likelihood.posterior import Posterior, WrongValue
from jaxsr.diagnosis.mechanisms.candidate import UNNAMED
from jaxsr.diagnosis.settled import answered, plainest
from jaxsr.diagnosis.shooting.widths import WIDEST
from jaxsr.diagnosis.verdict import Claim, Costs, Explanation, claimed
from jaxsr.models import Simulator, parse_model
from tests.test_likelihood_search import MODEL, recorded


@dataclass(frozen=True)
class Named:
    """A candidate of which only label and verdict count."""

    label: str
    verdict: Verdict = Verdict.STRUCTURE
    mechanism: str = ""

    @property
    def site(self) -> str:
        return self.label.partition("@")[2]


@dataclass(frozen=True)
class Weighed:
    """A hypothesis of which only members, evidence and latent force count."""

    members: tuple[int, ...]
    log_evidence: float = 0.0
    share: float = 0.0


@dataclass(frozen=True)
class Estimated:
    """An entry of which only the members count."""

    members: tuple[int, ...]


CANDIDATES = (Named("a@x"), Named("a@x"), Named("b@x"), Named("c@y", Verdict.MEASUREMENT))
GIVEN = parse_model(MODEL)


def found(hypotheses: list[Weighed], probabilities: list[float], **more: Any) -> Posterior:
    logs = np.log(np.maximum(probabilities, 1e-300))
    every = cast("Any", (CANDIDATES, tuple(hypotheses), logs))
    return Posterior(*every, **more)


def decision(arena: Any, entries: list[Any], chosen: Any, borne_out: bool = True) -> Decision:
    """Return one of which only the sets count."""
    return Decision(arena, entries, chosen, 1.0, StoppedBy.CONVERGED, borne_out=borne_out)


def claim(posterior: Posterior) -> Verdict:
    told = explanations(posterior, GIVEN)
    return claimed(told, unnamed(told)).verdict


def test_variants_of_one_set_share_their_probability() -> None:
    told = explanations(found([Weighed((0,)), Weighed((1,)), Weighed(())], [0.6, 0.3, 0.1]), GIVEN)
    mass = weights_of(told).of
    assert mass == {frozenset({"a@x"}): pytest.approx(0.9), frozenset(): pytest.approx(0.1)}


def test_another_mechanism_of_the_same_verdict_is_no_doubt_about_it() -> None:
    a, b, c, none = Weighed((0,), 9.0), Weighed((2,), 9.0), Weighed((3,), 9.0), Weighed((), 0.0)
    assert claim(found([a, none], [0.96, 0.04])) is Verdict.STRUCTURE
    assert claim(found([a, none], [0.9, 0.1])) is Verdict.UNDECIDED  # there is, at 9 to 1
    assert claim(found([a, b, none], [0.5, 0.47, 0.03])) is Verdict.STRUCTURE
    assert claim(found([a, c, none], [0.5, 0.47, 0.03])) is Verdict.UNDECIDED
    assert claim(found([none, a], [0.96, 0.04])) is Verdict.NOTHING


def test_a_set_answers_with_the_verdict_of_the_member_that_explains_most() -> None:
    none, sensor, law = Weighed((), 0.0), Weighed((3,), 50.0), Weighed((0,), 400.0)
    both = Weighed((0, 3), 480.0)  # without the law 430 is lost, without the sensor 80
    assert claim(found([both, law, sensor, none], [1.0, 0.0, 0.0, 0.0])) is Verdict.STRUCTURE
    sensor, law = Weighed((3,), 400.0), Weighed((0,), 50.0)
    assert claim(found([both, law, sensor, none], [1.0, 0.0, 0.0, 0.0])) is Verdict.MEASUREMENT


def test_what_has_no_more_evidence_than_recalibration_is_no_mismatch() -> None:
    """Each of many laws that the data say nothing of has a share: together, they are no claim."""
    none, idle = Weighed((), 0.0), Weighed((0,), -3.0)
    assert claim(found([none, idle], [0.6, 0.4])) is Verdict.NOTHING
    assert claim(found([Weighed((0,), 9.0), none, idle], [0.96, 0.02, 0.02])) is Verdict.STRUCTURE


def test_recalibration_beside_a_force_that_stays_is_something_else() -> None:
    """Neither the law nor a force that nobody names is sure: that there is something, is."""
    law, null = Weighed((0,), 9.0, 0.05), Weighed((), 8.0, 0.1)
    posterior = found([law, null], [0.65, 0.35], something_else=0.999)
    assert unnamed(explanations(posterior, GIVEN)) == pytest.approx(0.35 * 0.999)
    assert claim(posterior) is Verdict.UNDECIDED
    forced = found([null, law], [0.9, 0.1], something_else=0.999)
    assert claim(forced) is Verdict.UNDECIDED
    below = explanations(forced, GIVEN, above_noise=False)  # no mismatch above the noise
    assert claimed(below, unnamed(below)).verdict is Verdict.NOTHING
    # beside a wrong value, which explains something, it is what is left
    wrong = (WrongValue("k", 9.0, 0.1, 0.99),)
    beside = found([null], [1.0], something_else=0.999, wrong=wrong)
    assert claim(beside) is Verdict.PARAMETER


def test_wrong_values_are_freed_one_after_the_other() -> None:
    wrong = WrongValue("k", 9.0, 0.1, 0.99), WrongValue("d", 0.5, 0.1, 0.6)
    posterior = found([Weighed(())], [1.0], wrong=wrong)
    mass = weights_of(explanations(posterior, GIVEN))
    assert sum(mass.of.values()) == pytest.approx(1.0)
    assert mass.of[frozenset()] == pytest.approx(0.01)
    assert mass.of_label("wrong_value@parameter:k") == pytest.approx(0.99)
    assert mass.of_label("wrong_value@parameter:d") == pytest.approx(0.99 * 0.6)
    assert claim(posterior) is Verdict.PARAMETER
    # what says no more than re-calibration is no doubt about its wrong values
    sure = (WrongValue("k", 9.0, 0.1, 1.0),)
    assert claim(found([Weighed(()), Weighed((0,), -3.0)], [0.9, 0.1], wrong=sure)) is (
        Verdict.PARAMETER
    )


@dataclass(frozen=True, eq=False)
class Refined:
    """An estimate of which only intervals count."""

    arena: Any
    entry: Estimated
    half: np.ndarray
    told: np.ndarray


def test_constants_without_a_trace_in_free_runs_have_the_interval_of_the_evidence() -> None:
    candidate = SimpleNamespace(label="overflow@equation:h")
    model = SimpleNamespace(parameters={"a": 0, "ko__0": 0, "xo__0": 0})
    names = ({"ko": "ko__0", "xo": "xo__0"},)
    arena = SimpleNamespace(
        super_model=SimpleNamespace(model=model, candidates=(candidate,), names=names)
    )
    half = np.array([0.2, 0.0, 0.3])
    estimate = Refined(arena, Estimated((0,)), half, np.array([0.1, 0.0, 0.3]))
    known = {("overflow@equation:h", "ko"): 2.0, ("overflow@equation:h", "xo"): 5.0}
    found = Weights({}, known).told_of(cast("Any", estimate))
    assert found.half.tolist() == pytest.approx([0.2, 3.92, 0.3])
    assert found.told.tolist() == pytest.approx([0.1, 3.92, 0.3])
    assert half[1] == 0.0


def test_a_law_that_is_set_aside_leaves_the_others_and_what_it_was_for() -> None:
    """Odds among what is left stay; that a force is there is certain where one is left."""
    law = Weighed((0,))
    rest = [Weighed((0, 3)), Weighed((2,), share=0.1), Weighed(())]
    posterior = found([law, *rest], [0.9, 0.05, 1e-30, 1e-31])
    left = posterior.without([0])
    assert [h.members for h in left.hypotheses] == [(2,), ()]
    np.testing.assert_allclose(left.probabilities, [10.0 / 11.0, 1.0 / 11.0])
    assert left.something_else == 1.0
    assert posterior.without([2]).something_else == 0.0
    np.testing.assert_allclose(posterior.probabilities[:2], [0.9 / 0.95, 0.05 / 0.95])


def decided(
    monkeypatch: pytest.MonkeyPatch, posterior: Posterior, sound: tuple[int, ...] | None
) -> tuple[Decision, list[tuple[int, ...]]]:
    """Return what is decided where free runs bear out one set alone, and which they were asked."""
    course = importlib.import_module("jaxsr.diagnosis.diagnose")
    asked: list[tuple[int, ...]] = []

    def asking(case: Any, found: Posterior) -> Decision:
        asked.append(found.leader.members)
        arena = SimpleNamespace(super_model=SimpleNamespace(candidates=posterior.candidates))
        entries = [Estimated(found.leader.members), Estimated(())]
        return decision(arena, entries, entries[0], asked[-1] == sound)

    monkeypatch.setattr(course, "weighed", lambda *_: posterior)
    monkeypatch.setattr(course, "decided_by_evidence", asking)
    monkeypatch.setattr(course, "above_noise", lambda *_: True)
    monkeypatch.setattr(course, "plainest", lambda found, _: (found, {}))
    monkeypatch.setattr(course, "deviations_of", lambda _: {})
    monkeypatch.setattr(Weighed, "noise", None, raising=False)
    case = SimpleNamespace(
        failures=SimpleNamespace(attempt=lambda _, act, __: act()),
        search=SimpleNamespace(exhausted=False),
        simulator=SimpleNamespace(model=GIVEN),
    )
    return course._decided(cast("Any", case), Costs(), np.random.default_rng(0)), asked


@pytest.mark.parametrize("sound", [(0,), None])
def test_laws_that_no_free_run_bears_out_are_set_aside_one_after_another(
    sound: tuple[int, ...] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A named set is not: where nothing else leads, nothing is claimed."""
    sets = [Weighed((4,), 9.0), Weighed((5,), 8.0), Weighed((0,), 7.0), Weighed(())]
    laws = (Named("unnamed@x", mechanism=UNNAMED), Named("unnamed@y", mechanism=UNNAMED))
    every = cast("Any", (*CANDIDATES, *laws))
    posterior = replace(found(sets, [0.9, 0.09, 0.01, 1e-9]), candidates=every)
    told, asked = decided(monkeypatch, posterior, sound)
    assert asked == [(4,), (5,), (0,)]
    assert told.claim.leading == {"a@x"}
    assert told.claim.verdict is (Verdict.STRUCTURE if sound else Verdict.UNDECIDED)


@pytest.mark.parametrize("sound", [(3,), None])
def test_beside_a_set_that_is_not_borne_out_the_search_goes_on(
    sound: tuple[int, ...] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As long as another set leads: the claim is that of the most probable one."""
    sets = [Weighed((0,), 9.0), Weighed((2,), 3.0), Weighed(())]
    better = found([Weighed((3,), 19.0), *sets], [1.0, 1e-4, 1e-6, 1e-9])
    begun: list[tuple[int, ...]] = []

    def further(leading: tuple[int, ...]) -> Posterior | None:
        begun.append(leading)
        return replace(better, further=further) if len(begun) == 1 else None

    posterior = replace(found(sets, [0.99, 0.01, 1e-6]), further=further)
    told, asked = decided(monkeypatch, posterior, sound)
    assert asked == [(0,), (3,)]
    assert begun == ([(0,)] if sound else [(0,), (3,)])
    assert told.claim.leading == {"c@y"}
    assert told.claim.verdict is (Verdict.MEASUREMENT if sound else Verdict.UNDECIDED)


def test_alternatives_are_sets_with_one_other_member_in_its_place() -> None:
    weights = Weights(
        {
            frozenset({"a@x", "c@y"}): 0.7,
            frozenset({"b@x", "c@y"}): 0.2,
            frozenset({"a@x"}): 0.06,
            frozenset(): 0.04,
        }
    )
    chosen = Estimated((0, 3))
    entries = [chosen, Estimated((2, 3)), Estimated((0,)), Estimated(())]
    model = cast("Any", type("M", (), {"candidates": CANDIDATES}))
    probability, others = weights.alternatives(model, cast("Any", chosen), 0, cast("Any", entries))
    assert probability == pytest.approx(0.76)
    assert [(a.number, a.probability) for a in others] == [(2, 0.2)]


def test_members_that_free_runs_do_not_show_replace_nothing() -> None:
    """Nor do they hide what stands in the place of those that are told."""
    weights = Weights(
        {
            frozenset({"a@x", "c@y"}): 0.6,
            frozenset({"b@x", "c@y"}): 0.2,
            frozenset({"b@x"}): 0.1,
            frozenset({"a@x"}): 0.06,
            frozenset({"c@y"}): 0.04,
        }
    )
    chosen = Estimated((0,))
    entries = cast("Any", [chosen, *map(Estimated, [(2, 3), (2,), (0, 3), (3,), ()])])
    model = cast("Any", type("M", (), {"candidates": CANDIDATES}))
    probability, others = weights.alternatives(model, cast("Any", chosen), 0, entries)
    assert probability == pytest.approx(0.66)
    ((number, share),) = [(a.number, a.probability) for a in others]
    assert (number, share) == (2, pytest.approx(0.3))
    assert others[0].entry.members == (2, 3)  # the most probable of its sets


def test_a_richer_law_counts_as_the_one_inside_that_is_told_in_its_place() -> None:
    """That friction of one size acts is as probable as that it does, or more with it."""
    told = [
        Explanation(frozenset({"b@x", "c@y"}), Verdict.STRUCTURE, 0.7),
        Explanation(frozenset({"a@x", "c@y"}), Verdict.STRUCTURE, 0.2),
        Explanation(frozenset({"c@y"}), Verdict.MEASUREMENT, 0.1),
    ]
    weights = weights_of(told, {"b@x": "a@x"})
    assert weights.of_label("a@x") == pytest.approx(0.9)
    assert weights.of_label("b@x") == 0.0
    model = cast("Any", type("M", (), {"candidates": CANDIDATES}))
    plain, richer = Estimated((0, 3)), Estimated((2, 3))
    entries = cast("Any", [plain, richer, Estimated((3,)), Estimated(())])
    probability, others = weights.alternatives(model, cast("Any", plain), 0, entries)
    assert probability == pytest.approx(0.9)
    assert others == []  # the richer law is no other cause
    assert weights.share(model, cast("Any", richer)) == pytest.approx(0.9)


@pytest.mark.parametrize(("left", "named"), [(1.0, 1), (20.0, 1), (20.0, 0)])
def test_a_richer_law_is_named_where_it_explains_more_than_is_left(
    left: float, named: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    candidates = (
        Named("coulomb_friction@equation:v", mechanism="coulomb_friction"),
        Named("stribeck_friction@equation:v", mechanism="stribeck_friction"),
    )
    arena = SimpleNamespace(super_model=SimpleNamespace(candidates=candidates))
    plain, richer = Estimated((0,)), Estimated((1,))
    monkeypatch.setattr(module, "residual_to_noise", lambda *_: left)
    monkeypatch.setattr(module, "fewest", lambda chosen, *_: chosen)
    monkeypatch.setattr(module, "no_richer", lambda *_: ([richer, plain], (plain, richer)[named]))
    claim = Claim(Verdict.STRUCTURE, frozenset({candidates[1].label}), 1.0)
    found = replace(decision(arena, [richer], richer), claim=claim)
    told, renamed = plainest(found, lambda: False)
    assert told.chosen is (plain, richer)[named]
    assert cast("Any", plain) in told.entries or left == 1.0
    assert renamed == ({} if named else {candidates[1].label: candidates[0].label})


def test_free_runs_round_no_jump_until_it_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Damping by the position led as dry friction with a jump over a thousand times its speeds."""
    monkeypatch.setattr(module, "in_sharpest_widths", lambda _, factor: factor)
    arena = cast("Any", "as it was")
    widths = [module.as_wide_as_a_jump(arena, w) for w in (None, 0.0, 0.12, 12.4, 11380.0)]
    assert widths == ["as it was", 1.0, 1.0, 12.4, WIDEST]


def test_the_chosen_set_is_the_one_that_is_claimed() -> None:
    arena = type("A", (), {"super_model": type("M", (), {"candidates": CANDIDATES})})
    null, law, sensor = Estimated(()), Estimated((0,)), Estimated((3,))

    def chosen(*leading: str) -> tuple[int, ...]:
        claim = Claim(Verdict.STRUCTURE, frozenset(leading), 1.0)
        return answered(decision(arena, [null, law, sensor], law), claim, ("k",)).chosen.members

    assert chosen("c@y") == (3,)
    assert chosen() == ()
    assert chosen("wrong_value@parameter:k") == ()  # re-calibration's
    assert chosen("b@x") == (0,)  # not estimated: the leader stays


@pytest.mark.long
@pytest.mark.parametrize(
    ("force", "k", "verdict", "mechanism"),
    [
        (lambda q, v: -0.5 * v * abs(v), 6.0, "structure", "quadratic_drag"),
        (lambda q, v: 0.0, 9.0, "parameter", "wrong_value"),
        (lambda q, v: 0.0, 6.0, "nothing", None),
    ],
)
def test_the_evidence_decides(force: Any, k: float, verdict: str, mechanism: str | None) -> None:
    rng = np.random.default_rng(2)
    runs = [recorded(rng, force, k) for _ in range(2)]
    document = diagnose(Simulator(parse_model(MODEL)), runs, budget=600.0).document
    assert document["verdict"] == verdict
    first = document["findings"][0]["mechanism"] if document["findings"] else None
    assert first == mechanism
    assert not document["provenance"].get("open")


def test_the_start_of_the_program_takes_nothing_of_the_search(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What is slow to read is slow to report; what the interpreter took to load is neither."""

    class Seen(BaseException):
        pass

    def see(case: Any, costs: Any, rng: Any) -> None:
        raise Seen(case)

    course = importlib.import_module("jaxsr.diagnosis.diagnose")
    monkeypatch.setattr(course, "_decided", see)
    run = recorded(np.random.default_rng(2), lambda q, v: 0.0)
    with pytest.raises(Seen) as seen:
        diagnose(Simulator(parse_model(MODEL)), [run], budget=Budget(1000.0, now() - 400.0))
    assert seen.value.args[0].search.remaining > 100.0


def test_a_rival_with_the_largest_member_of_the_leader_has_its_verdict() -> None:
    """Beside a rival few sets are known: without which member it loses most is not told there."""
    sets = [
        Weighed((1, 2), 100.0),
        Weighed((2, 3), 99.0),
        Weighed((3,), 30.0),
        Weighed((2,), 20.0),
        Weighed((1,), 10.0),
        Weighed(()),
    ]
    told = explanations(found(sets, [0.7, 0.3, 0.0, 0.0, 0.0, 0.0]), GIVEN)
    assert [e.verdict for e in told[:2]] == [Verdict.STRUCTURE] * 2
