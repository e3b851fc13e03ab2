"""When an explained model is said to simulate better than re-calibration."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import pytest

from jaxsr.diagnosis.explaining.judge import _simulates_better

SHORT = 2.0


def estimate(errors: Mapping[float | None, float]) -> Any:
    """An estimate of which only free-run errors by horizon count; None is the whole length."""

    def run(prepared: object, theta: object, horizon: float | None) -> Any:
        return SimpleNamespace(nrmse=errors[horizon])

    return SimpleNamespace(theta=None, lean=SimpleNamespace(free_run=run))


@pytest.mark.parametrize(
    ("before", "after", "better"),
    [
        ({SHORT: 0.1, None: 0.2}, {SHORT: 0.05, None: 0.3}, True),
        ({SHORT: 0.1, None: 0.2}, {SHORT: 0.2, None: 0.1}, True),
        ({SHORT: 0.1, None: 0.2}, {SHORT: 0.1, None: 0.2}, False),
        # neither follows over the whole length, and where the one does the other is worse
        ({SHORT: 0.1, None: 1.5}, {SHORT: 1.6, None: 1.02}, False),
        ({SHORT: 0.1, None: 10.0}, {SHORT: 0.09, None: 10.0}, True),
    ],
)
def test_runs_that_follow_no_better_than_a_constant_tell_nothing(
    before: Mapping[float | None, float], after: Mapping[float | None, float], better: bool
) -> None:
    parts: Any = SimpleNamespace(
        case=SimpleNamespace(prepared=()), headline=SHORT, horizons=[1.0, SHORT, 4.0]
    )
    assert _simulates_better(parts, estimate(before), estimate(after)) is better
