"""Added mass: offered however a model says its masses, and what it does."""

from __future__ import annotations

import numpy as np
import pytest

from jaxsr.diagnosis.mechanisms import sites_of
from jaxsr.diagnosis.mechanisms.inertial import inertial
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.models import Model, Simulator, parse_model

HEAD = """
[model]
states = ["x1", "x2", "v1", "v2", "i"]
inputs = ["u"]
outputs = ["y1", "y2"]
[equations]
x1 = "v1"
x2 = "v2"
i = "(u - R*i)/L"
"""
TAIL = """
[readings]
y1 = "x1"
y2 = "x2"
[parameters]
m = { value = 2.0 }
M = { value = 6.0 }
k = { value = 30.0, bounds = [10.0, 90.0] }
d = { value = 0.4 }
R = { value = 1.3 }
L = { value = 0.2 }
"""
FORMS = {
    "divided": """
v1 = "(i - k*x1 - k*(x1 - x2))/m"
v2 = "(-k*(x2 - x1) - d*v2)/M"
""",
    "each term": """
v1 = "i/m - k*x1/m - k*(x1 - x2)/m"
v2 = "k/M*(x1 - x2) - d*v2/M"
""",
    "rows": """
v1 = "i - k*x1 - k*(x1 - x2)"
v2 = "-k*(x2 - x1) - d*v2"
[inertia]
v1 = { v1 = "m" }
v2 = { v2 = "M" }
""",
}


def heavier(model: Model, state: str) -> tuple[Simulator, tuple[float, ...]]:
    """The model with an added mass of 0.7 along one equation."""
    scale = {s: np.linspace(-1.0, 1.0, 5) for s in model.states}
    (site,) = [s for s in sites_of(model, scale) if s.state == state]
    (mass,) = [c for c in inertial(site) if c.mechanism == "added_mass"]
    known = SuperModel.build(model, (mass,))
    simulator = Simulator(known.model)
    values = dict(zip(known.model.parameters, simulator.values(), strict=True))
    values[known.names[0]["ma"]] = 0.7
    return simulator, tuple(values.values())


def arrays(values: tuple[float, ...]) -> tuple[np.ndarray, ...]:
    return tuple(np.array([value]) for value in values)


@pytest.mark.parametrize("form", FORMS)
def test_the_force_of_a_heavier_mass_is_as_before(form: str) -> None:
    """v' = F/(m + ma), to the rounding of single precision, at states drawn."""
    model = parse_model(HEAD + FORMS[form] + TAIL).pinned()
    rng, plain, zero = np.random.default_rng(0), Simulator(model), np.zeros(1)
    for state, mass in (("v1", 2.0), ("v2", 6.0)):
        changed, values = heavier(model, state)
        at = model.states.index(state)
        for _ in range(20):
            x, u = tuple(rng.normal(size=(5, 1))), tuple(rng.normal(size=(1, 1)))
            before = plain.rates(zero, x, u, arrays(plain.values()))
            after = changed.rates(zero, x, u, arrays(values))
            wanted = np.array(before, float)
            wanted[at] *= mass / (mass + 0.7)
            np.testing.assert_allclose(np.array(after, float), wanted, rtol=1e-5)


@pytest.mark.parametrize("form", FORMS)
def test_what_does_not_move_has_no_mass(form: str) -> None:
    model = parse_model(HEAD + FORMS[form] + TAIL).pinned()
    scale = {s: np.linspace(-1.0, 1.0, 5) for s in model.states}
    offered = {c.label for site in sites_of(model, scale) for c in inertial(site)}
    masses = {label for label in offered if label.startswith("added_mass")}
    assert masses == {"added_mass@equation:v1", "added_mass@equation:v2"}
