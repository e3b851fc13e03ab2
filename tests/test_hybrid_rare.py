"""A mode hardly visited: found, or said to be too rare."""

from __future__ import annotations

import html
from pathlib import Path

import numpy as np
import pytest

import jaxsr
from benchmarks.hybrid_systems import hardly_touching
from jaxsr.discovery.hybrid import Guard, RareMode
from jaxsr.discovery.hybrid.rare import rare_tail
from jaxsr.expressions import Term
from jaxsr.report import write_discovery_report


def _columns(*parts: np.ndarray) -> np.ndarray:
    columns = np.column_stack([np.ones_like(parts[0]), *parts])
    return columns / np.sqrt(np.mean(columns**2, axis=0))


def _samples(count: int, strays: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A line over x, another one in the `strays` smallest x; a variable without a say."""
    rng = np.random.default_rng(seed)
    x, other = rng.uniform(0.0, 1.0, (2, count))
    edge = np.sort(x)[strays] if strays else -1.0
    y = 2.0 - x + np.where(x < edge, 40.0 * (edge - x) + 1.0, 0.0) + 1e-3 * rng.normal(size=count)
    return x, other, y


@pytest.mark.parametrize("strays", [5, 12, 30])
def test_the_end_of_a_variable_where_another_law_holds(strays: int) -> None:
    x, other, y = _samples(1000, strays, 0)
    tail = rare_tail(_columns(x, other), y[:, None], [other, x])
    assert tail is not None and tail.guard == 1 and not tail.above and tail.samples == strays
    low, high = np.sort(x)[strays - 1 : strays + 1]
    assert low < tail.threshold < high


def test_one_law_has_no_rare_end() -> None:
    """20 draws each of a line, of a line with a bend at its middle, and of outliers anywhere."""
    for seed in range(20):
        x, other, y = _samples(600, 0, seed)
        rng = np.random.default_rng([seed, 1])
        strange = y + np.where(rng.uniform(size=600) < 0.02, rng.normal(size=600), 0.0)
        for z in (y, y + np.abs(x - 0.5), strange):
            assert rare_tail(_columns(x, other), z[:, None], [other, x]) is None


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 15, 18])
def test_a_contact_hardly_visited_is_found_or_named(seed: int) -> None:
    """Two in a hundred of a bouncing ball's samples touch the floor."""
    data = hardly_touching(seed, 0.02)
    found = jaxsr.discover(data, states=["x", "v"], derivatives=["d_x", "d_v"], seed=seed)
    if found.modes:
        assert any("x <= " in str(mode) for mode in found.modes)
        return
    assert found.rare is not None
    assert str(found.rare.guard.variable.name) == "x" and not found.rare.guard.above
    assert found.rare.guard.threshold == pytest.approx(0.1, abs=0.02)
    assert found.to_dict()["rare_mode"]["samples"] == found.rare.samples


def test_a_report_says_where_a_rare_mode_lies(tmp_path: Path) -> None:
    rare = RareMode(Guard(Term.variable("x"), 0.1, above=False), 30, 1200)
    write_discovery_report({"equations": [], "rare_mode": {"sentence": str(rare)}}, [], tmp_path)
    page = html.unescape((tmp_path / "report.html").read_text())
    assert "30 of 1200 samples, those with x <= 0.1, do not follow the law of the others" in page
