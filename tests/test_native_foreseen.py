"""Requests to a simulator in another process: as few as what is asked allows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from jaxsr.models.native.terms import Asked, Rows

NAMES = ("t", "q", "v", "F", "m")
USUAL = np.array([0.0, 0.1, 0.2, 0.5, 2.0])


class Counting:
    """A simulator whose one rate is F v/(m + 0.2 cos q); it counts what it is asked."""

    def __init__(self) -> None:
        self.requests: list[str] = []

    def rates(self, rows: np.ndarray) -> np.ndarray:
        self.requests.append("rates")
        return _rate(rows)[:, None]

    def slopes(self, rows: np.ndarray, columns: Any) -> np.ndarray:
        self.requests.append("slopes")
        return _slopes(rows, columns)[:, None]

    def with_slopes(self, rows: np.ndarray, columns: Any) -> np.ndarray:
        self.requests.append("with_slopes")
        return np.concatenate([_rate(rows)[:, None], _slopes(rows, columns)], axis=1)[:, None]


def _rate(rows: np.ndarray) -> np.ndarray:
    _, q, v, force, m = rows.T
    return force * v / (m + 0.2 * np.cos(q))


def _slopes(rows: np.ndarray, columns: Any) -> np.ndarray:
    _, q, v, force, m = rows.T
    inertia = m + 0.2 * np.cos(q)
    by = {
        1: force * v * 0.2 * np.sin(q) / inertia**2,
        2: force / inertia,
        3: v / inertia,
        4: -force * v / inertia**2,
    }
    return np.stack([by[k] for k in columns], axis=1)


def _asked(by: int | None = None) -> tuple[Asked, Counting]:
    native = Counting()
    rows: Any = Rows(native, NAMES, USUAL, np.ones(5))  # type: ignore[arg-type]
    return Asked(f"foreseen_{by}", rows, (1, 2, 3, 4), 0, by), native


def _points(seed: int) -> list[np.ndarray]:
    return list(np.random.default_rng(seed).uniform(0.5, 1.5, (4, 7)))


@pytest.mark.parametrize("by", [None, 3])
def test_a_value_and_its_slopes_are_one_request_once_they_were_asked_together(
    by: int | None,
) -> None:
    called, native = _asked(by)
    for k in range(6):
        at = _points(k)
        value, slopes = called.values(*at), called.slopes(at)
        rows = called.rows.filled(called.columns, at)
        want = _rate(rows) if by is None else _slopes(rows, (by,))[:, 0]
        assert value == pytest.approx(want, rel=1e-12)
        if by is None:
            assert np.stack(slopes, 1) == pytest.approx(_slopes(rows, called.columns), rel=1e-12)
        else:
            v_over = rows[:, 2] / (rows[:, 4] + 0.2 * np.cos(rows[:, 1]))
            assert slopes[1] == pytest.approx(v_over / rows[:, 2], rel=1e-5)
            assert slopes[2] == pytest.approx(np.zeros(7), abs=1e-9)
    assert len(native.requests) == 2 + 5


def test_slopes_that_nobody_asks_for_are_fetched_once_at_most() -> None:
    called, native = _asked()
    at = _points(0)
    called.values(*at)
    called.slopes(at)
    for k in range(1, 6):
        called.values(*_points(k))
    assert native.requests.count("with_slopes") == 2  # that of the first slopes, and one too many
    assert native.requests.count("rates") == 5


def test_slopes_elsewhere_are_not_those_that_were_kept() -> None:
    called, _ = _asked()
    for k in range(3):
        called.values(*_points(k))
        called.slopes(_points(k))
    called.values(*_points(7))
    at = _points(8)
    rows = called.rows.filled(called.columns, at)
    found = called.slopes(at, [True, False, True, False])
    assert np.stack(found[::2], 1) == pytest.approx(_slopes(rows, (1, 3)), rel=1e-12)
