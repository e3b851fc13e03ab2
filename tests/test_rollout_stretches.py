"""Stretches of recordings for roll-outs, and the steps taken within them."""

from __future__ import annotations

import numpy as np
import pytest
from rollout_systems import (
    DRIVEN,
    DRIVEN_TRUE,
    experiment,
    system_of,
    trace_of,
)

from jaxsr.discovery.rollout import cut, fine_enough, fit_rollout
from jaxsr.discovery.rollout.simulate import simulate


@pytest.mark.parametrize(("sizes", "length"), [((50, 23), 8), ((9,), 9), ((5, 30, 3), 12)])
def test_stretches_share_their_ends_and_short_ones_are_filled_up(
    sizes: tuple[int, ...], length: int
) -> None:
    rng = np.random.default_rng(0)
    traces = []
    for size in sizes:
        t = np.cumsum(rng.uniform(0.5, 1.5, size=size))
        traces.append(trace_of(t, {"x": rng.normal(size=size), "u": t}, {"x": t**2}, 0.1))
    segments = cut(traces, length, 99)
    assert segments.time.shape == (length, segments.count)
    assert np.all(np.diff(segments.time, axis=0) > 0.0)  # also where filled up
    known = np.isfinite(segments.measured["x"])
    assert np.all(known[:3]) and np.all(np.diff(known.astype(int), axis=0) <= 0)
    k = 0
    for trace in traces:
        t, x = trace["time"]["t"], trace["values"]["x"]
        for start in range(0, len(t) - 2, length - 1):
            part = slice(start, start + length)
            count = len(t[part])
            assert np.array_equal(segments.time[:count, k], t[part])
            assert np.array_equal(segments.values["x"][:count, k], x[part])
            assert np.array_equal(segments.measured["x"][:count, k], t[part] ** 2)
            assert np.all(segments.values["x"][count:, k] == x[part][-1])
            assert np.count_nonzero(known[:, k]) == count
            if start:  # the last sample of one is the first of the next
                assert segments.time[-1, k - 1] == segments.time[0, k]
            k += 1
    assert k == segments.count


def test_a_stretch_filled_up_weighs_no_more_than_its_samples() -> None:
    trace = experiment(4, 30, 0.02, 1)[0]
    short, filled = (
        fit_rollout(DRIVEN, cut([trace], n, 1), DRIVEN_TRUE, time="t", iterations=40)
        for n in (30, 47)
    )
    assert short is not None and filled is not None
    assert short.count == filled.count
    np.testing.assert_allclose(short.constants, filled.constants, rtol=1e-9)
    np.testing.assert_allclose(short.loss, filled.loss, rtol=1e-9)


@pytest.mark.parametrize("most", [1, 2, 7, 30])
def test_too_many_stretches_are_thinned_evenly(most: int) -> None:
    t = np.arange(401.0)
    segments = cut([trace_of(t, {"x": t}), trace_of(t + 500.0, {"x": t})], 11, most)
    assert segments.count == most
    starts = segments.time[0]
    if most > 1:
        assert starts[0] == 0.0 and starts[-1] == 890.0  # both ends are kept
        places = np.where(starts < 500.0, starts, starts - 100.0) / 10.0  # of 80 stretches
        assert np.ptp(np.diff(places)) <= 1.0 + 1e-9


@pytest.mark.parametrize(("speed", "least"), [(0.05, 1), (12.0, 2), (25.0, 4)])
def test_steps_are_halved_until_the_method_is_no_part_of_the_misfit(
    speed: float, least: int
) -> None:
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 4.0, 41)
    x = np.array([np.cos(speed * t), -speed * np.sin(speed * t)])
    seen = x[0] + 0.01 * rng.normal(size=41)
    trace = trace_of(t, {"x": x[0], "v": x[1]}, {"x": seen}, 0.01)
    system = system_of({"x": [], "v": ["x"]}, known={"x": "v"})
    segments = cut([trace], 41, 1)
    fitted = fit_rollout(system, segments, np.array([-(speed**2)]), time="t", substeps=16)
    assert fitted is not None
    steps = fine_enough(system, segments, fitted, time="t")
    assert steps == 1 if least == 1 else steps >= least

    def path(steps: int) -> np.ndarray:
        starts = fitted.starts[:, None, :]
        return simulate(
            system.function(), ("x", "v"), "t", segments, fitted.constants[None], starts, steps
        )[:, 0]

    def apart(steps: int) -> float:
        return float(np.mean(((path(2 * steps) - path(steps)) / 0.01) ** 2))

    assert apart(steps) <= 0.01 * fitted.loss
    assert steps == 1 or apart(steps // 2) > 0.01 * fitted.loss  # and no finer
