"""A force that no named mechanism covers is written by the evolution."""

from __future__ import annotations

import numpy as np
import pytest
from diagnosis_systems import CART
from scipy.integrate import solve_ivp

from jaxsr.diagnosis import diagnose
from jaxsr.expressions import evaluate, parse
from jaxsr.models import Simulator, parse_model
from jaxsr.recordings import Recording


def recording(seed: int) -> Recording:
    """A cart on a spring whose rail ripples: the force -6 sin(5 q) is not in the model."""
    rng = np.random.default_rng(seed)
    time, phases = np.arange(0.0, 30.0, 0.01), rng.uniform(0.0, 6.0, 8)
    waves = np.linspace(0.15, 2.0, 8)
    u = 4.0 * np.sin(2 * np.pi * waves * time[:, None] + phases).sum(1)

    def rates(t: float, x: np.ndarray) -> list[float]:
        force = np.interp(t, time, u) - 3.0 * x[1] - 8.0 * x[0] - 6.0 * np.sin(5.0 * x[0])
        return [x[1], force / 2.0]

    path = solve_ivp(
        rates, (0.0, time[-1]), [0.0, 0.0], t_eval=time, rtol=1e-9, atol=1e-10, max_step=0.01
    )
    y = path.y[0] + 1e-4 * rng.normal(size=time.size)
    return Recording("cart.csv", time, {"u": u, "y": y})


@pytest.mark.slow
def test_a_ripple_is_written_by_the_search():
    found = diagnose(Simulator(parse_model(CART)), [recording(3)], seed=0)
    assert found.verdict == "structure"
    (row,) = found.findings
    assert row["mechanism"] == "unnamed" and row["site"] == "equation:v"
    q = np.linspace(-0.8, 0.8, 41)
    values = {name: p["value"] for name, p in row["parameters"].items()}
    term = evaluate(parse(row["term"]), {"q": q, "v": 0.0 * q, **values})
    assert np.max(np.abs(term + 6.0 * np.sin(5.0 * q))) < 0.05
