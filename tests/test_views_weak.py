"""The weak view: integration by parts, exactness, validity and the choice of its width."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.recordings import read_recording
from jaxsr.views import WeakView, choose_half_width

RECORDINGS = Path(__file__).resolve().parents[2] / "shared" / "recordings"


def _uneven(rng: np.random.Generator, samples: int, jitter: float = 0.4) -> np.ndarray:
    t = np.arange(samples) + jitter * rng.uniform(-1.0, 1.0, samples)
    return np.sort(t) * 10.0 / samples


@pytest.mark.parametrize("k", [0, 1, 2])
def test_integration_by_parts_moves_the_derivative(k):
    t = np.linspace(0.0, 10.0, 2001)
    view = WeakView.build(t, half_width=0.8)
    w = 2.3
    derivative = [np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)][k]
    by_parts = view.integrate(np.sin(w * t), k)
    np.testing.assert_allclose(by_parts, view.integrate(derivative), atol=1e-11)
    # and not only consistently: phi is symmetric, so it scales a sine and leaves its phase
    gain = view.integrate(np.cos(w * (t - view.centres[3])))[3]
    at_centres = [np.sin, lambda x: w * np.cos(x), lambda x: -(w**2) * np.sin(x)][k]
    np.testing.assert_allclose(by_parts, gain * at_centres(w * view.centres), atol=1e-11)


@pytest.mark.long
@pytest.mark.parametrize("k", [0, 1, 2])
def test_polynomials_to_degree_three_are_exact_on_any_grid(k):
    for seed in range(10):
        rng = np.random.default_rng(seed)
        t = _uneven(rng, 120)
        view = WeakView.build(t, half_width=1.0, order=int(rng.integers(3, 10)))
        for degree in range(4):
            c = np.polynomial.Polynomial(rng.normal(size=degree + 1))
            expected = WeakView.build(np.linspace(t[0], t[-1], 4001), 1.0, order=view.order)
            fine = expected.integrate(c.deriv(k)(expected.time) if k else c(expected.time))
            np.testing.assert_allclose(view.integrate(c(t), k), fine, rtol=1e-8, atol=1e-8)


@pytest.mark.long
def test_uneven_grids_converge():
    """The error falls with the sample time at least quadratically, measured over a factor 4."""
    errors = []
    for samples in (250, 1000):
        worst = []
        for seed in range(10):
            t = _uneven(np.random.default_rng(seed), samples)
            view = WeakView.build(t, half_width=1.0)
            exact = WeakView.build(np.linspace(t[0], t[-1], 20_001), 1.0)
            y = np.sin(3.0 * t)
            truth = exact.integrate(-9.0 * np.sin(3.0 * exact.time))
            worst.append(np.max(np.abs(view.integrate(y, 2) - truth)))
        errors.append(np.median(worst))
    assert errors[0] < 0.05
    assert errors[1] < errors[0] / 4.0**2


def test_columns_are_integrated_as_one_by_one():
    rng = np.random.default_rng(0)
    t = _uneven(rng, 300)
    y = rng.normal(size=(300, 3))
    view = WeakView.build(t, 0.5)
    together = view.integrate(y, 1)
    assert together.shape == (view.centres.size, 3)
    for column in range(3):
        np.testing.assert_allclose(together[:, column], view.integrate(y[:, column], 1))


def test_supports_lie_inside_and_miss_gaps_and_missing_samples():
    t = np.delete(np.linspace(0.0, 10.0, 1001), np.arange(300, 340))
    mask = np.ones(t.size, bool)
    mask[700] = False
    half_width = 0.3
    view = WeakView.build(t, half_width, mask=mask)
    assert view.centres[0] - half_width >= t[0] - 1e-12
    assert view.centres[-1] + half_width <= t[-1] + 1e-12
    np.testing.assert_allclose(np.diff(view.centres), half_width / 4.0)
    touches_gap = (view.centres + half_width > t[299]) & (view.centres - half_width < t[300])
    touches_nan = np.abs(view.centres - t[700]) <= half_width
    np.testing.assert_array_equal(view.valid, ~(touches_gap | touches_nan))
    y = np.sin(t)
    y[700] = np.nan
    result = view.integrate(y, 1)
    np.testing.assert_array_equal(np.isfinite(result), view.valid)
    whole = WeakView.build(np.linspace(0.0, 10.0, 1001), half_width)
    reference = whole.integrate(np.cos(whole.time))
    np.testing.assert_allclose(result[view.valid], reference[view.valid], atol=1e-10)


def test_long_records_are_built_in_one_go():
    t = np.arange(25_000) * 1e-3
    view = WeakView.build(t, 0.1)
    assert view.centres.size > 900
    assert view.matrices[0].nnz < 25_000 * 9
    np.testing.assert_allclose(view.integrate(np.ones(t.size)), 1.0, atol=1e-12)
    np.testing.assert_allclose(view.integrate(1e6 + t, 1), 1.0, atol=1e-6)


def test_wrong_widths_are_refused():
    t = np.linspace(0.0, 1.0, 101)
    with pytest.raises(InputError, match="do not fit"):
        WeakView.build(t, 0.6)
    with pytest.raises(InputError, match="order=2"):
        WeakView.build(t, 0.1, order=2)
    with pytest.raises(InputError, match="spacing"):
        WeakView.build(t, 0.1, spacing=0.0)
    with pytest.raises(InputError, match="at least 16"):
        choose_half_width(t[:10], t[:10])


@pytest.mark.long
def test_the_width_scales_with_the_motion():
    """Twice as fast and twice as finely sampled is the same signal: the width halves."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        t = np.linspace(0.0, 20.0, 1000)
        y = np.sin(3.0 * t) + 0.3 * np.sin(5.0 * t + 1.0) + 0.01 * rng.normal(size=t.size)
        width = choose_half_width(t, y)
        assert choose_half_width(t / 2.0, y) == pytest.approx(width / 2.0)
        assert choose_half_width(t, 7.0 * y) == pytest.approx(width)
        # half the acceleration's energy passes: exp(-(f / sigma_f)^2) = 1/2, f between the tones
        low, high = (0.64 * np.sqrt(np.log(2.0)) * 2.0 * np.pi / w for w in (5.0, 3.0))
        assert 0.8 * low < width < 1.25 * high


def test_more_noise_never_makes_the_width_shorter_by_much():
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 20.0, 1000)
    motion, noise = np.sin(3.0 * t), rng.normal(size=t.size)
    widths = [choose_half_width(t, motion + s * noise) for s in (0.0, 1e-3, 1e-2, 0.1, 0.3)]
    assert all(b >= 0.6 * a for a, b in pairwise(widths))


def test_a_falling_ball_gets_a_quarter_of_its_record():
    t = np.arange(50) / 15.0
    for seed in range(20):
        y = 47.0 - 4.9 * t**2 + 0.1 * np.random.default_rng(seed).normal(size=t.size)
        assert choose_half_width(t, y) == pytest.approx(t[-1] / 4.0)


@pytest.mark.long
@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="../shared/recordings is not there")
def test_widths_on_real_recordings():
    for name in ("DATA_EMPS.mat", "DATA_EMPS_PULSES.mat"):
        emps = read_recording(RECORDINGS / "emps" / name)
        assert 0.07 < choose_half_width(emps.time, emps.channel("qm")) < 0.15
    silverbox = read_recording(RECORDINGS / "silverbox" / "SNLS80mV.mat", sample_time=2**14 / 1e7)
    part = silverbox.select(slice(60_000, 68_000))
    width = choose_half_width(part.time, part.channel("V2")) / part.sample_time
    assert 4.5 < width < 10.0


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="../shared/recordings is not there")
def test_emps_force_balance_in_the_weak_view():
    """Relative force errors and parameters known here: 19.6 % without friction, 1.7 with."""
    emps = read_recording(RECORDINGS / "emps" / "DATA_EMPS.mat")
    q, force = emps.channel("qm"), 35.151 * emps.channel("vir")
    view = WeakView.build(emps.time, 0.12)
    v = np.gradient(q, emps.time)
    rigid = [view.integrate(q, 2), view.integrate(q, 1)]
    friction = [view.integrate(x) for x in (np.sign(v), np.abs(v))]
    wanted = view.integrate(force)

    def solve(columns):
        theta = np.stack(columns, axis=1)
        xi = np.linalg.lstsq(theta, wanted, rcond=None)[0]
        return xi, np.linalg.norm(wanted - theta @ xi) / np.linalg.norm(wanted)

    assert solve(rigid)[1] == pytest.approx(0.196, abs=0.003)
    xi, error = solve(rigid + friction)
    assert error == pytest.approx(0.017, abs=0.002)
    assert xi[0] == pytest.approx(95.1, rel=0.02)
    assert xi[2] == pytest.approx(20.4, rel=0.03)
