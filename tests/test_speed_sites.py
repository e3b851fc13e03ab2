"""Which states without a position are speeds, along which friction and drag may act."""

from __future__ import annotations

import numpy as np
import pytest

from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.setup import state_scale
from jaxsr.models import parse_model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

MODEL = """
[model]
name = "plant"
states = ["v", "F"]
inputs = ["u"]
outputs = ["y"]
[equations]
v = "{law}"
F = "(u - F)/T"
[readings]
y = "v"
[parameters]
m = {{ value = 2.0 }}
c = {{ value = 0.3 }}
T = {{ value = 0.5 }}
"""
TIME = np.linspace(0.0, 4.0, 200)


def offered(law: str, speed: np.ndarray) -> set[str]:
    """Mechanisms that may act along v, whose unit nobody says."""
    model = parse_model(MODEL.format(law=law))
    record = Recording("run", TIME, {"u": np.cos(TIME), "y": speed})
    scale = state_scale(model, [Prepared.build(model, record)])
    return {c.mechanism for c in force_candidates(model, scale) if c.site == "equation:v"}


@pytest.mark.parametrize("law", ["(F - c*v*Abs(v))/m", "(F - sign(v)*c)/m", "(F - c*sign(v))/m"])
def test_what_a_law_takes_the_sign_or_the_size_of_is_a_speed(law: str) -> None:
    assert {"viscous_damping", "coulomb_friction"} <= offered(law, 20.0 + np.sin(TIME))


@pytest.mark.parametrize("law", ["(F - c*v)/m", "(F - c*sqrt(Abs(v)))/m"])
def test_what_never_turns_round_is_a_level_or_a_temperature(law: str) -> None:
    assert "viscous_damping" not in offered(law, 20.0 + np.sin(TIME))
    assert "viscous_damping" in offered(law, np.sin(TIME))
