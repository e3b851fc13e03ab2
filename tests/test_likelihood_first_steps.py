"""First steps of an estimate, about a path that is no motion of its model, lead nowhere worse."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxsr.diagnosis.likelihood.course import followed
from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis, hypothesis
from jaxsr.diagnosis.likelihood.loop import begun
from jaxsr.diagnosis.likelihood.offered import offered
from jaxsr.diagnosis.likelihood.table import Table
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.models import parse_model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

MODEL = """
[model]
name = "joint"
states = ["q", "v"]
inputs = ["u", "a", "b"]
outputs = ["y", "w"]
input_hold = "linear"
[definitions]
J = "Ja + Jb*cos(a)**2 + Jc*cos(a)*cos(a + b) + Jd*cos(a + b)**2"
[equations]
q = "v"
v = "10*u"
[inertia]
v = { v = "J" }
[readings]
y = "q"
w = "v"
[parameters]
Ja = { value = 4.9, bounds = [0.1, 30.0] }
Jb = { value = 4.7, bounds = [-10.0, 30.0] }
Jc = { value = 5.0, bounds = [-10.0, 30.0] }
Jd = { value = 2.0, bounds = [-10.0, 30.0] }
"""
TIME = np.arange(800) * 0.02
EXPONENT = 0.35


def waves(rng: np.random.Generator, count: int, size: float, rates: np.ndarray):
    sizes, phases = size * rng.uniform(0.5, 1.0, count), rng.uniform(0.0, 6.0, count)
    return (sizes * np.sin(np.outer(TIME, rates) + phases)).sum(axis=1)


def recorded(rng: np.random.Generator, drive: float, friction: float) -> Recording:
    slow = np.array([0.4, 0.9, 1.7])
    a, b = waves(rng, 3, 0.5, slow), waves(rng, 3, 0.5, 1.3 * slow)
    u = waves(rng, 4, drive, np.array([0.7, 1.3, 2.9, 4.1]))
    elbow = np.cos(a + b)
    inertia = 4.9 + 4.7 * np.cos(a) ** 2 + 5.0 * np.cos(a) * elbow + 2.0 * elbow**2

    def rate(t: float, x: np.ndarray) -> list[float]:
        drag = friction * np.sign(x[1]) * abs(x[1]) ** EXPONENT
        return [x[1], (10.0 * np.interp(t, TIME, u) - drag) / np.interp(t, TIME, inertia)]

    run = solve_ivp(rate, (0.0, TIME[-1]), [0.0, 0.0], t_eval=TIME, rtol=1e-7, max_step=0.02)
    y = run.y[0] + 1e-4 * rng.normal(size=TIME.size)
    w = run.y[1] + 2e-3 * rng.normal(size=TIME.size)
    return Recording("run", TIME, {"u": u, "a": a, "b": b, "y": y, "w": w})


def weighed(records: list[Recording]) -> tuple[SuperModel, Workspace, Table, Hypothesis]:
    """What sets are estimated from: candidates, data, the table, and re-calibration."""
    model = parse_model(MODEL)
    course = followed(model, [Prepared.build(model, record) for record in records])
    assert course is not None
    every = SuperModel.build(model, offered(model, course, ()))
    work = Workspace.build(every, course.prepared, course.seconds, course.null.noise)
    state = begun(work, course.null)
    table = state.table
    null = state.known[()]
    assert null is not None
    return every, work, table, null


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("drive", "friction"), [(2.0, 32.0), (4.0, 60.0)])
def test_a_large_friction_is_estimated_from_every_start(
    drive: float, friction: float, seed: int
) -> None:
    """The force that is missing is half of the net force: first steps go to the bounds."""
    rng = np.random.default_rng(seed)
    every, work, table, null = weighed([recorded(rng, drive, friction) for _ in range(2)])
    starts = [i for i, c in enumerate(every.candidates) if c.label == "power_law_drag@equation:v"]
    assert len(starts) > 1
    for number in starts:
        found = hypothesis(work, table, (number,), null)
        assert found is not None and found.settled
        assert found.log_evidence > null.log_evidence
        size, exponent = (found.constants[found.names[number][name]] for name in ("kd", "p"))
        assert abs(size[0] - friction) < max(4.0 * size[1], 0.03 * friction)
        assert abs(exponent[0] - EXPONENT) < max(4.0 * exponent[1], 0.03)
