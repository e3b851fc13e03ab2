"""A mode hardly visited: found, or said to be too rare."""

from __future__ import annotations

import numpy as np
import pytest

import jaxsr
from benchmarks.hybrid_systems import SYSTEMS
from jaxsr import Recording
from jaxsr.discovery.hybrid.rare import rare_tail


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
    rng = np.random.default_rng(seed)
    data = []
    for r in SYSTEMS["ball on a soft floor"].training(seed):
        touch = r.channels["x"] <= 0.1
        keep = ~touch
        most = int(0.02 * np.count_nonzero(~touch))
        keep[rng.choice(np.flatnonzero(touch), min(most, touch.sum()), replace=False)] = True
        channels = {n: v[keep] for n, v in r.channels.items()}
        data.append(Recording(r.name, r.time[keep], channels))
    found = jaxsr.discover(data, states=["x", "v"], derivatives=["d_x", "d_v"], seed=seed)
    if found.modes:
        assert any("x <= " in str(mode) for mode in found.modes)
        return
    assert found.rare is not None
    assert str(found.rare.guard.variable.name) == "x" and not found.rare.guard.above
    assert found.rare.guard.threshold == pytest.approx(0.1, abs=0.02)
    assert found.to_dict()["rare_mode"]["samples"] == found.rare.samples
