"""What is dear asks for its time, and what time ends leaves an answer."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lsim

from benchmarks.chains import model as chain_model
from jaxsr._deadline import OutOfTime, ask, limited, unlimited
from jaxsr._files import dump_json
from jaxsr._progress import Budget, Silent
from jaxsr.diagnosis import diagnose
from jaxsr.diagnosis.explaining.value_findings import expected_weight, weight_of_value
from jaxsr.diagnosis.failures import Failures
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import build_arena, neutral_values
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.tangent import _finite
from jaxsr.discovery import affordable
from jaxsr.discovery.affordable import evenly
from jaxsr.discovery.samples import roles
from jaxsr.discovery.thinning import thin
from jaxsr.discovery.treatment import treat
from jaxsr.models import Simulator, parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared
from jaxsr.models.states import spread
from jaxsr.recordings import Recording
from jaxsr.report.exploring import _every


def over() -> bool:
    return True


def test_limits_hold_inside_each_other_and_end_with_their_block():
    ask()
    with limited(over):
        with pytest.raises(OutOfTime):
            ask()
        with limited(lambda: False), pytest.raises(OutOfTime):
            ask()
        with unlimited():
            ask()
        with pytest.raises(OutOfTime):
            ask()
    ask()


def test_what_time_ends_did_not_break():
    failures = Failures(Silent())
    with limited(over):
        assert failures.attempt("growing sets", ask, "before") == "before"
    assert failures.lines == []


def chain(masses: int, samples: int) -> tuple[Simulator, Recording]:
    """A chain's model, and a recording in which every mass swings by itself."""
    time = 0.02 * np.arange(samples)
    rng = np.random.default_rng(0)
    channels = {"u": np.sin(2.0 * time)}
    for k in range(masses):
        channels[f"q{k + 1}"] = np.sin((1.0 + 0.3 * k) * time) + 1e-3 * rng.normal(size=samples)
    return Simulator(parse_model(chain_model(masses))), Recording("chain.csv", time, channels)


def test_without_any_time_nothing_is_run_and_the_given_values_are_told_as_such(monkeypatch):
    """Not one step of a simulation: each may last longer than what is left of a budget."""
    begun: list[int] = []
    monkeypatch.setattr("jaxsr.models.transitions._before", lambda *_, **__: begun.append(1))
    simulator, record = chain(6, 300)
    found = diagnose(simulator, [record], held_out=[record], budget=1e-9)
    assert begun == []
    assert found.verdict == "undecided" and found.document["findings"] == []
    assert found.document["provenance"]["stopped_by"] == "budget"
    assert np.isnan(np.array(found.document["fit"]["train"]["given"], dtype=float)).all()
    json.loads(dump_json(found.document), parse_constant=lambda name: pytest.fail(name))
    for name, row in found.document["calibration"].items():
        parameter = simulator.model.parameters[name]
        assert row == {"value": parameter.value, "ci95": list(parameter.bounds or ())}


def test_what_a_value_matters_is_told_by_the_linearisation_as_by_an_estimate():
    """A spring and a damper 2 % off: the squared error without each is quadratic there."""
    model = parse_model("""
[model]
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u - c*v - k*q"
[readings]
y = "q"
[parameters]
c = { value = 0.41, bounds = [0.0, 5.0] }
k = { value = 20.4, bounds = [5.0, 60.0] }
""")
    rng, time = np.random.default_rng(0), 0.02 * np.arange(400)
    u = np.sin(np.outer(time, rng.uniform(1.0, 8.0, 6))).sum(1)
    y = lsim(([1.0], [1.0, 0.4, 20.0]), u, time)[1] + 1e-3 * rng.normal(size=400)
    prepared = (Prepared.build(model, Recording("r.csv", time, {"u": u, "y": y})),)
    super_model, simulator = SuperModel.build(model, []), Simulator(model)
    scale = 0.01 * spread(prepared[0].outputs)
    arena = build_arena(super_model, prepared, Stepping("rk4", 1), 2.0, scale, simulator)
    given = neutral_values(super_model)
    null = enter(arena, (), given)
    case = SimpleNamespace(budget=Budget(), simulator=simulator)
    parts: Any = SimpleNamespace(arena=arena, null=null, case=case)
    worst = 1e3 * null.fit.cost
    for name in ("c", "k"):
        estimated, told = (w(parts, name, worst) for w in (weight_of_value, expected_weight))
        assert told.times == pytest.approx(estimated.times, rel=0.05)
        assert told.share == pytest.approx(estimated.share, rel=0.1, abs=1e-4)
        assert estimated.times > 1.05


def test_many_signals_on_a_slow_machine_are_smoothed_evenly_and_fewer(monkeypatch):
    time = 0.01 * np.arange(3000)
    rng = np.random.default_rng(0)
    names = [f"x{k}" for k in range(20)]
    channels = {n: np.sin(3.0 * time + k) for k, n in enumerate(names)}
    channels = {n: x + 0.01 * rng.normal(size=time.size) for n, x in channels.items()}
    record, part = Recording("r.csv", time, channels), roles(names, None, 1, (), None)
    data = thin([record] * 4, part, 5.0)
    assert len(data.searched) > 2
    assert evenly(data, part, Budget()) is None
    monkeypatch.setattr(affordable, "_pace", lambda: 1.0)
    assert evenly(data, part, Budget(1000.0)) is None
    monkeypatch.setattr(affordable, "_pace", lambda: 30.0)
    few = evenly(data, part, Budget(20.0))
    assert few is not None and len(few.searched) < len(data.searched)
    assert few.rows == sum(len(r) for r in few.searched)


def test_a_signal_that_is_smoothed_evenly_keeps_its_course():
    rng, time = np.random.default_rng(1), 0.02 * np.arange(500)
    signal = treat(time, np.sin(3.0 * time) + 0.02 * rng.normal(size=500), hurried=True)
    assert not signal.clean and not signal.weak and np.ptp(signal.noise) == 0.0
    inside = slice(20, -20)
    assert np.abs(signal.values - np.sin(3.0 * time))[inside].max() < 0.02
    slope, _ = signal.derivative(1)
    assert np.abs(slope - 3.0 * np.cos(3.0 * time))[inside].max() < 0.2


def test_of_nothing_nothing_is_carried_and_nothing_overflows():
    assert np.zeros(0)[_every(0, 500)].size == 0
    assert _finite(np.zeros((0, 0, 5, 2))).shape == (0, 0, 5, 2)


HIDDEN = """
[model]
states = ["q", "v", "z"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u - 4.0*q - v + z"
z = "(u - z)/0.1"
[readings]
y = "q"
"""


def test_following_a_hidden_state_asks_for_its_time() -> None:
    """A step a sample over a long recording; only after so many is time asked again."""
    time = 0.01 * np.arange(300)
    recording = Recording("a", time, {"y": np.sin(time), "u": np.cos(time)})
    model, asked = parse_model(HIDDEN), []

    def later() -> bool:
        asked.append(1)
        return len(asked) > 2

    with pytest.raises(OutOfTime), limited(later):
        Prepared.build(model, recording)
    assert len(asked) == 3
    with limited(lambda: False):
        assert np.ptp(Prepared.build(model, recording).states.values[:, 2]) > 0.1
