"""Figures of a report are those of docs/files.md, on plants with closed forms."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.figure_parts import STEP, TIME, Row
from benchmarks.figure_plants import PLANTS
from jaxsr.diagnosis.explaining.acting import acting, region_rows
from jaxsr.diagnosis.explaining.detectable import first_above, standard_errors
from jaxsr.models import Simulator, parse_model
from jaxsr.models.least_squares import Problem
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, build_segments
from jaxsr.models.shooting import fit
from jaxsr.recordings import Recording


@pytest.mark.long
@pytest.mark.parametrize("name", PLANTS)
def test_figures_are_exact(name: str) -> None:
    rows = list(PLANTS[name](0))
    assert rows
    assert [row for row in rows if not row.right] == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", PLANTS)
def test_figures_are_exact_for_other_motions(name: str, seed: int) -> None:
    assert [row for row in PLANTS[name](seed) if not row.right] == []


def test_a_row_is_wrong_outside_its_tolerance() -> None:
    assert Row("", 1.01, 1.0, 0.02).right and not Row("", 1.03, 1.0, 0.02).right
    assert not Row("", None, 1.0, 0.02).right and not Row("", 1e25, None).right
    assert Row("", None, None).right


def test_a_force_of_constant_size_acts_everywhere() -> None:
    """A zero crossing is no gap, whatever share of the time is spent near it."""
    v = np.sin(2.0 * TIME) ** 3
    (row,) = region_rows("v", v, np.abs(np.sign(v)))
    assert row == {"variable": "v", "from": v.min(), "to": v.max(), "everywhere": True}
    (row,) = region_rows("v", v, np.abs(v))  # viscous: a twentieth of the largest is a short gap
    assert row["everywhere"]


@pytest.mark.parametrize("power", [2, 3, 5])
def test_a_power_acts_from_the_root_of_a_twentieth_on(power: int) -> None:
    x = np.linspace(-1.0, 1.0, 20001)
    edge = 0.05 ** (1.0 / power)
    low, high = acting(x, np.abs(x) ** power)
    np.testing.assert_allclose([*low, *high], [-1.0, -edge, edge, 1.0], atol=2e-4)


def test_an_effect_that_never_acts_has_no_region() -> None:
    assert acting(TIME, np.zeros_like(TIME)) == []
    assert acting(TIME, np.full_like(TIME, np.nan)) == []
    # of a part of all samples: relative to the largest of all
    assert acting(TIME, np.full_like(TIME, 0.01), largest=1.0) == []


def test_a_law_on_a_bump_acts_on_the_bump() -> None:
    x = np.linspace(-5.0, 5.0, 10001)
    ((low, high),) = acting(x, np.exp(-(((x - 1.0) / 0.5) ** 2)))
    reach = 0.5 * np.sqrt(np.log(20.0))
    assert (low, high) == pytest.approx((1.0 - reach, 1.0 + reach), abs=2e-3)


def test_the_smallest_effect_is_found_in_95_of_100_recordings() -> None:
    """Draws of an estimate at that many standard errors pass the two-sided test as often."""
    rng = np.random.default_rng(0)
    for threshold in (1e-2, 1e-5):
        draws = standard_errors(threshold) + rng.standard_normal(40_000)
        least = standard_errors(threshold) - 1.6448536
        assert np.mean(draws > least) == pytest.approx(0.95, abs=0.004)


def test_a_polygon_is_crossed_where_its_line_is() -> None:
    x, y = np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 3.0])
    assert first_above(x, y, 2.0) == pytest.approx(1.5)
    assert first_above(x, y, -1.0) == 0.0
    assert first_above(x, y, 4.0) is None


def test_a_start_that_the_model_gives_is_kept_where_the_sensors_say_another() -> None:
    """A delayed ramp reads -0.5 at first; the state begins at 0 all the same."""
    model = parse_model(
        '[model]\nstates = ["x"]\noutputs = ["y"]\n[equations]\nx = "1 + 0*x"\n'
        '[readings]\ny = "x"\n[initial]\nx = 0.0\n[delays]\ny = 0.5\n'
    )
    time = np.arange(200) * STEP
    item = Prepared.build(model, Recording("a.csv", time, {"y": time - 0.5}))
    segments = build_segments(model, [item], [(0, 0, 200)], 1)
    problem = Problem(Simulator(model), Stepping("rk4", 1), segments, np.ones(1))
    found = fit(problem, np.zeros(0), np.zeros(0, dtype=int), (np.zeros(0), np.zeros(0)))
    assert found.x0[0, 0] == 0.0
