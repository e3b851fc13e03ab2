"""Long recordings: thinned for the search, used whole for the estimate; budgets inside steps."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxsr
from jaxsr._deadline import OutOfTime, bounded, never
from jaxsr._progress import Budget
from jaxsr.discovery.affordable import affordable
from jaxsr.discovery.samples import roles
from jaxsr.discovery.thinning import MOST_ROWS, thin
from jaxsr.discovery.whole import _spread
from jaxsr.evolution import PrimitiveSet, SearchConfig, search
from jaxsr.recordings import Recording
from jaxsr.recordings.local_polynomials import at_blocks
from jaxsr.regression import RegressionProblem

QUICK = SearchConfig(population=40, refined=3, generations=6, restarts=0, patience=3)
PLAIN = SearchConfig(
    population=40,
    refined=3,
    generations=6,
    restarts=0,
    patience=3,
    primitives=PrimitiveSet(functions=("add", "mul")),
)
PART = roles(["q", "v"], None, 1, [], None)


def _decay(rows, span, noise=0.0, seed=0, w=2.0):
    """q'' = -(w^2 + 0.01) q - 0.2 q'."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, span, rows)
    q = np.exp(-0.1 * t) * np.sin(w * t)
    v = np.exp(-0.1 * t) * (w * np.cos(w * t) - 0.1 * np.sin(w * t))
    q, v = (x + noise * np.std(x) * rng.normal(size=rows) for x in (q, v))
    return Recording("long", t, {"q": q, "v": v})


def _waves(rows, step, noise=0.0, w=2.0):
    """q'' = -w^2 q."""
    rng = np.random.default_rng(0)
    t = step * np.arange(rows)
    q, v = np.cos(w * t), -w * np.sin(w * t)
    q, v = (x + noise * np.std(x) * rng.normal(size=rows) for x in (q, v))
    return Recording("long", t, {"q": q, "v": v})


def test_what_is_oversampled_becomes_local_fits_of_less_noise():
    record, truth = _decay(120_000, 20.0, 0.02), _decay(120_000, 20.0)
    found = thin([record], PART)
    (short,) = found.searched
    assert found.factor == 10 and not found.is_partial
    assert len(short) == found.rows == MOST_ROWS and found.recorded == 120_000
    error = short.channels["q"] - np.interp(short.time, truth.time, truth.channels["q"])
    before = 0.02 * np.std(truth.channels["q"])
    # as little as the mean of ten samples has, 0.316, though nothing of the motion is averaged away
    assert 0.30 * before < np.std(error) < 0.33 * before
    assert abs(np.mean(error)) < 0.03 * before


@pytest.mark.parametrize("factor", [2, 3, 10])
def test_a_row_for_a_block_is_unbiased_and_its_noise_that_of_a_mean(factor):
    rng = np.random.default_rng(0)
    t = 1e4 + 0.25 / factor * (np.arange(20_000) + 0.1 * rng.uniform(size=20_000))
    centre, value = at_blocks(t, 1e3 + np.sin(t), factor)
    error = np.abs(value - 1e3 - np.sin(centre))
    # the mean of a block is off by phase**2/24 = 2.6e-3, here 25 rows a radian are the fourth
    assert np.max(error[3:-3]) < 1e-8 and np.max(error) < 5e-7
    noise = at_blocks(t, rng.normal(size=len(t)), factor)[1][3:-3]
    assert np.std(noise) * np.sqrt(factor) == pytest.approx(1.0, abs=0.06)
    assert abs(np.mean(noise[1:] * noise[:-1]) / np.mean(noise**2)) < 0.12


def test_no_window_reaches_across_a_pause_or_a_gap():
    t = np.concatenate([np.arange(500), 2500 + np.arange(500)]) * 0.01
    y = np.where(t < 10.0, np.sin(t), 5.0 + np.cos(t))
    y[200:300] = np.nan
    centre, value = at_blocks(t, y, 5)
    truth = np.where(centre < 10.0, np.sin(centre), 5.0 + np.cos(centre))
    lost = np.isnan(value)
    assert np.array_equal(np.flatnonzero(lost), np.arange(40, 60))
    assert np.max(np.abs(value - truth)[~lost]) < 1e-8


def test_clean_samples_are_picked_as_they_are():
    record = _decay(60_000, 20.0)
    found = thin([record], PART)
    (short,) = found.searched
    assert found.factor == 5 and len(short) == MOST_ROWS
    assert np.isin(short.time, record.time).all()
    assert np.isin(short.channels["v"], record.channels["v"]).all()


def test_fast_motion_is_cut_into_stretches_and_not_aliased():
    record = _waves(60_000, 0.4)  # eight samples a period
    found = thin([record], PART)
    assert found.factor == 1 and found.is_partial and found.rows <= MOST_ROWS
    assert sum(map(len, found.whole)) == 60_000
    assert all(np.allclose(np.diff(r.time), 0.4) for r in found.searched)
    assert found.searched[-1].time[-1] > 0.95 * record.time[-1]  # spread over all of it


def test_missing_samples_make_missing_rows_only_where_most_are():
    record = _decay(60_000, 20.0, 0.01)
    q = record.channels["q"].copy()
    q[::3] = np.nan
    q[30_000:30_500] = np.nan
    found = thin([Recording("a", record.time, {"q": q, "v": record.channels["v"]})], PART)
    (short,) = found.searched
    lost = np.isnan(short.channels["q"])
    assert 95 < np.count_nonzero(lost) < 105
    assert np.isfinite(short.channels["v"]).all()


def test_a_long_input_that_steps_is_averaged_by_blocks():
    record = _decay(60_000, 20.0, 0.01)
    u = np.sign(np.sin(record.time))
    part = roles(["q", "v"], None, 1, ["u"], None)
    found = thin([Recording("a", record.time, {**record.channels, "u": u})], part)
    assert found.factor == 5
    assert np.mean(np.isclose(np.abs(found.searched[0].channels["u"]), 1.0, atol=1e-6)) > 0.99


def test_many_recordings_are_searched_in_part_and_a_short_budget_in_less():
    many = [_decay(500, 5.0, 0.01, seed) for seed in range(400)]
    whole = thin(many, PART)
    assert whole.is_partial and whole.rows <= MOST_ROWS and len(whole.whole) == 400
    assert thin(many, PART, 5.0).rows < 0.5 * whole.rows
    assert not thin(many[:10], PART).is_partial
    assert str(thin(many[:10], PART)) == ""


def test_recordings_under_an_integral_stay_whole():
    found = thin([_waves(60_000, 0.4)], PART, joined=True)
    assert not found.is_partial and len(found.searched) == 1


def test_a_slow_machine_searches_less(monkeypatch):
    record = _waves(9_000, 0.4, 0.01)
    home = __import__("jaxsr.discovery.affordable", fromlist=["_pace"])
    monkeypatch.setattr(home, "_pace", lambda: 1.0)
    at_rest, hurried = affordable([record], PART, Budget(20.0))
    assert not hurried
    monkeypatch.setattr(home, "_pace", lambda: 30.0)
    slow, hurried = affordable([record], PART, Budget(20.0))
    assert hurried and slow.rows < 0.5 * at_rest.rows
    assert not affordable([record], PART, Budget())[1]


def test_prefixes_of_a_spread_order_are_spread():
    order = _spread(100)
    assert sorted(order) == list(range(100))
    for count in (5, 13, 34):
        gaps = np.diff(np.sort(order[:count]))
        assert np.max(gaps) < 2.8 * 100 / count


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_the_law_of_a_part_is_estimated_on_the_whole(noise):
    record = _waves(30_000, 0.1, noise, w=4.0)
    found = jaxsr.discover([record], states=["q", "v"], config=PLAIN, modes=1)
    assert "estimated on 30000 rows" in found.provenance["thinned"]
    law = {t.expression: t for t in found["v"].terms}
    assert set(law) == {"q"} or noise > 0.0
    assert law["q"].coefficient == pytest.approx(-16.0, rel=1e-5 if noise == 0.0 else 0.02)
    low, high = law["q"].ci95
    assert np.isfinite([low, high]).all() and low < high


def test_a_step_is_left_in_the_middle():
    x = np.random.default_rng(0).normal(size=(200, 3))
    problem = RegressionProblem(x[:, 0] * x[:, 1], {"a": x[:, 0], "b": x[:, 1], "c": x[:, 2]})
    calls = iter(range(10**6))
    with pytest.raises(OutOfTime), bounded(problem, lambda: next(calls) > 3):
        for k in range(10):
            problem.refine_many([[jaxsr.expressions.parse(f"sin({k + 2}.5*a)")]])
    assert next(calls) == 5 and problem.expired is never


def test_a_search_without_time_gives_a_linear_law():
    x = np.random.default_rng(0).normal(size=(200, 3))
    y = 2.0 * x[:, 0] - 3.0 * x[:, 2]
    problem = RegressionProblem(y, {"a": x[:, 0], "b": x[:, 1], "c": x[:, 2]})
    state, reason = search(np.random.default_rng(0), problem, QUICK, budget=1e-6)
    assert reason == "budget" and state.front.best_loss < 1e-20
    assert state.front.members[-1].size <= 8


@pytest.mark.slow
def test_a_million_rows_give_the_law_of_every_fiftieth():
    rng = np.random.default_rng(11)
    t = np.linspace(0.0, 200.0, 1_000_001)

    def rates(t, x):
        return [x[1], -9.81 * np.sin(x[0]) - 0.05 * x[1] + 1.5 * np.sin(1.3 * t)]

    path = solve_ivp(rates, (0.0, 200.0), [1.0, 0.0], dense_output=True, rtol=1e-9, atol=1e-10)
    q, w = path.sol(t)
    q, w = q + 1e-4 * rng.normal(size=t.size), w + 1e-3 * rng.normal(size=t.size)
    laws = []
    for step in (1, 50):
        began = time.thread_time()
        record = Recording("a", t[::step], {"q": q[::step], "w": w[::step]})
        found = jaxsr.discover([record], states=["q", "w"], budget=120.0)
        assert time.thread_time() - began < 120.0
        assert found["q"].expression == "w"
        law = {term.expression: term.coefficient for term in found["w"].terms}
        assert len(law) == 3 and "w" in law and "sin(q)" in law
        laws.append({"drive" if name.endswith("t)") else name: c for name, c in law.items()})
    for law in laws:
        assert law["sin(q)"] == pytest.approx(-9.81, rel=2e-5)
        assert law["w"] == pytest.approx(-0.05, rel=1e-3)
        assert law["drive"] == pytest.approx(1.5, rel=2e-4)
