"""Long and many recordings: searched on a part, estimated and run on everything."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter, lsim

from jaxsr._progress import Budget
from jaxsr.diagnosis import diagnose, thinning
from jaxsr.diagnosis.explaining import whole_runs as explaining_runs
from jaxsr.diagnosis.explaining.whole_runs import whole_horizons, whole_runs
from jaxsr.diagnosis.judging import whole as judging_whole
from jaxsr.diagnosis.judging.refine import Ground, refine
from jaxsr.diagnosis.judging.whole import chunks, over_all
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.memory import actuator_lags
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import build_arena, neutral_values
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.reduced import lean
from jaxsr.diagnosis.shooting.scoring import free_run
from jaxsr.diagnosis.thinning import MOST, Whole, prepare_search, spread
from jaxsr.models import Simulator, model_text, parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, build_segments
from jaxsr.recordings import Recording, write_csv

MODEL = parse_model("""
[model]
name = "oscillator"
time = "t"
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u - c*v - k*q"
[readings]
y = "q"
[parameters]
c = { value = 0.5, bounds = [0.0, 5.0] }
k = { value = 19.0, bounds = [5.0, 60.0] }
[initial]
q = 0.0
v = 0.0
""")
NOISE = 1e-3


def recording(samples: int, step: float = 0.02, seed: int = 0, name: str = "r.csv") -> Recording:
    """A driven oscillator with c = 0.4 and k = 20, from rest."""
    rng = np.random.default_rng(seed)
    time = np.arange(samples) * step
    u = np.sin(np.outer(time, rng.uniform(1.0, 8.0, 6)) + rng.uniform(0, 6.28, 6)).sum(1)
    y = lsim(([1.0], [1.0, 0.4, 20.0]), u, time)[1]
    return Recording(name, time, {"u": u, "y": y + NOISE * rng.normal(size=samples)})


def test_what_a_search_can_work_on_is_left_alone():
    short = recording(MOST // 2)
    prepared, whole = prepare_search(MODEL, [short])
    assert whole is None and prepared[0].recording is short and prepared[0].begins


def test_a_long_recording_becomes_stretches_of_itself(monkeypatch):
    monkeypatch.setattr(thinning, "MOST", 12_000)
    every = recording(60_000)
    prepared, whole = prepare_search(MODEL, [every])
    assert whole is not None and whole.samples == 60_000 and whole.factor == 1
    assert sum(p.time.size for p in prepared) * 2 <= 1.05 * 12_000
    assert [p.recording.name for p in prepared] == ["r.csv"] * len(prepared)
    starts = [np.searchsorted(every.time, p.time[0]) for p in prepared]
    assert [p.begins for p in prepared] == [s == 0 for s in starts]
    for start, p in zip(starts, prepared, strict=True):
        own = every.channels["y"][start : start + p.time.size]
        np.testing.assert_array_equal(p.outputs[:, 0], own)
    assert np.ptp(starts) > 0.9 * 60_000 - 1_000  # all along


def test_a_stretch_out_of_a_recording_begins_anywhere():
    """[initial] holds where the experiment begins, and no sensor speaks for it there."""
    every = recording(3_000)
    rows = [(0, 0, 500)]
    begin = Prepared.build(MODEL, every)
    part = Prepared.build(MODEL, every.select(slice(1000, 2000)), begins=False)
    assert begin.states.values[0] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert np.abs(part.states.values[0]).max() > 1e-3
    assert not build_segments(MODEL, [begin], rows, 1).free_start.any()
    assert build_segments(MODEL, [part], rows, 1).free_start.all()


def test_a_rare_regime_is_among_the_stretches(monkeypatch):
    """One of 60 pieces swings ten times as far."""
    monkeypatch.setattr(thinning, "MOST", 12_000)
    every = recording(60_000)
    u = every.channels["u"].copy()
    u[25_000:26_000] *= 10.0
    loud = replace(every, channels={**every.channels, "u": u})
    prepared, _ = prepare_search(MODEL, [loud])
    assert any(np.abs(p.inputs).max() > 30.0 for p in prepared)


def test_many_recordings_become_few():
    many = [recording(500, seed=s, name=f"{s}.csv") for s in range(200)]
    prepared, whole = prepare_search(MODEL, many)
    assert whole is not None and len(whole.recordings) == 200
    assert 10 <= len(prepared) <= thinning.STRETCHES[1]
    assert all(p.begins and p.time.size == 500 for p in prepared)


@pytest.mark.long
def test_samples_that_follow_each_other_too_fast_become_fewer(monkeypatch):
    """1 kHz for a motion of 0.7 Hz."""
    monkeypatch.setattr(thinning, "MOST", 12_000)
    prepared, whole = prepare_search(MODEL, [recording(30_000, step=1e-3)])
    assert whole is not None and whole.factor >= 3
    assert np.median(np.diff(prepared[0].time)) == pytest.approx(1e-3 * whole.factor)


TANK = parse_model(
    """
[model]
states = ["h"]
inputs = ["u"]
outputs = ["y"]
input_hold = "zero"
[equations]
h = "u - k*h"
[readings]
y = "h"
[parameters]
k = { value = 0.02, bounds = [0.001, 1.0] }
"""
)


def test_fast_small_ripple_of_a_sensor_does_not_cut_a_slow_level_to_pieces(monkeypatch):
    """A level of 50 s under a filtered sensor at 100 Hz: one in many samples tells its course."""
    monkeypatch.setattr(thinning, "MOST", 20_000)
    rng, time = np.random.default_rng(0), 0.01 * np.arange(40_000)
    u = np.where(time < 2.0, 0.02, 0.04)
    level = 1.0 + np.where(time < 2.0, 0.0, 1.0 - np.exp(-0.02 * (time - 2.0)))
    ripple = lfilter([1.0], [1.0, -0.995], rng.normal(size=time.size))
    ripple = lfilter([0.02], [1.0, -0.98], ripple)
    y = level + 0.005 * ripple / np.std(ripple)
    prepared, whole = prepare_search(TANK, [Recording("t.csv", time, {"u": u, "y": y})])
    assert whole is not None and whole.factor >= 8
    assert sum(np.ptp(p.time) for p in prepared) > 0.9 * np.ptp(time)


def test_rows_are_spread_and_far_apart():
    rng = np.random.default_rng(0)
    features = rng.normal(size=(100, 3))
    features[37] += 20.0
    chosen = spread(features, 10)
    assert len(set(chosen)) == 10 and 37 in chosen and chosen[0] == 0 and chosen[-1] == 99
    assert spread(features[:4], 10) == [0, 1, 2, 3]


@cache
def searched():
    """An arena on three stretches of a recording of 24,000 samples, and everything."""
    every = recording(24_000)
    pieces = [(2_000, 4_000), (9_000, 11_000), (20_000, 22_000)]
    prepared = tuple(
        Prepared.build(MODEL, every.select(slice(a, b)), begins=False) for a, b in pieces
    )
    # mechanisms that are not in the set are left out of the chunks
    others = [c for c in force_candidates(MODEL, {}) if c.mechanism == "cubic_stiffness"]
    lag = next(iter(actuator_lags(MODEL, 0.02)))
    super_model = SuperModel.build(MODEL, [*others, lag])
    setting = Stepping("rk4", 1), 4.0, np.array([NOISE]), Simulator(super_model.model)
    arena = build_arena(super_model, prepared, *setting)
    estimate = refine(
        Ground(arena, prepared, (4.0,), None), enter(arena, (), neutral_values(super_model)), False
    )
    return arena, estimate, Whole(MODEL, (every,), 1, 6_000)


def test_an_estimate_over_chunks_is_that_of_everything_at_once(monkeypatch):
    """With the intervals of all samples, half as wide as those of a quarter of them."""
    monkeypatch.setattr(judging_whole, "MOST", 8_000)
    arena, estimate, whole = searched()
    assert len(chunks(whole)) == 6
    found = over_all(whole, estimate, lambda: False)
    setting = arena.problem.stepping, 4.0, arena.problem.scale, arena.problem.simulator
    once = build_arena(arena.super_model, (Prepared.build(MODEL, whole.recordings[0]),), *setting)
    together = enter(once, (), neutral_values(arena.super_model))
    c, k = (list(arena.super_model.model.parameters).index(n) for n in ("c", "k"))
    theta, half = found.theta[[c, k]], found.half[[c, k]]
    assert (np.abs(theta - together.fit.theta[[c, k]]) < 0.05 * half).all() and found.share == 1.0
    assert (half < 0.75 * estimate.half[[c, k]]).all()
    assert (np.abs(theta - [0.4, 20.0]) < 2.0 * half).all()


def test_short_recordings_are_worked_on_together():
    many = tuple(recording(500, seed=s, name=f"{s}.csv") for s in range(200))
    found = chunks(Whole(MODEL, many, 1, 0))
    assert len(found) == 4 and sum(len(p) for chunk in found for p in chunk) == 100_000
    assert {p.recording for chunk in found for p in chunk} == set(range(200))


def test_time_that_ends_leaves_an_estimate_spread_over_the_recording(monkeypatch):
    monkeypatch.setattr(judging_whole, "MOST", 8_000)
    _, estimate, whole = searched()
    entered: list[int] = []

    def counted(*given):
        entered.append(1)
        return enter(*given)

    monkeypatch.setattr(judging_whole, "enter", counted)
    found = over_all(whole, estimate, lambda: len(entered) == 2)
    assert 0.0 <= found.share < 0.5
    order = [piece.first for (piece,) in chunks(whole)]
    assert abs(order[1] - order[0]) > 8_000  # not one after the other
    assert over_all(whole, estimate, lambda: True) is estimate


def test_runs_in_pieces_are_the_runs_of_the_whole(monkeypatch):
    monkeypatch.setattr(judging_whole, "MOST", 8_000)
    arena, estimate, whole = searched()
    own = lean(arena.super_model, arena.problem.simulator, arena.problem.stepping, ())
    horizons = whole_horizons(whole, [2.0, 8.0, 40.0])
    assert horizons == [2.0, 8.0, 40.0, pytest.approx(479.98)]
    never = (lambda: False, lambda: False)
    runs = whole_runs(whole, {"given": (own, estimate.theta)}, horizons, 8.0, never)
    item = (Prepared.build(MODEL, whole.recordings[0]),)
    assert runs.share == 1.0
    for horizon, run in zip(horizons, runs.models["given"], strict=True):
        length = None if horizon == horizons[-1] else horizon
        known = free_run(own.simulator, own.stepping, item, estimate.theta[own.parameters], length)
        assert run.nrmse == pytest.approx(known.nrmse, rel=0.1)
        if horizon == 8.0:
            apart = run.simulated[0] - known.simulated[0]
            assert np.sqrt(np.nanmean(apart**2)) < 0.2 * NOISE
        else:
            assert run.simulated == []


def test_runs_over_whole_recordings_end_with_their_time(monkeypatch):
    monkeypatch.setattr(judging_whole, "MOST", 8_000)
    arena, estimate, whole = searched()
    own = lean(arena.super_model, arena.problem.simulator, arena.problem.stepping, ())
    stops = (lambda: True, lambda: True)
    runs = whole_runs(whole, {"given": (own, estimate.theta)}, [2.0, 479.98], 2.0, stops)
    short, long = runs.models["given"]
    assert np.isfinite(short.nrmse) and np.isnan(long.nrmse)
    items = (Prepared.build(MODEL, whole.recordings[0].select(slice(0, 400))),)
    asked = iter([False, True])
    ended = own.free_run(items, estimate.theta, None, stop=lambda: next(asked, True))
    assert np.isnan(ended.nrmse)
    assert np.isfinite(own.free_run(items, estimate.theta, None).nrmse)  # which is not kept


@pytest.mark.slow
def test_a_diagnosis_of_thinned_data_speaks_of_the_whole(monkeypatch, tmp_path):
    """Coulomb friction left out; times, errors and checksums are those of the recording."""
    for module in (thinning, judging_whole, explaining_runs):
        monkeypatch.setattr(module, "MOST", 6_000)
    monkeypatch.setattr(thinning, "LEAST", 2_000)
    every = sliding(12_000)
    write_csv(sliding(8_000, seed=1), tmp_path / "held.csv")
    (tmp_path / "cart.toml").write_text(model_text(MODEL))
    given, held = Simulator.from_file(tmp_path / "cart.toml"), tmp_path / "held.csv"
    found = diagnose(given, [every], held_out=[held], seed=0, budget=Budget(120.0))
    assert found.findings[0]["mechanism"] == "coulomb_friction"
    fc = next(iter(found.findings[0]["parameters"].values()))
    assert fc["ci95"][0] - 0.02 < 0.3 < fc["ci95"][1] + 0.02
    assert found.findings[0]["where"]["times"] == [[every.time[0], every.time[-1]]]
    assert found.findings[0]["where"]["recordings"] == ["r.csv"]
    fit = found.fit
    assert fit["horizons_s"][-1] == pytest.approx(every.time[-1])
    assert all(len(v) == len(fit["horizons_s"]) for v in fit["train"].values())
    assert fit["train"]["explained"][-1] < 0.5 * fit["train"]["recalibrated"][-1]
    assert fit["held_out"]["files"] == ["held.csv"]
    told = {**fit["held_out"]["sha256"], **found.document["provenance"]["model_sha256"]}
    files = [tmp_path / name for name in ("held.csv", "cart.toml")]
    assert told == {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in files}
    remark = next(c for c in found.document["data_checks"] if c["check"] == "thinned")
    assert "of 12000 samples" in remark["message"] and remark["file"] == "r.csv"
    assert list(found.document["provenance"]["data_sha256"]) == ["r.csv"]
    assert {t.recording for t in found.evidence.trajectories} == {"r.csv", "held.csv"}
    assert (found.save(tmp_path / "out") / "report.html").exists()


def sliding(samples: int, seed: int = 0) -> Recording:
    """The oscillator with Coulomb friction of 0.3 beside."""
    rng, step, sub = np.random.default_rng(seed), 0.02, 10
    time = np.arange(samples) * step
    fine = np.arange(samples * sub) * step / sub
    rates, phases = rng.uniform(1.0, 8.0, 6), rng.uniform(0, 6.28, 6)
    drive = 2.0 * np.sin(np.outer(fine, rates) + phases).sum(1)
    q = v = 0.0
    y, h = np.empty(samples), step / sub
    for k, u in enumerate(drive.tolist()):
        if k % sub == 0:
            y[k // sub] = q
        v += h * (u - 0.4 * v - 20.0 * q - 0.3 * math.tanh(v / 0.01))
        q += h * v
    u = drive[::sub]
    return Recording("r.csv", time, {"u": u, "y": y + NOISE * rng.normal(size=samples)})


def test_where_not_every_sample_can_be_looked_at_stretches_spread_evenly_stand_for_them():
    long = recording(60_000)
    prepared, whole = thinning.thinned(MODEL, [long], 6_000, 0.2)
    assert whole is not None and whole.samples == 60_000
    assert whole.searched <= 0.2 * 60_000
    at = np.array([p.time[0] for p in prepared])
    assert np.min(at) < 0.1 * long.time[-1] and np.max(at) > 0.8 * long.time[-1]
    stretches = thinning._stretches([long], 0.2)
    assert [begins for _, begins in stretches] == [True] + [False] * (len(stretches) - 1)
    assert sum(len(r) for r, _ in stretches) == pytest.approx(0.2 * 60_000, rel=0.01)
    assert thinning._stretches([long], 1.0) == [(long, True)]


@pytest.mark.long
def test_pieces_that_there_is_no_time_to_prepare_are_left_out():
    every, _ = thinning.thinned(MODEL, [recording(60_000)], 60_000)
    few, whole = thinning.thinned(MODEL, [recording(60_000)], 60_000, room=0.0)
    assert len(few) == 1 and whole is not None and whole.searched == few[0].time.size
    assert few[0].time[0] in [p.time[0] for p in every]
    assert sorted(p.time[0] for p in every) == [p.time[0] for p in every]
