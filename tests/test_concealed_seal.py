"""Sealing planted cases: shares, determinism, guards, and what the likelihood-ratio test says."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.concealed.detectability import Setting, weigh
from benchmarks.concealed.effects import FAMILY
from benchmarks.concealed.plan import SYSTEMS, TRAPS, Ticket, deal
from benchmarks.concealed.planting import plant
from benchmarks.concealed.running import cases, run, run_baseline
from benchmarks.concealed.scoring import open_truth
from benchmarks.concealed.sealing import seal, seal_case, seed_of, sha256
from jaxsr._result import InputError
from jaxsr.models import read_model
from jaxsr.recordings import read_recording


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("count", [100, 300])
def test_shares_are_as_promised(seed: int, count: int) -> None:
    tickets = deal(seed, count)
    assert len(tickets) == count
    assert 3 * sum(SYSTEMS[t.system].multibody for t in tickets) >= count
    assert 4 * sum(t.closed for t in tickets) >= count
    assert 3 * sum(t.kind in TRAPS for t in tickets) >= count
    assert {t.kind for t in tickets} >= set(TRAPS)
    mechanisms = {t.mechanism for t in tickets} - {""}
    assert len(mechanisms) >= 25 and {FAMILY[m] for m in mechanisms} == set(FAMILY.values())
    assert len({t.system for t in tickets}) >= 8
    sizes = np.log([t.size for t in tickets if t.kind != "below_noise"])
    assert np.log(0.005) <= sizes.min() and sizes.max() <= np.log(0.4)
    # log-uniform: the middle half of the range holds about half of the sizes
    middle = np.abs(sizes - np.log(0.005 * 0.4) / 2) < np.log(0.4 / 0.005) / 4
    assert middle.mean() == pytest.approx(0.5, abs=0.17)


def test_cases_are_the_same_for_the_same_seed() -> None:
    assert deal(5, 60) == deal(5, 60) and deal(5, 60) != deal(6, 60)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("mujoco")
    place = tmp_path_factory.mktemp("cases")
    seal(11, 3, place, tiny=True)
    return place


@pytest.mark.long
def test_a_case_is_the_same_for_the_same_seed(folder: Path, tmp_path: Path) -> None:
    ticket = deal(11, 3)[0]
    seal_case(11, ticket, tmp_path, tiny=True)
    part = json.loads((tmp_path / "truth" / "parts" / f"{ticket.name}.json").read_text())
    assert part == open_truth(folder)[ticket.name]
    sealed = json.loads((folder / "sealed.json").read_text())
    files = [f for f in (tmp_path / "cases").rglob("*.*") if f.is_file()]
    assert files
    for file in files:
        assert sha256(file) == sealed["files_sha256"][str(file.relative_to(tmp_path))]


def test_a_folder_holds_one_set_of_cases(folder: Path) -> None:
    digest = json.loads((folder / "sealed.json").read_text())["truth_sha256"]
    assert seal(11, 3, folder, tiny=True) == digest
    with pytest.raises(InputError, match="other cases"):
        seal(12, 3, folder, tiny=True)


def test_a_case_is_what_the_command_takes_and_tells_nothing(folder: Path) -> None:
    for name in cases(folder):
        place = folder / "cases" / name
        given = json.loads((place / "case.json").read_text())
        model = read_model(place / given["model"])
        assert len(given["data"]) >= 3 and not set(given["data"]) & set(given["held_out"])
        assert model.free_parameters and set(model.resolution) == set(model.outputs)
        for file in given["data"] + given["held_out"]:
            recording = read_recording(place / file, time=model.columns["t"])
            assert {*model.inputs, *model.outputs} <= set(recording.channels)
        text = "".join(p.read_text() for p in place.glob("*.*"))
        for word in (*FAMILY, *SYSTEMS, "trap"):
            assert word not in text
        for parameter in model.parameters.values():
            if parameter.bounds:
                assert parameter.bounds[0] < parameter.value < parameter.bounds[1]


def test_the_truth_is_apart_and_guarded(folder: Path) -> None:
    truth = open_truth(folder)
    assert sorted(truth) == cases(folder)
    path = folder / "truth" / "truth.json"
    text = path.read_text()
    path.write_text(text.replace("true", "false", 1))
    with pytest.raises(InputError, match="not the truth that was sealed"):
        open_truth(folder)
    path.write_text(text)
    model = folder / "cases" / "c0001" / "model.toml"
    text = model.read_text()
    model.write_text(text + "\n")
    for guarded in (open_truth, cases):
        with pytest.raises(InputError, match="changed after sealing"):
            guarded(folder)
    model.write_text(text)
    assert open_truth(folder) == truth


def test_the_runner_does_nothing_twice(folder: Path) -> None:
    asked: list[str] = []

    def idle(place: Path) -> dict:
        asked.append(place.name)
        if place.name == "c0002":
            raise ValueError("no answer")
        return {"verdict": "nothing", "findings": []}

    assert run(folder, 1.0, baselines={"idle": idle}) == 3
    assert run(folder, 1.0, baselines={"idle": idle}) == 0
    assert run(folder, 1.0, again=True, baselines={"idle": idle}) == 1
    assert asked == ["c0001", "c0002", "c0003", "c0002"]
    report = run_baseline(folder, "idle", "c0002", idle)
    assert report["status"] == 1 and "no answer" in report["stderr"]


def test_seeds() -> None:
    assert seed_of("17") == 17
    with pytest.raises(InputError, match="whole number or commit"):
        seed_of("x")


def weighed(
    mechanism: str, kind: str, size: float, seed: int, system: str = "oscillator", fixed=()
):
    ticket = Ticket(1, kind, mechanism, system, 0, False, size)
    planted = plant(np.random.default_rng(seed), ticket, tiny=True)
    limits = {n: (0.3 * x, 3.0 * x) for n, x in planted.p.items() if n not in fixed}
    setting = Setting(
        planted.system,
        planted.p,
        planted.effects,
        planted.sensors,
        planted.design,
        planted.recorded,
        limits,
        planted.p,
    )
    return planted, weigh(setting)[0]


@pytest.mark.long
@pytest.mark.parametrize(
    "mechanism", ["coulomb_friction", "actuator_lag", "clipping", "hysteresis"]
)
def test_the_oracle_leaves_noise_and_rejects_recalibration(mechanism: str) -> None:
    kind = "sensor" if mechanism == "clipping" else "structure"
    planted, evidence = weighed(mechanism, kind, 0.2, 3)
    assert planted.sizes[0] == pytest.approx(0.2, rel=0.03)
    assert evidence.detectable and evidence.innovation == pytest.approx(1.0, abs=0.1)
    assert evidence.oracle[-1] < 0.7 * evidence.recalibrated[-1]
    assert len(evidence.horizons) == len(evidence.oracle) >= 3


@pytest.mark.long
def test_nothing_is_not_detected() -> None:
    for seed in range(3):
        _, evidence = weighed("", "nothing", 0.1, seed)
        assert not evidence.detectable and evidence.p == 1.0
        assert evidence.innovation == pytest.approx(1.0, abs=0.08)


def test_what_calibration_absorbs_is_not_detectable() -> None:
    _, evidence = weighed("added_mass", "structure", 0.2, 4)
    assert not evidence.detectable and evidence.absorbed


@pytest.mark.slow
def test_scales_that_imitate_each_other_are_known() -> None:
    """A tank's level on another scale is a tank with another outlet; a swing has its own time."""
    _, tanks = weighed("sensor_gain", "sensor", 0.2, 3, "tanks", fixed=("f1", "f2"))
    assert tanks.detectable and "wrong_value of f1" in tanks.indistinct
    _, pendulum = weighed("sensor_gain", "sensor", 0.2, 3, "double_pendulum", fixed=("m1",))
    assert pendulum.detectable and pendulum.indistinct == ()


@pytest.mark.long
def test_effects_below_the_noise_are_made_undetectable(tmp_path: Path) -> None:
    ticket = Ticket(1, "below_noise", "coulomb_friction", "oscillator", 0, False, 0.008)
    seal_case(5, ticket, tmp_path, tiny=True)
    part = json.loads((tmp_path / "truth" / "parts" / "c0001.json").read_text())
    assert not part["evidence"]["detectable"] and 0 < part["effects"][0]["size"] <= 0.008


@pytest.mark.slow
def test_a_lag_far_shorter_than_a_sample_is_weighed_like_any_other(tmp_path: Path) -> None:
    """One percent of an arm's force in closed loop is a lag of a few hundredths of a sample."""
    ticket = deal(0x5A100985, 110)[71]
    assert (ticket.mechanism, ticket.system, ticket.closed) == ("actuator_lag", "arm", True)
    assert seal_case(0x5A100985, ticket, tmp_path) == ticket.name
