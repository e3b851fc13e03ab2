"""Models as Functional Mock-up Units: they run elsewhere as the simulator does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import jaxsr
from jaxsr import cli
from jaxsr.models import Simulator, parse_model


def test_an_fmu_runs_as_the_simulator_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fmpy = pytest.importorskip("fmpy")
    pytest.importorskip("pythonfmu")
    text = """
[model]
name = "driven pendulum"
states = ["q", "w"]
inputs = ["u"]
outputs = ["q", "speed"]
[equations]
q = "w"
w = "u/J - 9.81*sin(q) - c*w*Abs(w) + 0.3*sin(3*t)"
[readings]
q = "q"
speed = "2*w"
[parameters]
c = { value = 0.4, unit = "1" }
J = 2.0
[initial]
q = 1.0
w = -0.5
"""
    pendulum, time = Simulator(parse_model(text)), np.arange(201) * 0.02
    wanted = pendulum.simulate(jaxsr.Recording("r", time, {"u": np.full(201, 1.5)})).channels
    path = tmp_path / "pendulum.fmu"
    (tmp_path / "model.toml").write_text(text)
    command = ["export", str(tmp_path / "model.toml"), "--to", "fmu", "--out", str(path)]
    assert cli.main(command) == 0
    held = {"start_time": 0.0, "stop_time": 4.0, "output_interval": 0.02}
    run = fmpy.simulate_fmu(str(path), start_values={"u": 1.5}, **held)
    np.testing.assert_allclose(run["time"], time, atol=1e-12)
    for name in ("q", "speed"):
        scale = np.abs(wanted[name]).max()
        np.testing.assert_allclose(run[name], wanted[name], atol=1e-6 * scale)
    at_rest = {"start.q": 0.2, "start.w": 0.0, "c": 0.0, "u": 0.0}
    moved = fmpy.simulate_fmu(str(path), start_values=at_rest, **held)
    assert moved["q"][0] == pytest.approx(0.2) and moved["speed"][0] == pytest.approx(0.0)
    assert cli.main(command[:-2]) == 2
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(jaxsr.InputError, match="needs pythonfmu"):
        pendulum.export("fmu")
