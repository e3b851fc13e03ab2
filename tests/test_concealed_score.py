"""The scorer of the planted cases on hand-made answers, and its statistics."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.concealed.equivalence import equivalent, right_verdicts
from benchmarks.concealed.figures import draw
from benchmarks.concealed.judging import Mark, judge
from benchmarks.concealed.rates import Rate, thresholds
from benchmarks.concealed.scoring import reliability, risk_coverage, summary
from benchmarks.concealed.sets import SETS, pooled, row_of
from benchmarks.concealed.tables import markdown


def effect(mechanism: str, site: str, verdict: str = "structure", **more: Any) -> dict[str, Any]:
    made = {
        "mechanism": mechanism,
        "family": "dissipative",
        "verdict": verdict,
        "site": site,
        "sites": [],
        "twins": [],
        "values": {"Fc": 2.0},
        "unchecked": [],
        "size": 0.1,
    }
    return made | more


def case(*effects: dict, detectable: bool = True, **more: Any) -> dict[str, Any]:
    evidence = {
        "detectable": detectable and bool(effects),
        "absorbed": False,
        "horizons": [0.1, 1.0, 10.0],
        "recalibrated": [0.2, 0.2, 0.2],
        "oracle": [0.1, 0.1, 0.1],
    }
    made = {
        "kind": "structure" if effects else "nothing",
        "system": "two_mass",
        "multibody": True,
        "closed_loop": False,
        "masked": False,
        "turning": ["x9"],
        "springs": True,
        "sensors": [{}],
        "effects": list(effects),
        "evidence": evidence,
    }
    return made | more


def answer(
    verdict: str,
    *named: tuple[str, str],
    probability: float = 0.9,
    explained: float = 0.1,
    **more: Any,
) -> dict[str, Any]:
    findings = [
        {
            "mechanism": m,
            "site": s,
            "probability": probability,
            "alternatives": [],
            "parameters": {"Fc": {"value": 2.0, "ci95": [1.9, 2.1]}},
        }
        for m, s in named
    ]
    held = {"recalibrated": [0.2, 0.2, 0.2], "explained": [explained] * 3}
    fit = {"horizons_s": [0.1, 1.0, 10.0], "headline_s": 1.0, "held_out": held}
    return {"verdict": verdict, "findings": findings, "fit": fit} | more


COULOMB = effect("coulomb_friction", "equation:x1")
TRUTH = {
    "a": case(COULOMB),
    "b": case(),
    "c": case(effect("wrong_value", "parameter:p1", "parameter", values={"p1": 3.0})),
    "d": case(
        effect("sensor_gain", "output:x2", "measurement", values={"g": 1.1}), sensors=[{}, {}]
    ),
}
PERFECT = {
    "a": answer("structure", ("coulomb_friction", "equation:x1")),
    "b": answer("nothing"),
    "c": answer("parameter", ("wrong_value", "parameter:p1")),
    "d": answer("measurement", ("sensor_gain", "output:x2")),
}


def scores(answers: dict[str, Any]) -> dict[str, Any]:
    return summary([judge(n, TRUTH[n], answers.get(n)) for n in TRUTH])


@pytest.mark.parametrize(
    ("k", "n", "low", "high"),
    # Wilson's formula worked by other hands: Newcombe (1998), Table I, and Agresti & Coull
    [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_intervals(k: int, n: int, low: float, high: float) -> None:
    found = Rate(k, n).interval
    assert found == pytest.approx((low, high), abs=6e-5)
    assert Rate(n - k, n).interval == pytest.approx((1 - high, 1 - low), abs=6e-5)


def test_no_cases_have_no_rate() -> None:
    assert Rate.of([]).document() == {"k": 0, "n": 0, "rate": None, "wilson95": None}


def test_perfect_answers() -> None:
    s = scores(PERFECT)
    for name in ("verdict", "site_top1", "mechanism_top1", "mechanism_top3", "effects_named"):
        assert s[name]["rate"] == 1.0
    assert s["mechanism_top1"]["n"] == 3 and s["verdict"]["n"] == 4
    assert s["false_discoveries"]["k"] == 0 and s["false_discoveries"]["n"] == 3
    assert s["gap_closed_median"] == pytest.approx(1.0)
    assert s["held_out_gain_median"] == pytest.approx(0.5)
    assert s["interval_coverage"] == Rate(1, 1).document()
    assert s["wrong_findings"]["k"] == 0 and not s["failures"]


def test_abstaining() -> None:
    s = scores({n: answer("undecided", explained=0.2) for n in TRUTH})
    assert s["verdict"]["k"] == 0 and s["mechanism_top1"]["k"] == 0
    assert s["false_discoveries"]["k"] == 0
    assert s["gap_closed_median"] == 0.0 and s["risk_coverage"] == []
    assert len(s["failures"]) == 4


def test_below_detection_abstaining_is_right() -> None:
    faint = case(COULOMB, detectable=False)
    for verdict, right in (("nothing", True), ("undecided", True), ("structure", False)):
        assert judge("a", faint, answer(verdict)).verdict_right is right
    assert judge("a", faint, answer("nothing")).mechanism_1 is None
    absorbed = case(COULOMB, detectable=False)
    absorbed["evidence"]["absorbed"] = True
    assert judge("a", absorbed, answer("parameter")).verdict_right


def test_wrong_answers() -> None:
    s = scores({n: answer("structure", ("quadratic_drag", "equation:x7")) for n in TRUTH})
    assert s["verdict"]["k"] == 1  # the verdict of "a" happens to be right
    assert s["false_discoveries"]["k"] == 3 and s["false_discoveries"]["n"] == 3
    assert s["wrong_findings"] == Rate(4, 4).document()
    assert s["site_top1"]["k"] == 0 and s["mechanism_top3"]["k"] == 0
    assert s["risk_coverage"][-1] == (1.0, 1.0)


def test_missing_answers_are_failures() -> None:
    s = scores({"a": PERFECT["a"]})
    assert s["answered"]["k"] == 1 and s["verdict"] == Rate(1, 4).document()
    assert s["mechanism_top1"] == Rate(1, 3).document()


def test_a_wrong_interval_does_not_cover_and_a_sign_is_convention() -> None:
    for interval, covered in (([1.9, 2.1], True), ([-2.1, -1.9], True), ([2.1, 2.3], False)):
        given = answer("structure", ("coulomb_friction", "equation:x1"))
        given["findings"][0]["parameters"] = {"Fc_x1": {"value": 2, "ci95": interval}}
        assert judge("a", TRUTH["a"], given).covered == (covered,)


def test_the_second_answer_counts_among_three() -> None:
    given = answer("structure", ("quadratic_drag", "equation:x1"))
    others = [
        {"mechanism": "viscous_damping", "site": "equation:x1", "probability": 0.01},
        {"mechanism": "coulomb_friction", "site": "equation:x1", "probability": 0.09},
    ]
    given["findings"][0]["alternatives"] = others
    mark = judge("a", TRUTH["a"], given)
    assert mark.site_1 and not mark.mechanism_1 and mark.mechanism_3
    given["findings"][0]["alternatives"] = [*others[:1]] * 2 + others[1:]
    for other in given["findings"][0]["alternatives"][:2]:
        other["probability"] = 0.5
    assert not judge("a", TRUTH["a"], given).mechanism_3


@pytest.mark.parametrize(
    ("planted", "mechanism", "site", "right"),
    [
        (effect("constant_force", "equation:x1"), "gravity", "equation:x1", True),
        (effect("gravity", "equation:x9"), "constant_force", "equation:x9", False),
        (effect("constant_force", "equation:x1"), "sensor_bias", "output:x2", True),
        (effect("added_mass", "equation:x1", twins=["p4"]), "wrong_value", "parameter:p4", True),
        (effect("added_mass", "equation:x1", twins=["p4"]), "wrong_value", "parameter:p5", False),
        (effect("end_stop", "equation:x1"), "piecewise_stiffness", "equation:x1", True),
        (effect("end_stop", "equation:x1"), "piecewise_stiffness", "equation:x2", False),
        (effect("input_delay", "input:u", "measurement"), "sensor_delay", "output:x2", True),
        (
            effect("transient_force", "external:x1", "external_input"),
            "transient_force",
            "equation:x1",
            True,
        ),
        (effect("coulomb_friction", "equation:x1"), "stribeck_friction", "equation:x1", False),
    ],
)
def test_equivalent_causes(planted: dict, mechanism: str, site: str, right: bool) -> None:
    assert equivalent(mechanism, site, planted, case(planted)) is right


def test_equivalent_causes_have_right_verdicts() -> None:
    added = effect("added_mass", "equation:x1", twins=["p4"])
    assert right_verdicts(case(added)) == {"structure", "parameter"}
    assert right_verdicts(case(COULOMB)) == {"structure"}
    bias = effect("sensor_bias", "output:x2", "measurement")
    assert right_verdicts(case(bias)) == {"measurement", "structure"}
    assert right_verdicts(case(bias, springs=False)) == {"measurement"}
    assert right_verdicts(case(COULOMB, kind="collinear")) == {"structure", "undecided"}
    assert right_verdicts(case()) == {"nothing"}
    scale = case(effect("sensor_gain", "output:x2", "measurement"), sensors=[{}, {}])
    assert right_verdicts(scale) == {"measurement"}
    scale["evidence"]["indistinct"] = ["wrong_value of f1"]
    assert right_verdicts(scale) == {"measurement", "undecided"}


def test_several_effects_are_counted_one_by_one() -> None:
    both = case(COULOMB, effect("cubic_stiffness", "equation:x2"))
    mark = judge("a", both, answer("structure", ("cubic_stiffness", "equation:x2")))
    assert (mark.planted, mark.found, mark.mechanism_1) == (2, 1, True)


def test_detection_thresholds_are_those_of_the_curve() -> None:
    rng = np.random.default_rng(0)
    sizes = np.exp(rng.uniform(np.log(0.005), np.log(0.4), 4000))
    chance = 1 / (1 + np.exp(-3.0 * (np.log(sizes) - np.log(0.03))))
    found = thresholds(sizes.tolist(), (rng.uniform(size=4000) < chance).tolist())
    assert found is not None
    assert found["50 %"] == pytest.approx(0.03, rel=0.06)
    assert found["95 %"] == pytest.approx(0.03 * np.exp(2.944 / 3), rel=0.1)
    assert thresholds([0.1, 0.2], [True, True]) is None


def test_stated_probabilities_are_held_against_the_truth() -> None:
    marks: list[Mark] = []
    for k in range(10):
        name = "coulomb_friction" if k < 6 else "quadratic_drag"
        given = answer("structure", (name, "equation:x1"), probability=0.85 if k % 2 else 0.6)
        marks.append(judge(str(k), TRUTH["a"], given))
    rows = reliability(marks)
    assert [(r["from"], r["right"]["k"], r["right"]["n"]) for r in rows] == [
        (0.5, 3, 5),
        (0.8, 3, 5),
    ]
    curve = risk_coverage(marks)
    assert curve[-1] == (1.0, 0.4) and [c for c, _ in curve] == sorted(c for c, _ in curve)


def test_tables_and_figures_come_whole(tmp_path: Path) -> None:
    plan = {
        "cases": 4,
        "systems": ["two_mass"],
        "mechanisms": ["a"],
        "detectable": 3,
        "multibody": 4,
        "closed_loop": 0,
        "masked": 0,
    }
    document = {
        "plan": plan,
        "sealed": {"seed": 1, "truth_sha256": "ab"},
        "methods": {"jaxsr": scores(PERFECT), "other": scores({})},
    }
    text = markdown(document)
    assert "| mechanism, first answer | 100 % [44, 100] (3/3) | 0 % [0, 56] (0/3) |" in text
    assert "| a | structure | coulomb_friction at equation:x1 |" in text
    draw(document, tmp_path)
    names = {"risk_coverage.png", "reliability.png", "detection.png"}
    assert {p.name for p in tmp_path.iterdir()} == names


DATED = {20261128}
"""Seeds of sets that were drawn by their day; all others are the digits of the frozen commit."""


def test_the_sets_of_the_record_add_up_and_end_with_the_score_beside_them() -> None:
    rows = json.loads(SETS.read_text())
    assert len({row["seed"] for row in rows}) == len(rows)
    for row in rows:  # the seed is the first 8 hex digits of the frozen commit
        assert row["seed"] in DATED or f"{row['seed']:08x}".startswith(row["commit"][:8])
    # the score beside them is that of the last set of a hundred
    full = [row for row in rows if row["cases"] >= 100][-1]
    score = json.loads((SETS.parent / "score.json").read_text())
    assert row_of(score, full["commit"]) == full
    total = pooled(rows)["verdict"]
    assert (total.k, total.n) == tuple(
        sum(row["counts"]["verdict"][key] for row in rows) for key in ("k", "n")
    )
