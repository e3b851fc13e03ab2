"""A black-box simulator learnt from its output, and what it left out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxsr import diagnose, learn_simulator
from jaxsr._result import InputError
from jaxsr.recordings import Recording


def run(name: str, coulomb: float, seed: int, noise: float) -> Recording:
    """2 q'' = u - 20 q - 1.5 q' - coulomb sign(q'), 10 s at 100 Hz."""
    rng = np.random.default_rng(seed)
    time = np.arange(1000) * 0.01
    frequency, phase = rng.uniform(1.0, 7.0, 4), rng.uniform(0.0, 6.0, 4)

    def force(t: float) -> float:
        return 4.0 * float(np.sin(frequency * t + phase).sum())

    def rate(t: float, x: np.ndarray) -> list[float]:
        push = force(t) - 20.0 * x[0] - 1.5 * x[1] - coulomb * np.tanh(x[1] / 0.0005)
        return [x[1], push / 2.0]

    path = solve_ivp(
        rate, (0.0, time[-1]), [0.1, 0.0], t_eval=time, rtol=1e-9, atol=1e-10, max_step=0.001
    ).y
    q, v = path + noise * np.array([[1.0], [3.0]]) * rng.normal(size=path.shape)
    return Recording(name, time, {"u": np.array([force(t) for t in time]), "q": q, "v": v})


@pytest.mark.slow
def test_a_simulator_is_learnt_from_its_output_and_its_missing_friction_found():
    simulated = [run("sim.csv", 0.0, 1, 0.0)]
    recorded = [run("real.csv", 1.5, 1, 1e-3)]
    learned = learn_simulator(simulated, recorded)
    assert learned.inputs == ("u",)
    assert learned.states == ("q", "v")
    assert learned.nrmse < 1e-3  # the input is drawn on lines between samples
    model = learned.simulator.model
    values = {n: p.value for n, p in model.parameters.items()}
    assert sorted(values.values()) == pytest.approx([-10.0, -0.75, 0.5], rel=1e-4)
    found = diagnose(learned.simulator, recorded)
    assert found.verdict == "structure"
    assert found.findings[0]["mechanism"] == "coulomb_friction"
    low, high = found.findings[0]["parameters"]["Fc"]["ci95"]
    assert low < 0.75 < high  # a force over the mass of 2


@pytest.mark.long
def test_files_that_are_equal_leave_nothing_to_learn():
    one = run("sim.csv", 0.0, 1, 0.0)
    with pytest.raises(InputError, match="no channel differs"):
        learn_simulator([one], [one])
    with pytest.raises(InputError, match="2 simulated files for 1"):
        learn_simulator([one, one], [one])
