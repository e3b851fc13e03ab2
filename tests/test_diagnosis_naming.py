"""Laws that were written get the names of the mechanisms whose sum they are."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from diagnosis_systems import TWO_MASSES

from jaxsr.diagnosis.laws.landmarks import Landmarks
from jaxsr.diagnosis.laws.naming import named
from jaxsr.diagnosis.laws.unnamed import law_of
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.expressions import Term, evaluate, parse
from jaxsr.models import parse_model

MODEL = parse_model("""
[model]
states = ["q", "w"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "w"
w = "2*u - b*w"
[inertia]
w = { w = "J" }
[readings]
y = "q"
[parameters]
b = { value = 0.1, unit = "N*m*s/rad", bounds = [0, 1] }
J = { value = 0.1, unit = "kg*m^2", bounds = [0.01, 1] }
[units]
q = "rad"
w = "rad/s"
u = "N*m"
y = "rad"
""")
SITE = sites_of(MODEL, {})[0]


def signals() -> dict:
    t = np.linspace(0.0, 20.0, 2001)
    q = 2.0 * np.sin(1.3 * t) + 0.7 * np.sin(3.1 * t + 0.4)
    u = 3.0 * np.sin(0.9 * t) + np.sin(4.0 * t)
    return {"t": t, "q": q, "w": np.gradient(q, t), "u": u, "b": 0.1, "J": 0.1}


def constants(text: str, loss=None) -> dict[str, dict[str, float]]:
    found = named(SITE, parse(text), signals(), loss)
    return {
        c.mechanism: dict(zip((s.name for s in c.parameters), v, strict=True)) for c, v in found
    }


@pytest.mark.parametrize(
    ("text", "mechanisms"),
    [
        ("-0.41*(Abs(w/6.8)/(w/6.8))", {"coulomb_friction": {"Fc": 0.41}}),
        (
            "0.3*w/(-sqrt(w**2)) + 0.1",
            {"coulomb_friction": {"Fc": 0.3}, "constant_force": {"F0": 0.1}},
        ),
        (
            "-(0.3 + 0.2/exp(sqrt(w**2)/0.2))*Abs(w)/w",
            {"stribeck_friction": {"Fc": 0.3, "Fs": 0.5, "vs": 0.2}},
        ),
        ("Piecewise((-50*(q - 1.5), q > 1.5), (0, True))",
         {"piecewise_stiffness": {"ks": 50.0, "qs": 1.5}}),
        ("-3*(q - 0.3*sign(q))*Heaviside(Abs(q) - 0.3)", {"backlash": {"kb": 3.0, "b": 0.3}}),
        ("-0.3*cos(5.1*t) + 0.4*sin(5.1*t)",
         {"harmonic_force": {"A": 0.5, "w": 5.1, "phi": -np.arctan2(3, 4)}}),
        ("2*Min(u, 2.5) + 2*Max(u, -2.5) - 4*u", {"input_saturation": {"us": 2.5}}),
        ("-0.2*w*sqrt(sqrt(w**2))", {"power_law_drag": {"kd": 0.2, "p": 1.5}}),
        ("-0.3*tanh(w/1e-6)", {"coulomb_friction": {"Fc": 0.3}}),
    ],
)  # fmt: skip
def test_a_law_gets_its_names(text: str, mechanisms: dict) -> None:
    found = constants(text)
    assert found.keys() == mechanisms.keys()
    for name, own in mechanisms.items():
        assert found[name] == pytest.approx(own, rel=1e-4)


@pytest.mark.parametrize(
    "text",
    [
        "0.3*sign(w)",  # drives
        "cos((w/6.8)**2 + 30)",
        "-0.3*tanh(w/0.9)",
        "-q**2*w",
        "-0.5*w*Max(q, 0)",  # a stop that damps and does not push
        "Max(Min(u, 2.5), -2.5) - u",  # half of what a limit of this input does
    ],
)
def test_what_is_no_named_force_gets_no_name(text: str) -> None:
    assert constants(text) == {}


def test_constants_have_the_units_of_the_site() -> None:
    found = named(SITE, parse("-0.4*w/Abs(w) - 0.1*(w/6.8)"), signals())
    units = {c.mechanism: c.parameters[0].unit for c, _ in found}
    assert units["coulomb_friction"] == "N*m" and units["viscous_damping"] == SITE.per("w")


@pytest.mark.slow
def test_what_the_data_cannot_tell_is_the_shorter_one() -> None:
    """A slope at standstill that no sample shows, and one that the data tell."""
    law = "-0.3*tanh(w/0.02)"
    assert constants(law) == {}  # one part in a hundred off, and nothing says that it is hidden
    assert constants(law, lambda difference: 0.0).keys() == {"coulomb_friction"}
    assert constants(law, lambda difference: 1e3) == {}


def test_landmarks_are_what_a_law_holds() -> None:
    found = Landmarks.of(parse("Max(q/2 - 0.4, 0) + exp(-(w/0.2)**2)*sin(3*t) + Abs(w)**1.5"))
    for value in (0.8, 0.2, 1.5):
        assert min(abs(abs(v) - value) for v in found.values) < 1e-9
    assert found.frequencies["t"] == pytest.approx([3.0])


def test_a_proposal_is_a_law_over_the_states_themselves() -> None:
    proposal = SimpleNamespace(
        terms=(parse("sign(w)"), parse("q**2*w")), coefficients=np.array([-2.0, 0.5])
    )
    law = law_of(proposal, {"q": 0.5, "w": 4.0})
    value = evaluate(law, {"q": 1.5, "w": -3.0})
    assert value == pytest.approx(2.0 + 0.5 * 3.0**2 * (-0.75))


TWO = parse_model(TWO_MASSES)
SIMPLE = [
    c
    for c in force_candidates(TWO, {})
    if [p.coefficient for p in c.parameters] == [True] and [s for s, _ in c.terms] == ["vb"]
]


@pytest.mark.long
@pytest.mark.parametrize("mechanism", SIMPLE, ids=lambda c: c.mechanism)
def test_a_course_names_its_mechanism(mechanism):
    rng = np.random.default_rng(0)
    site = next(s for s in sites_of(TWO, {}) if s.state == "vb")
    states = dict(zip(TWO.states, rng.normal(size=(4, 300)), strict=True))
    (spec,) = mechanism.parameters
    term = parse(mechanism.terms[0][1].format(**{spec.name: "c"}))

    def law(value: float) -> Term:
        return term.substitute({"c": Term.constant(value)})

    ((found, values),) = named(site, law(0.7), states)
    assert found.key == mechanism.key and values == pytest.approx([0.7])
    driving = named(site, law(-0.7), states)
    assert (driving == ()) == (spec.low == 0.0)
    other = Term.apply("mul", law(0.7), parse("1 + 0.3*tanh(3*b*vb)"))
    assert named(site, other, states) == ()
