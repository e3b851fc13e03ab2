"""How large the likelihood believes a coefficient to be before it has seen the readings."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from jaxsr.diagnosis.likelihood.table import _Usual


def usual(path: np.ndarray) -> _Usual:
    """Two states with an equation each, one sensor that varies by 2."""
    samples = path.shape[1]
    count = np.full(path.shape[2:], samples)
    narrow = SimpleNamespace(segments=SimpleNamespace(count=count), scale=np.array([2.0]))
    work: Any = SimpleNamespace(narrow=narrow, force_states=(0, 1))
    local: Any = SimpleNamespace(by_constant=np.ones((samples - 1, 1, 2, 2)))
    return _Usual.of(work, local, path, (0, 1))


def test_a_coefficient_moves_its_state_as_far_as_it_goes_or_the_reading_as_it_varies() -> None:
    path = np.stack([np.arange(5.0) * 0.1, np.arange(5.0) * 3.0])[..., None]
    step = np.zeros((4, 1, 2, 3))
    step[..., 0, 0], step[..., 1, 1] = 0.5, 0.5
    reading = np.zeros((5, 1, 1, 3))
    reading[..., 2] = 4.0
    found = usual(path).deviations(step, reading)
    np.testing.assert_allclose(found, [0.1 / 0.5, 3.0 / 0.5, 2.0 / 4.0])


def test_a_state_that_stands_still_says_of_no_coefficient_how_large_it_is() -> None:
    path = np.stack([np.arange(5.0) * 0.1, np.zeros(5)])[..., None]
    step = np.full((4, 1, 2, 1), 0.5)
    found = usual(path).deviations(step, np.zeros((5, 1, 1, 1)))
    np.testing.assert_allclose(found, [0.1 / 0.5])
