"""Free runs of models: friction, stiffness, divergence, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from diagnosis_systems import ARM
from model_runs import ball, friction, model, quiet, read_off, rolled

from jaxsr._result import InputError
from jaxsr.models import Simulator, read_model
from jaxsr.models.free_run import free_run
from jaxsr.models.rollout import Stepping
from jaxsr.recordings import Recording


@pytest.mark.long
def test_fixed_steps_agree_with_adaptive_ones_on_the_arm() -> None:
    simulator = Simulator(read_model(ARM))
    m = simulator.model
    time = np.arange(301) * 0.01
    channels = {m.column(u): (k + 1) * np.sin((2 + k) * time + k) for k, u in enumerate(m.inputs)}
    recording = Recording("a.csv", time, channels)
    x0 = [0.2, -0.3, 0.0, 0.0]
    run = free_run(simulator, recording, np.array(x0))
    x = rolled(simulator, recording, x0, Stepping("rk4", 8))
    y = read_off(simulator, recording, x0, Stepping("rk4", 8))
    assert run.success, run.message
    assert np.abs(x).max() > 0.2
    np.testing.assert_allclose(run.states, x, atol=1e-6)
    np.testing.assert_allclose(run.outputs, y, atol=1e-6)


def stick_slip(time: np.ndarray, u: np.ndarray, fc: float, fine: int) -> tuple[np.ndarray, ...]:
    """Exact rule: in an implicit step the friction impulse is at most fc*h and stops the mass."""
    q = v = 0.0
    qs, vs = [q], [v]
    h = (time[1] - time[0]) / fine
    for i in range(time.size - 1):
        for j in range(fine):
            push = v + h * (u[i] + (u[i + 1] - u[i]) * (j + 1) / fine)
            v = push - np.clip(push, -fc * h, fc * h)
            q += h * v
        qs.append(q)
        vs.append(v)
    return np.array(qs), np.array(vs)


@pytest.mark.long
def test_a_mass_below_its_friction_stays_put() -> None:
    recording = quiet(10.0, 0.02, u=0.8 * np.sin(np.arange(501) * 0.02))
    width = 1e-4
    # The smoothed sign holds 0.8 Fc at v = w*atanh(0.8): the creep can be no faster.
    bound = width * np.arctanh(0.8)
    run = free_run(friction(), recording, np.zeros(2), method="stiff", widths=(width,))
    assert run.success, run.message
    assert np.abs(run.states[:, 1]).max() <= bound * 1.001
    assert np.abs(run.states[:, 0]).max() <= bound * 10.0
    x = rolled(friction(), recording, [0.0, 0.0], Stepping("rodas3", 4, (width,)))
    assert np.abs(x[:, 1]).max() <= bound * 1.05
    assert np.abs(x[:, 0]).max() <= bound * 10.0


@pytest.mark.long
def test_stick_and_slip_agree_with_the_exact_rule() -> None:
    time = np.arange(501) * 0.02
    u = 1.5 * np.sin(time)
    q, v = stick_slip(time, u, 1.0, 500)
    assert (v == 0).mean() > 0.1 and np.abs(v).max() > 0.2  # it sticks, and it slips
    recording = Recording("a.csv", time, {"u": u})
    run = free_run(friction(), recording, np.zeros(2), widths=(1e-4,))
    assert run.success, run.message
    # The implicit rule errs by h = 4e-5, the smoothing by w = 1e-4 times the sticking time.
    assert np.abs(run.states[:, 1] - v).max() < 1e-3
    assert np.abs(run.states[:, 0] - q).max() < 2e-3
    x = rolled(friction(), recording, [0.0, 0.0], Stepping("rodas3", 8, (1e-4,)))
    assert np.abs(x[:, 0] - q).max() < 2e-3


@pytest.mark.slow
def test_stiff_and_nonstiff_agree_and_the_switch_is_automatic() -> None:
    simulator = model("x z", 'x = "-1e6*(x - cos(z))"; z = "1.0 + 0*x"')
    time = np.arange(200) * 0.05
    run = free_run(simulator, time, np.array([1.0, 0.0]))
    assert run.success and "Kvaerno5" in run.message
    assert np.abs(run.states[:, 0] - np.cos(time)).max() < 2e-6
    gentle = model("x z", 'x = "-3.0*(x - cos(z))"; z = "1.0 + 0*x"')
    a = free_run(gentle, time, np.array([1.0, 0.0]), method="nonstiff")
    b = free_run(gentle, time, np.array([1.0, 0.0]), method="stiff")
    assert "Tsit5" in a.message and "Kvaerno5" in b.message
    np.testing.assert_allclose(a.states, b.states, atol=1e-6)


@pytest.mark.long
def test_an_escaping_state_is_reported_and_not_hidden() -> None:
    simulator = model("x", 'x = "x**2"')
    run = free_run(simulator, np.arange(31) * 0.1, np.array([1.0]))
    assert not run.success and "ended at" in run.message
    assert np.isnan(run.states[-1]).all()
    before = run.time < 0.85
    np.testing.assert_allclose(run.states[before, 0], 1 / (1 - run.time[before]), rtol=1e-5)


def test_free_run_refuses_what_it_cannot_run() -> None:
    with pytest.raises(InputError, match="inputs u are unknown"):
        free_run(friction(), np.arange(3.0), np.zeros(2))
    with pytest.raises(InputError, match="one number for each of q, v"):
        free_run(friction(), quiet(1.0, 0.1, u=np.zeros(11)), np.zeros(3))
    with pytest.raises(InputError, match="events"):
        free_run(ball(), np.arange(3.0), np.zeros(2))
    wrong: Any = "euler"
    with pytest.raises(InputError, match="Use auto"):
        free_run(model("x", 'x = "-x"'), np.arange(3.0), np.zeros(1), method=wrong)
