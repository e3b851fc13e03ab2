"""Work side by side: every item once, whatever the number of cores."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest

from jaxsr import _cores
from jaxsr._cores import side_by_side, spans
from jaxsr.diagnosis.likelihood import kalman
from jaxsr.diagnosis.likelihood.kalman import System, smoothed, whitened


@pytest.mark.parametrize("parts", [1, 2, 3, 7])
@pytest.mark.parametrize("count", [1, 2, 5, 100])
def test_spans_hold_every_item_once_and_are_alike(count: int, parts: int) -> None:
    found = spans(count, parts, first=4)
    assert [i for a, b in found for i in range(a, b)] == list(range(4, 4 + count))
    lengths = [b - a for a, b in found]
    assert len(found) <= parts and max(lengths) - min(lengths) <= 1 and min(lengths) > 0


def test_no_items_are_one_empty_span() -> None:
    assert spans(0, 2) == [(0, 0)]


def test_items_are_worked_on_at_the_same_time_and_come_in_order() -> None:
    """Each of two waits for the other: one after the other they would wait for ever."""
    together = threading.Barrier(2, timeout=30.0)

    def work(item: int) -> int:
        together.wait()
        return 10 * item

    assert side_by_side(work, [1, 2], threads=2) == [10, 20]


def test_an_error_in_a_thread_is_raised_here() -> None:
    def work(item: int) -> int:
        raise ValueError(str(item))

    with pytest.raises(ValueError, match="1"):
        side_by_side(work, [1, 2], threads=2)


def drawn() -> System:
    """Return a system of five pieces under three choices."""
    rng = np.random.default_rng(11)
    steps, pieces, outputs, size, width, choices = 60, 5, 2, 4, 3, 3
    return System(
        0.9 * np.eye(size) + 0.05 * rng.normal(size=(steps, pieces, size, size)),
        rng.normal(size=(steps, pieces, size, width)),
        rng.normal(size=(steps + 1, pieces, outputs, size)),
        rng.normal(size=(steps + 1, pieces, outputs, width)),
        rng.uniform(size=(steps + 1, pieces, outputs)) > 0.2,
        rng.uniform(0.5, 1.0, size=(choices, 1, size)),
        rng.uniform(0.5, 1.0, size=(choices, 1, size)),
        rng.uniform(0.0, 0.1, size=(choices, 1, size)),
        rng.uniform(0.1, 0.2, size=(choices, 1, outputs)),
    )


def test_filter_and_smoother_are_the_same_on_any_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    system = drawn()
    one = replace(
        system, **{n: getattr(system, n)[:1] for n in ("decay", "start", "process", "noise")}
    )
    found = []
    for count in (1, 2, 3):
        monkeypatch.setattr(kalman, "cores", lambda count=count: count)
        monkeypatch.setattr(_cores, "cores", lambda count=count: count)
        white = whitened(system)
        found.append((white.rows, white.log_determinant, smoothed(one, 3)))
    for other in found[1:]:
        for here, there in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(here, there)
