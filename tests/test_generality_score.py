"""The generality benchmark's cases and scores: seeds, detectability, groups, calibration."""

from __future__ import annotations

import json
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.concealed.rates import Rate
from benchmarks.generality import engines, running
from benchmarks.generality.calibration import summary, uniformity
from benchmarks.generality.detect import detectable, shown
from benchmarks.generality.laws import FAMILIES, LAWS
from benchmarks.generality.plan import DECK, Ticket, dealt, offered
from benchmarks.generality.plant import LEAD, Effect, Plant, excited, readings
from benchmarks.generality.planting import planted
from benchmarks.generality.prior import truncated
from benchmarks.generality.running import answers
from benchmarks.generality.scoring import (
    by_chance,
    calibration_error,
    common,
    misses,
    scored,
    settled_on,
    table,
)
from benchmarks.generality.sensing import SENSING, Channel
from benchmarks.generality.systems import GROUPS, SYSTEMS
from benchmarks.generality.tables import by_group, missed, side_by_side
from benchmarks.generality.writing import written
from jaxsr._result import InputError

# -- the plan --------------------------------------------------------------------------------------


def test_there_is_breadth() -> None:
    assert len(SYSTEMS) >= 16 and len(GROUPS) == len({s.group for s in SYSTEMS.values()}) == 11
    assert len(SENSING) >= 5 and len(FAMILIES) == 8
    assert {len(s.states) // 2 for s in SYSTEMS.values() if s.group == "structures"} == {5, 8, 20}


def test_tickets_are_spread_evenly_and_have_a_place() -> None:
    tickets = dealt(3, 8)
    assert len({t.name for t in tickets}) == len(tickets) == 8 * len(SYSTEMS)
    assert all(t.family in offered(t.system) for t in tickets)
    sensing, families = (Counter(getattr(t, k) for t in tickets) for k in ("sensing", "family"))
    assert min(sensing.values()) > 0.7 * len(tickets) / len(SENSING)
    assert min(families[f] for f in FAMILIES) > 0.7 * len(tickets) * 2 / len(DECK)
    assert tickets == dealt(3, 8) != dealt(4, 8)
    # a longer plan begins as a shorter one
    assert dealt(3, 2) == tickets[: 2 * len(SYSTEMS)]


# -- cases -----------------------------------------------------------------------------------------

SMALL = Ticket("small", "dc_motor", "lost", "drag")


def files_of(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted(folder.iterdir())}


@pytest.mark.long
def test_a_seed_gives_the_same_files(tmp_path: Path) -> None:
    for name in ("one", "two"):
        written(planted(SMALL, 7, SYSTEMS["dc_motor"], 120), tmp_path / name, 7)
    written(planted(SMALL, 8, SYSTEMS["dc_motor"], 120), tmp_path / "other", 8)
    one, two, other = (files_of(tmp_path / n) for n in ("one", "two", "other"))
    assert one == two
    assert all(one[n] != other[n] for n in ("model.toml", "run1.csv", "truth.json"))


@pytest.mark.long
def test_a_planted_case_says_what_it_is(tmp_path: Path) -> None:
    case = planted(SMALL, 7, SYSTEMS["dc_motor"], 120)
    written(case, tmp_path, 7)
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["groups"] == {"system": "drives", "sensing": "lost", "mechanism": "drag"}
    effect, evidence = truth["effects"][0], truth["evidence"]
    assert effect["site"] == "equation:w" and effect["verdict"] == "structure"
    assert 0.0 < effect["size"] < 0.8 and evidence["in_noise"] > 0.0
    # force units: the effect's rms in that of the torque that accelerates the rotor
    track = case.moved[0][0]
    both = np.concatenate([t.x[0] for t, _ in case.moved[:2]])
    net = np.concatenate([t.dx[0] for t, _ in case.moved[:2]]) * truth["constants"]["J"]
    constants = effect["values"]
    power = constants.get("p", 2.0)
    force = constants["kd"] * np.abs(both) ** power
    share = np.sqrt(np.mean(force**2) / np.mean(net**2))
    assert share == pytest.approx(effect["size"], rel=1e-6)
    assert track.time.size == 120


def test_wrong_values_are_told_from_those_that_do_the_same() -> None:
    case = planted(Ticket("x", "longitudinal", "white", "wrong_value"), 1, SYSTEMS["longitudinal"])
    effect = case.truth["effects"][0]
    name = effect["site"].removeprefix("parameter:")
    assert case.given[name] != case.ground.constants[name]
    assert sum(case.given[n] != v for n, v in case.ground.constants.items()) == 1


# -- what sensors can show -------------------------------------------------------------------------


def noncentrality(effect: Effect | None, free: list[str], sigma: float, **given: float) -> float:
    system = SYSTEMS["voice_coil"]
    constants = system.drawn(np.random.default_rng(2))
    time = system.dt * np.arange(-LEAD, 200)
    signal = excited(np.random.default_rng(3), system.drives, time, system.hold, 0)
    track, y = readings(Plant(system, constants, effect), signal, system.gauges, time[LEAD:])
    channels = [Channel(sigma * row.std()) for row in y]
    changed = constants | {n: constants[n] * v for n, v in given.items()}
    run = signal, track, y, np.ones(y.shape, bool)
    return shown(system, changed, system.gauges, channels, [run]).left(free)


@pytest.mark.long
def test_what_a_free_constant_absorbs_is_not_seen() -> None:
    damping = Effect(LAWS["viscous_damping"], (0,), {"Fv": 0.05})
    without, beside = (noncentrality(damping, f, 0.003) for f in ([], ["Rm"]))
    assert without > 300.0 and beside < 1e-3 * without
    cubic = Effect(LAWS["cubic_stiffness"], (0,), {"k3": 3e8})
    assert noncentrality(cubic, ["Rm", "Cm", "Re"], 0.003) > 50.0


def test_nothing_is_seen_where_nothing_is_planted() -> None:
    assert noncentrality(None, [], 0.003) < 1e-3


@pytest.mark.long
def test_noncentrality_falls_with_the_square_of_the_noise() -> None:
    wrong = [noncentrality(None, ["Rm"], s, Cm=1.02) for s in (0.003, 0.006)]
    assert wrong[0] == pytest.approx(4.0 * wrong[1], rel=1e-6)
    assert not detectable(5.0, 1) and detectable(20.0, 1)


# -- scores ----------------------------------------------------------------------------------------


def truth_of(system: str, sensing: str, size: float = 0.2) -> dict[str, Any]:
    effect = {"mechanism": "coulomb_friction", "site": "equation:v", "sites": ["equation:v"],
              "family": "friction", "verdict": "structure", "size": size,
              "values": {"Fc": 2.0}, "unchecked": [], "twins": []}  # fmt: skip
    evidence = {"detectable": True, "absorbed": False, "horizons": [1.0], "recalibrated": [0.5],
                "oracle": [0.1], "indistinct": []}  # fmt: skip
    return {"groups": {"system": system, "sensing": sensing, "mechanism": "friction"},
            "system": f"a_{system}", "kind": "single", "effects": [effect], "evidence": evidence,
            "turning": [], "springs": [], "sensors": ["y1", "y2"]}  # fmt: skip


def answer(mechanism: str, probability: float) -> dict[str, Any]:
    fit = {"horizons_s": [1.0], "headline_s": 1.0,
           "held_out": {"recalibrated": [0.5], "explained": [0.2]}}  # fmt: skip
    constants = {"Fc": {"value": 2.1, "ci95": [1.9, 2.3]}}
    finding = {"site": "equation:v", "mechanism": mechanism, "probability": probability,
               "alternatives": [], "parameters": constants}  # fmt: skip
    return {"verdict": "structure", "findings": [finding], "fit": fit}


def row(case: str, said: dict[str, Any] | None, broke: str = "") -> dict[str, Any]:
    return {"case": case, "engine": "evidence", "answer": said, "broke": broke, "seconds": 2.0,
            "cpu_seconds": 1.0}  # fmt: skip


SETTLED = {"system": ["arms", "drives/a_drives"], "sensing": ["white"], "mechanism": ["friction"]}


def test_scores_stand_side_by_side() -> None:
    truths = {"a": truth_of("arms", "white"), "b": truth_of("linkages", "white"),
              "c": truth_of("arms", "rates"), "d": truth_of("drives", "white")}  # fmt: skip
    rows = [row("a", answer("coulomb_friction", 0.99)), row("b", answer("drift", 0.98)),
            row("c", None, "KeyError: x"), row("d", answer("coulomb_friction", 0.7))]  # fmt: skip
    items = scored(truths, rows, SETTLED)
    assert [i.in_group for i in items] == [True, False, False, True]
    found = table(items)["evidence"]
    assert found["in-group"]["mechanism_first"] == Rate(2, 2)
    assert found["out-of-group"]["mechanism_first"] == Rate(0, 2)
    assert found["out-of-group"]["verdict"] == Rate(1, 2)
    assert found["out-of-group"]["crashes"] == Rate(1, 2)
    assert found["out by sensing"]["cases"] == 1
    assert found["all"]["right_where_sure"] == Rate(1, 2)
    assert found["all"]["interval_coverage"] == Rate(2, 2)
    assert found["in-group"]["gap_closed_median"] == pytest.approx(0.75)
    wrong = misses(items)
    assert [w["case"] for w in wrong] == ["b", "c"]
    assert "drift at equation:v" in missed(wrong) and "KeyError" in missed(wrong)
    text = side_by_side({"evidence": found})
    assert "| mechanism, first | 100 % (2/2) | 0 % (0/2) | +100 |" in text
    assert "system: linkages" in by_group({"evidence": found})


def test_engines_are_compared_on_what_all_of_them_answered() -> None:
    truths = {n: truth_of("arms", "white") for n in "ab"}
    rows = [row("a", answer("drift", 0.5)), row("b", answer("drift", 0.5)),
            row("a", answer("drift", 0.5)) | {"engine": "diagnosis"}]  # fmt: skip
    items = common(scored(truths, rows, SETTLED))
    assert [(i.engine, i.mark.case) for i in items] == [("evidence", "a"), ("diagnosis", "a")]


def test_below_detection_nothing_is_right() -> None:
    truth = truth_of("arms", "white")
    truth["evidence"] |= {"detectable": False}
    items = scored({"a": truth}, [row("a", {"verdict": "nothing", "findings": []})], SETTLED)
    assert items[0].mark.verdict_right and not misses(items)


def test_calibration_error_counts_what_is_too_sure() -> None:
    assert calibration_error([(0.75, True)] * 3 + [(0.75, False)]) == pytest.approx(0.0)
    assert calibration_error([(0.99, False)] * 2) == pytest.approx(0.99)
    assert calibration_error([(1.0, True), (0.05, False)]) == pytest.approx(0.025)
    assert calibration_error([]) is None


def test_calibration_error_by_chance_is_what_right_probabilities_have() -> None:
    """Of few findings it is far from none; of probabilities that are right one in 20 has more."""
    rng = np.random.default_rng(1)
    for count in (40, 400):
        p = rng.uniform(0.5, 1.0, count)
        bound = by_chance([*p])
        assert bound is not None
        right = rng.random((300, count)) < p
        errors = [calibration_error([*zip(p, row, strict=True)]) for row in right]
        more = np.mean([e is not None and e > bound for e in errors])
        assert 0.01 <= more <= 0.12  # 0.05, beside the spread of 400 and of 300 draws
    assert by_chance([1.0] * 9) == 0.0
    assert by_chance([]) is None


def test_groups_that_were_settled_on_are_groups_of_the_benchmark() -> None:
    known = settled_on()
    assert set(known["system"]) <= {s.group for s in SYSTEMS.values()}
    assert set(known["sensing"]) <= set(SENSING)
    assert set(known["mechanism"]) <= {*FAMILIES, "nothing", "wrong_value"}
    # there is something to be held out
    assert len(known["system"]) < 8


def test_the_last_answer_of_a_case_counts(tmp_path: Path) -> None:
    lines = [row("a", None, "broke"), row("b", None), row("a", answer("drift", 0.5))]
    (tmp_path / "answers.jsonl").write_text("".join(json.dumps(r) + "\n" for r in lines))
    assert [r["broke"] for r in answers(tmp_path)] == ["", ""]


def test_a_run_keeps_every_answer_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def engine(folder: Path, budget: float) -> dict[str, Any]:
        asked.append(folder.name)
        if folder.name == "b":
            raise KeyError("x")
        return {"verdict": "nothing", "findings": [], "latent": float("nan")}

    monkeypatch.setitem(engines.ENGINES, "evidence", engine)
    monkeypatch.setattr(running, "made", lambda ticket, seed, out: ticket.name)
    tickets = [Ticket(n, "dc_motor", "white", "nothing") for n in "ab"]
    running.run(tmp_path, 1, tickets[:1], ["evidence"], 1.0)
    running.run(tmp_path, 1, tickets, ["evidence"], 1.0)
    assert asked == ["a", "b"]
    first, second = answers(tmp_path)
    assert first["answer"]["verdict"] == "nothing" and first["answer"]["latent"] is None
    assert second["answer"] is None and second["broke"].startswith("KeyError: 'x' (")


def test_a_folder_is_that_of_one_seed(tmp_path: Path) -> None:
    running.begun(tmp_path, 1)
    running.begun(tmp_path, 1)
    with pytest.raises(InputError, match="another seed"):
        running.begun(tmp_path, 2)


# -- simulation-based calibration ------------------------------------------------------------------


def test_uniform_ranks_pass_and_narrow_posteriors_do_not() -> None:
    rng = np.random.default_rng(0)
    assert uniformity(list((np.arange(500) + 0.5) / 500))["p"] > 0.99
    assert uniformity(list(0.5 + 0.5 * rng.choice([-1, 1], 500)))["p"] < 1e-6
    assert uniformity([])["count"] == 0


def test_priors_keep_to_their_bounds() -> None:
    rng = np.random.default_rng(0)
    drawn = np.array([truncated(rng, 0.0, 1.0, 0.0, 1e12) for _ in range(4000)])
    assert drawn.min() >= 0.0
    assert drawn.mean() == pytest.approx(np.sqrt(2.0 / np.pi), rel=0.05)


def test_summaries_compare_stated_and_true() -> None:
    def plant(truth: str, labels: dict[str, float], empty: float) -> dict[str, Any]:
        leader = [k for k, p in labels.items() if p > empty]
        return {"plant": 0, "broke": "", "cpu_seconds": 1.0, "truth": truth, "labels": labels,
                "empty": empty, "leader": leader, "ranks": {"given:c": 0.3}}  # fmt: skip

    rows = [plant("", {}, 1.0), plant("a@b", {"a@b": 0.9}, 0.1), plant("", {"a@b": 0.9}, 0.1)]
    found = summary(rows)
    assert found["weighed"] == 3 and found["ranks_given"]["count"] == 3
    top = next(b for b in found["leading"]["bins"] if b["from"] == 0.9)
    assert (top["right"]["k"], top["right"]["n"]) == (2, 3)


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_is_planted_somewhere(family: str) -> None:
    for name in ("cart_pendulum", "voice_coil"):
        ticket = Ticket(f"{name}-{family}", name, "white", family)
        case = planted(replace(ticket), 3, SYSTEMS[name])
        assert case.truth["effects"][0]["family"] == family
        assert case.truth["evidence"]["detectable"]
