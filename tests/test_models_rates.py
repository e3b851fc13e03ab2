"""Rates as formulas, and accelerometers: d(STATE) in readings."""

from __future__ import annotations

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.expressions import evaluate
from jaxsr.models import Edit, Simulator, apply_edit, parse_model
from jaxsr.models.writing import model_text

SPRUNG = """
[model]
states = ["q", "v"]
inputs = ["u"]
outputs = ["y", "acc"]
[equations]
q = "v"
v = "{force}"
{inertia}
[readings]
y = "q"
acc = "{acc}"
[parameters]
m = 2.0
k = {{ value = 30.0, bounds = [1.0, 100.0] }}
b = 0.4
"""
DIVIDED = "(u - k*q)/m"
MASS = '[inertia]\nv = { v = "m" }'
COUPLED = """
[model]
states = ["q1", "q2", "w1", "w2"]
inputs = ["u"]
outputs = ["a1", "a2"]
[equations]
q1 = "w1"
q2 = "w2"
w1 = "u - 3*sin(q1)"
w2 = "-2*q2 - w2"
[inertia]
w1 = { w1 = "3 + 2*cos(q2)", w2 = "1 + cos(q2)" }
w2 = { w1 = "1 + cos(q2)", w2 = "1" }
[readings]
a1 = "d(w1)"
a2 = "2*d(w2) + q1"
"""


def sprung(acc: str, force: str = DIVIDED, inertia: str = ""):
    return parse_model(SPRUNG.format(force=force, inertia=inertia, acc=acc))


@pytest.mark.parametrize(
    ("acc", "force", "inertia", "named"),
    [
        ("d(v)", DIVIDED, "", "d(v)"),
        ("d( v )", "u - k*q", MASS, "d( v )"),
        (DIVIDED, DIVIDED, "", "d(v)"),
        (DIVIDED, "u - k*q", MASS, "d(v)"),
        ("(u - k*q)/m + b", DIVIDED, "", "d(v) + b"),
        ("2*((u - k*q)/m)", DIVIDED, "", "2.0*d(v)"),
        ("u - k*q", DIVIDED, "", "u - k*q"),
    ],
)
def test_a_reading_that_repeats_an_equation_is_its_rate(acc, force, inertia, named):
    model = sprung(acc, force, inertia)
    assert model.readings["acc"].replace(" ", "") == named.replace(" ", "")
    assert model.readings["y"] == "q"
    assert parse_model(model_text(model)).reading_terms == model.reading_terms


@pytest.mark.parametrize("inertia", ["", MASS])
def test_a_force_that_is_added_is_in_the_accelerometer_too(inertia):
    force = DIVIDED if not inertia else "u - k*q"
    added = "(u - k*q - 0.7*sign(v))/m" if not inertia else "u - k*q - 0.7*sign(v)"
    before = sprung("d(v)", force, inertia)
    after = apply_edit(before, Edit({"equations.v": added}))
    at = {"q": 0.3, "v": -1.5, "u": 2.0, "m": 2.0, "k": 30.0, "b": 0.4, "t": 0.0}
    change = evaluate(after.reading_terms["acc"], at) - evaluate(before.reading_terms["acc"], at)
    assert change == pytest.approx(0.7 / 2.0)


def test_rates_solve_a_coupled_mass_matrix():
    rng = np.random.default_rng(0)
    model = parse_model(COUPLED)
    q1, q2, w1, w2, u = rng.normal(size=(5, 40))
    env = {"q1": q1, "q2": q2, "w1": w1, "w2": w2, "u": u, "t": 0.0}
    c = np.cos(q2)
    mass = np.moveaxis(np.array([[3 + 2 * c, 1 + c], [1 + c, np.ones_like(c)]]), 2, 0)
    force = np.stack([u - 3 * np.sin(q1), -2 * q2 - w2], axis=-1)[..., None]
    expected = np.linalg.solve(mass, force)[..., 0].T
    readings = [np.asarray(evaluate(model.reading_terms[y], env)) for y in ("a1", "a2")]
    np.testing.assert_allclose(readings[0], expected[0], rtol=1e-9)
    np.testing.assert_allclose(readings[1], 2 * expected[1] + q1, rtol=1e-9)
    simulated = Simulator(model).rates(0.0, (q1, q2, w1, w2), (u,), ())
    np.testing.assert_allclose(readings[0], np.asarray(simulated[2]), rtol=1e-5)


@pytest.mark.parametrize("reading", ["d(u)", "d(nothing)", "d(v", "d(v, q)"])
def test_the_rate_of_what_is_no_state_is_refused_in_one_line(reading):
    with pytest.raises(InputError, match=r"\[readings\] acc"):
        sprung(reading)


@pytest.mark.parametrize(
    ("acc", "named"),
    [
        ("(-k*q + u)/m", "d(v)"),
        ("u/m - k/m*q + 9.81", "d(v) + 9.81"),
        ("0.102*(u - q*k)/m", "0.102*d(v)"),
        ("b*(u/m - k*q/m) - 3*q", "b*d(v) - 3.0*q"),  # b is not in the equation
        ("sin(q) - (u - k*q)/m", "-d(v) + sin(q)"),
        ("u - k*q", "u - k*q"),  # the force, not the rate
        ("(u - b*q)/m", "(u - b*q)/m"),
        ("u/m - k*q/m**2", "u/m - k*q/m**2"),
        ("u/m", "u/m"),
    ],
)
@pytest.mark.parametrize(("force", "inertia"), [(DIVIDED, ""), ("u - k*q", MASS)])
def test_an_equation_is_repeated_in_whatever_order(
    acc: str, named: str, force: str, inertia: str
) -> None:
    model = sprung(acc, force, inertia)
    rng = np.random.default_rng(0)
    env = {name: rng.uniform(0.5, 2.0, 50) for name in model.symbols}
    written = evaluate(
        parse_model(SPRUNG.format(force=force, inertia=inertia, acc="q")).term(acc), env
    )
    np.testing.assert_allclose(evaluate(model.reading_terms["acc"], env), written, rtol=1e-12)
    assert ("d(v)" in named) == ("d(v)" in model.readings["acc"])
    again = sprung(named, force, inertia)
    np.testing.assert_allclose(evaluate(again.reading_terms["acc"], env), written, rtol=1e-12)


DEFINED = """
[model]
states = ["q1", "q2", "w1", "w2"]
inputs = ["u"]
outputs = ["a1", "apart", "pos"]
[definitions]
pull = "k*(q1 - q2)"
[equations]
q1 = "w1"
q2 = "w2"
w1 = "(u - pull)/m1"
w2 = "(pull - c*w2)/m2"
[readings]
a1 = "u/m1 - pull/m1"
apart = "(u - pull)/m1 - (k*q1 - k*q2 - c*w2)/m2 + 0.1*q1"
pos = "pull/k"
[parameters]
m1 = 1.0
m2 = 2.0
k = 3.0
c = 1.0
"""


def test_an_equation_is_repeated_through_definitions_and_beside_another() -> None:
    model = parse_model(DEFINED)
    assert model.readings["a1"] == "d(w1)"
    assert model.readings["apart"] == "0.1*q1 + d(w1) - d(w2)"
    assert model.readings["pos"] == "pull/k"
    after = apply_edit(model, Edit({"equations.w2": "(pull - c*w2 - 4*sign(w2))/m2"}))
    at = {"q1": 1.0, "q2": 0.4, "w1": 0.2, "w2": -2.0, "u": 2.0, "t": 0.0}
    at |= {"m1": 1.0, "m2": 2.0, "k": 3.0, "c": 1.0}
    change = evaluate(after.reading_terms["apart"], at) - evaluate(model.reading_terms["apart"], at)
    assert change == pytest.approx(-4.0 / 2.0)


def test_a_rate_in_proportion_to_its_state_is_no_accelerometer() -> None:
    text = (
        '[model]\nstates = ["q"]\noutputs = ["y"]\n[equations]\nq = "-q"\n[readings]\ny = "2*q"\n'
    )
    assert parse_model(text).readings["y"] == "2*q"
