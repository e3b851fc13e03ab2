"""The verdict as a function of the posterior and of two costs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jaxsr._result import InputError, Verdict
from jaxsr.diagnosis.verdict import Costs, Explanation, claimed, masses

EVERY = (Verdict.NOTHING, Verdict.STRUCTURE, Verdict.MEASUREMENT, Verdict.EXTERNAL_INPUT)


def explanation(name: str, verdict: Verdict, probability: float) -> Explanation:
    return Explanation(frozenset({name} if name else ()), verdict, probability)


def drawn(rng: np.random.Generator) -> tuple[list[Explanation], float]:
    """A posterior of some sets, most of it often on one of them."""
    p = rng.dirichlet(np.full(8, 0.15))
    sets = [explanation(f"m{k}", EVERY[int(rng.integers(4))], float(p[k])) for k in range(8)]
    return sets, float(rng.choice([0.0, 0.02, 0.5]))


def friction_or_bias(friction: float) -> list[Explanation]:
    return [
        explanation("coulomb_friction@equation:v", Verdict.STRUCTURE, friction),
        explanation("sensor_bias@output:y", Verdict.MEASUREMENT, 1.0 - friction),
    ]


STEPS = (Verdict.NOTHING, Verdict.UNDECIDED)
"""What is said without a claim, and with the claim of a mismatch alone."""


def test_a_claim_is_made_above_the_odds_of_the_costs() -> None:
    for cost in (1.5, 4.0, 20.0):
        needed = cost / (cost + 1.0)
        above = claimed(friction_or_bias(needed + 1e-6), 0.0, Costs(cost))
        below = claimed(friction_or_bias(needed - 1e-6), 0.0, Costs(cost))
        assert (above.verdict, below.verdict) == (Verdict.STRUCTURE, Verdict.UNDECIDED)
        assert above.mass == pytest.approx(needed + 1e-6)
    # where a false claim costs no more than abstaining, the likeliest is claimed
    assert claimed(friction_or_bias(0.51), 0.0, Costs(1.0)).verdict is Verdict.STRUCTURE


def test_whether_there_is_a_mismatch_is_told_as_is_more_probable() -> None:
    def said(none: float) -> Verdict:
        rest = [replace(e, probability=(1.0 - none) * e.probability) for e in friction_or_bias(0.6)]
        return claimed([*rest, explanation("", Verdict.NOTHING, none)]).verdict

    assert said(0.5 + 1e-6) is Verdict.NOTHING
    assert said(0.5 - 1e-6) is Verdict.UNDECIDED
    # a force that nobody names is a mismatch as well
    nothing = [explanation("", Verdict.NOTHING, 1.0)]
    assert claimed(nothing, 0.4).verdict is Verdict.NOTHING
    assert claimed(nothing, 0.6).verdict is Verdict.UNDECIDED


def test_each_claim_loses_least() -> None:
    rng = np.random.default_rng(0)
    for _ in range(300):
        sets, other = drawn(rng)
        costs = Costs(float(np.exp(rng.uniform(-1.0, 4.0))), float(np.exp(rng.uniform(-1.0, 1.0))))
        mass, answer = masses(sets, other), claimed(sets, other, costs).verdict

        def loss(m: float, claims: bool, costs: Costs = costs) -> float:
            return costs.false_claim * (1.0 - m) if claims else costs.abstaining * m

        mismatch = 1.0 - mass.pop(Verdict.NOTHING, 0.0)
        assert (answer is Verdict.NOTHING) == (mismatch < 0.5)
        best = max(mass.values(), default=0.0)
        if answer is not Verdict.NOTHING:
            names = answer not in STEPS
            assert loss(best, names) <= loss(best, not names)


def test_a_dearer_false_claim_never_adds_a_claim() -> None:
    rng = np.random.default_rng(1)
    for _ in range(100):
        sets, other = drawn(rng)
        answers = [claimed(sets, other, Costs(c)).verdict for c in (0.5, 1.0, 4.0, 20.0, 1e3, 1e9)]
        claims = [(*STEPS, a).index(a) for a in answers]
        assert claims == sorted(claims, reverse=True)
        assert len(set(answers) - set(STEPS)) <= 1


def test_dearer_abstaining_never_takes_a_claim_away() -> None:
    rng = np.random.default_rng(2)
    for _ in range(100):
        sets, other = drawn(rng)
        answers = [claimed(sets, other, Costs(20.0, c)).verdict for c in (0.0, 0.1, 1.0, 10.0, 1e6)]
        claims = [(*STEPS, a).index(a) for a in answers]
        assert claims == sorted(claims)


def test_only_the_ratio_of_the_costs_counts() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        sets, other = drawn(rng)
        assert claimed(sets, other, Costs(20.0, 1.0)) == claimed(sets, other, Costs(5.0, 0.25))


def test_masses_and_something_else_sum_to_one() -> None:
    rng = np.random.default_rng(4)
    for _ in range(50):
        sets, other = drawn(rng)
        assert sum(masses(sets, other).values()) + other == pytest.approx(1.0)


def test_sets_of_one_verdict_speak_for_it_together() -> None:
    sets = [
        explanation("coulomb_friction@equation:v", Verdict.STRUCTURE, 0.5),
        explanation("stribeck_friction@equation:v", Verdict.STRUCTURE, 0.47),
        explanation("", Verdict.NOTHING, 0.03),
    ]
    answer = claimed(sets)
    assert (answer.verdict, answer.leading) == (Verdict.STRUCTURE, sets[0].labels)
    assert answer.mass == pytest.approx(0.97)


def test_what_is_probably_something_else_is_not_claimed() -> None:
    sets = [explanation("gravity@equation:v", Verdict.STRUCTURE, 1.0)]
    assert claimed(sets, 0.04).verdict is Verdict.STRUCTURE
    answer = claimed(sets, 0.06)
    assert (answer.verdict, answer.leading) == (Verdict.UNDECIDED, sets[0].labels)
    assert answer.mass == pytest.approx(0.94)


def test_the_leading_set_is_one_of_the_verdict_that_is_claimed() -> None:
    # Many sets of one verdict, each less probable than the one of another.
    sets = [explanation(f"m{k}", Verdict.STRUCTURE, 0.024) for k in range(40)]
    sets.append(explanation("clock_skew@output:y", Verdict.MEASUREMENT, 0.04))
    answer = claimed(sets)
    assert (answer.verdict, answer.leading) == (Verdict.STRUCTURE, frozenset({"m0"}))
    undecided = claimed(sets, 0.0, Costs(1e3))
    assert undecided.leading == frozenset({"clock_skew@output:y"})


def test_costs_that_are_none_are_refused() -> None:
    for pair in ((-1.0, 1.0), (float("nan"), 1.0), (float("inf"), 1.0), (0.0, 0.0)):
        with pytest.raises(InputError, match="costs of a false claim"):
            Costs(*pair)


def test_beside_others_a_member_is_named_at_the_odds_of_a_claim() -> None:
    """What may as well not act is not named; what another may stand for is."""

    def named(alone: float, other: float) -> frozenset[str]:
        rest = 1.0 - alone - other
        sets = [
            Explanation(frozenset({"drag@v", "delay@u"}), Verdict.STRUCTURE, rest),
            Explanation(frozenset({"drag@v", "lag@u"}), Verdict.STRUCTURE, other),
            Explanation(frozenset({"drag@v"}), Verdict.STRUCTURE, alone),
        ]
        return claimed(sets).leading

    allowed = 1.0 / (1.0 + Costs().false_claim)
    assert named(allowed - 1e-6, 0.0) == {"drag@v", "delay@u"}
    assert named(allowed + 1e-6, 0.0) == {"drag@v"}
    assert named(allowed - 1e-6, 0.4) == {"drag@v", "delay@u"}
    assert named(0.0, 0.0) == {"drag@v", "delay@u"}
    assert named(1.0, 0.0) == {"drag@v"}
