"""Weak rows: exact for cubics, closed forms for sines, errors, gaps, and parts of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import gamma, jv

from jaxsr.discovery.weak_rows import WeakRows, weak_rows


def places(rows: WeakRows, t: np.ndarray) -> tuple[np.ndarray, float]:
    """Return centres and half-width: first and second moments of (1 - s^2)^8 are 0 and 1/19."""
    centre = rows.matrix @ t
    spread = rows.matrix @ t**2 - centre**2
    return centre, float(np.sqrt(19.0 * np.median(spread)))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("even", [True, False])
def test_weak_rows_of_cubics_are_exact(even: bool, order: int) -> None:
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 5.0, 300) if even else np.cumsum(rng.uniform(0.01, 0.02, size=300))
    for _ in range(10):
        p = np.polynomial.Polynomial(rng.normal(size=4))
        rows = weak_rows(t, p(t), np.full(300, 1e-3), order)
        scale = np.max(np.abs(rows.target))
        np.testing.assert_allclose(rows.matrix @ p.deriv(order)(t), rows.target, atol=1e-8 * scale)
        # and the mean of a polynomial of degree 3 - order under the test function, in closed form
        centre, width = places(rows, t)
        q = p.deriv(order)
        mean = q(centre) + q.deriv(2)(centre) / 2.0 * width**2 / 19.0
        np.testing.assert_allclose(rows.target, mean, atol=1e-7 * scale)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("speed", [1.0, 3.0, 8.0])
def test_weak_rows_of_sines_have_a_closed_form(speed: float, order: int) -> None:
    r""":math:`\int \phi_c \cos(w t) = \cos(w c)\,\Gamma(19/2) (2/(wh))^{17/2} J_{17/2}(wh)`."""
    t = np.linspace(0.0, 10.0, 2000)
    rows = weak_rows(t, np.sin(speed * t), np.full(2000, 1e-2), order)
    centre, width = places(rows, t)
    factor = gamma(9.5) * (2.0 / (speed * width)) ** 8.5 * jv(8.5, speed * width)
    rates = {1: speed * np.cos(speed * centre), 2: -(speed**2) * np.sin(speed * centre)}
    np.testing.assert_allclose(rows.target, factor * rates[order], atol=1e-5 * speed**order)
    assert np.all(np.diff(centre) > 0.0)
    assert centre[0] - width > -1e-9 and centre[-1] + width < 10.0 + 1e-9


@pytest.mark.long
def test_the_error_of_a_row_is_what_noise_leaves_in_it() -> None:
    t = np.linspace(0.0, 10.0, 500)
    pulls = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        level = 0.1 + 0.05 * t  # more noise later
        rows = weak_rows(t, 0.3 * t + level * rng.normal(size=500), level)
        pulls.append((rows.target - 0.3) / rows.error)
    # some ten rows of a record are independent: the root of 40 mean squares is 1 +- 0.04
    assert 0.85 < np.sqrt(np.mean([np.mean(p**2) for p in pulls])) < 1.12
    thirds = np.array([[np.mean(q**2) for q in np.array_split(p, 3)] for p in pulls])
    assert np.all(np.abs(np.mean(thirds, axis=0) - 1.0) < 0.35)  # early and late alike


def test_missing_samples_enter_no_row() -> None:
    t = np.linspace(0.0, 10.0, 600)
    x = np.sin(t)
    x[200:204] = np.nan
    rows = weak_rows(t, x, np.full(600, 0.01))
    assert len(rows.target) and not np.any(rows.matrix[:, 200:204].toarray())
    np.testing.assert_allclose(rows.matrix @ np.cos(t), rows.target, atol=1e-5)


def test_a_record_all_gaps_has_no_rows() -> None:
    t = np.linspace(0.0, 10.0, 400)
    x = np.where(np.arange(400) % 3 == 0, np.nan, np.sin(t))
    rows = weak_rows(t, x, np.full(400, 0.1))
    assert rows.matrix.shape == (0, 400) and not len(rows.target) and not len(rows.error)


def test_taking_samples_keeps_whole_test_functions_only() -> None:
    t = np.linspace(0.0, 10.0, 400)
    rows = weak_rows(t, t**2, np.full(400, 0.05))
    rng = np.random.default_rng(0)
    for _ in range(20):
        low, high = sorted(rng.choice(400, 2, replace=False))
        kept = np.arange(low, high + 1)
        part = rows.take(kept)
        dense = rows.matrix.toarray()
        outside = np.delete(dense, kept, axis=1)
        whole = ~np.any(outside, axis=1)
        # weights at the very ends of a support are zero and may be cut off
        assert len(part.target) <= np.count_nonzero(whole)
        assert len(part.target) >= np.count_nonzero(whole) - 4
        np.testing.assert_allclose(part.matrix @ (2.0 * t[kept]), part.target, atol=1e-9)
        np.testing.assert_allclose(part.matrix @ np.ones(len(kept)), 1.0, atol=1e-12)
    assert len(rows.take(np.arange(0, 400, 2)).target) == 0
    again = rows.take(np.arange(400))
    assert np.array_equal(again.target, rows.target) and np.array_equal(again.error, rows.error)


def test_joined_rows_see_their_own_recording_alone() -> None:
    first, second = np.linspace(0.0, 10.0, 400), np.linspace(3.0, 6.0, 300)
    parts = [
        weak_rows(first, np.sin(first), np.full(400, 0.01)),
        weak_rows(second, second**3, np.full(300, 0.02)),
    ]
    whole = WeakRows.joined(parts)
    count = len(parts[0].target)
    assert whole.matrix.shape == (count + len(parts[1].target), 700)
    assert not np.any(whole.matrix[:count, 400:].toarray())
    assert not np.any(whole.matrix[count:, :400].toarray())
    rate = np.concatenate([np.cos(first), 3.0 * second**2])
    np.testing.assert_allclose(whole.matrix @ rate, whole.target, atol=1e-5)
    assert np.array_equal(whole.error, np.concatenate([p.error for p in parts]))
    back = whole.take(np.arange(400, 700))
    assert np.array_equal(back.target, parts[1].target)
