"""Dimensions of terms: known laws, the algebra's rules, and agreement with pint."""

import pickle
import time

import numpy as np
import pint
import pytest

from jaxsr._result import InputError
from jaxsr.evolution import PrimitiveSet
from jaxsr.evolution.create import random_term
from jaxsr.expressions import PRIMITIVES, Term, evaluate, parse
from jaxsr.expressions.dimensions import NONE, Dimensions, Open, admissible, dimension
from jaxsr.expressions.editing import simplify

UNITS = {
    "x": "m", "v": "m/s", "t": "s", "m": "kg", "F": "N", "q": "rad", "w": "rad/s", "T": "K",
}  # fmt: skip


@pytest.mark.parametrize(
    "text",
    [
        "x*v", "sin(2.0*x)", "x + 2.0*v", "x**2.5", "1.0", "v*Abs(v)", "sin(q)", "cos(w*t)",
        "sign(v)", "Heaviside(x)*v", "tanh(v/0.1)", "exp(-3.0*Abs(v))*sign(v)", "sqrt(x)*v",
        "x/(x + 0.5)", "Max(x - 0.1, 0.0)", "sin(0.3*t + 1.0)", "atan2(x, v*t)", "F/m",
        "Piecewise((x, v > 0.0), (v*t, True))", "x*sin(x/(v*t))", "2.0**q", "unknown + x",
        "log(T/300.0)", "(3.0*x)**q",
    ],
)  # fmt: skip
def test_terms_of_known_laws_are_admitted(text):
    assert admissible(parse(text), UNITS)


@pytest.mark.parametrize(
    "text",
    [
        "x + v", "sin(x)", "exp(-v)", "tanh(v)", "log(T)", "x*(v + t)", "Max(x, v)", "asin(F)",
        "x**q + v", "x**t", "atan2(x, v)", "Piecewise((x, x > v), (2.0*x, True))", "q**x",
        "Piecewise((x, v > 0.0), (v, True))", "sign(x + v)", "cos(x*v)*q", "x - F/m",
    ],
)  # fmt: skip
def test_terms_without_meaning_are_not(text):
    assert not admissible(parse(text), UNITS)


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("m*v**2", "J"), ("sqrt(F*x/m)", "m/s"), ("F*v", "W"),
        ("v**2/x", "m/s^2"), ("Abs(x)/t", "m/s"), ("sign(v)", "1"), ("F/(m*w**2)", "m"),
        ("x**0.5*x**1.5", "m^2"), ("-x", "m"), ("w*t", "1"),
    ],
)  # fmt: skip
def test_dimension_of_a_term(text, unit):
    assert Dimensions(UNITS).of(parse(text)) == dimension(unit)


def test_roots_of_powers_come_back_whole():
    cube = Term.apply("pow", Term.variable("x"), Term.constant(3.0))
    back = Term.apply("pow", cube, Term.constant(1.0 / 3.0))
    assert Dimensions(UNITS).of(back) == dimension("m")


def test_integrals_multiply_by_what_they_run_over():
    if "integral" not in PRIMITIVES:
        pytest.skip("no integrals in this primitive set")
    known = Dimensions(UNITS)
    assert known.of(Term.apply("integral", Term.variable("v"))) == dimension("m")
    work = Term.apply("integral_over", Term.variable("F"), Term.variable("x"))
    assert known.of(work) == dimension("J")


def test_constants_and_unlabelled_variables_fit_anywhere():
    known = Dimensions(UNITS)
    assert known.of(parse("3.0")) is Open.ANY
    assert known.of(parse("2.0*x")) is Open.ANY
    assert known.of(parse("2.0*x + v")) == dimension("m/s")
    assert known.of(parse("x + v")) is Open.NEVER
    assert known.of(parse("other*x")) is Open.ANY
    assert dimension("1") == dimension("") == dimension("rad") == NONE


def test_products_of_variables_have_the_dimension_that_pint_gives():
    registry = pint.UnitRegistry()
    rng = np.random.default_rng(3)
    known = Dimensions(UNITS)
    names = list(UNITS)
    for _ in range(60):
        term, quantity = None, registry.Quantity(1.0, "")
        for _ in range(4):
            name, power = names[rng.integers(len(names))], float(rng.integers(-3, 4))
            factor = Term.apply("pow", Term.variable(name), Term.constant(power))
            term = factor if term is None else Term.apply("mul", term, factor)
            quantity = quantity * registry.Quantity(1.0, UNITS[name]) ** power
        assert term is not None
        expected = dict(quantity.dimensionality)
        bases = ("[length]", "[mass]", "[time]", "[current]", "[temperature]")
        found = known.of(term)
        assert not isinstance(found, Open)
        assert found[:5] == tuple(expected.get(base, 0.0) for base in bases)


def test_meaning_does_not_change_with_the_units_of_measurement():
    """A term without constants is admitted if, and only if, rescaled variables rescale it."""
    rng = np.random.default_rng(0)
    primitives = PrimitiveSet(functions=("add", "mul", "div", "sin", "abs", "sqrt", "sign"))
    known = Dimensions(UNITS)
    values = {n: float(rng.uniform(0.5, 2.0)) for n in UNITS}
    scale = np.exp(rng.normal(size=7))
    scaled = {n: values[n] * float(np.prod(scale ** dimension(u))) for n, u in UNITS.items()}
    seen = {True: 0, False: 0}
    for _ in range(3000):
        term = random_term(rng, ["x", "v", "t", "F", "m"], primitives, 7)
        if any(node.is_constant for node in term.walk()):
            continue
        # x - x, x/x and Abs(v) - Abs(v) scale although what stands in them need not
        if simplify(term).size < term.size:
            continue
        with np.errstate(all="ignore"):
            before, after = evaluate(term, values), evaluate(term, scaled)
        found = known.of(term)
        seen[found is not Open.NEVER] += 1
        if not isinstance(found, Open):
            expected = before * float(np.prod(scale ** np.array(found)))
            np.testing.assert_allclose(after, expected, rtol=1e-9)
    assert min(seen.values()) > 100


def test_units_of_coefficients_bind_when_given():
    # pendulum with drag: q'' = -(g/l) sin q - c q' + torque/(m l^2)
    units = {"q": "rad", "w": "rad/s", "u": "N*m", "t": "s"}
    free = Dimensions(units)
    strict = Dimensions(units, "rad/s^2", ["1", "1/s", "1/s^2", "1/(kg*m^2)"])
    for text in ("sin(q)", "w", "u", "w**2", "q", "cos(2.0*t)", "1.0", "w*Abs(w)"):
        assert free.admissible(parse(text)) and strict.admissible(parse(text)), text
    for text in ("u*w", "t", "u**2", "w**3"):
        assert free.admissible(parse(text)) and not strict.admissible(parse(text)), text
    assert not strict.admissible(parse("sin(w)"))


@pytest.mark.parametrize("unit", ["m**(9**9**9)", "hello", "m.__class__", "9*m", "m)", "m("])
def test_text_that_is_no_unit_is_refused_in_one_line(unit):
    with pytest.raises(InputError, match="unit") as error:
        Dimensions({"x": unit})
    assert "\n" not in str(error.value)


def test_units_of_coefficients_need_a_target():
    with pytest.raises(InputError, match="target"):
        Dimensions(UNITS, coefficients=["1"])


def test_thousands_of_terms_a_second():
    rng = np.random.default_rng(1)
    terms = [random_term(rng, list(UNITS), PrimitiveSet(), 12) for _ in range(4000)]
    known = Dimensions(UNITS)
    began = time.process_time()
    kept = sum(known.admissible(term) for term in terms)
    assert 0 < kept < len(terms)
    assert time.process_time() - began < 2.0


def test_it_pickles():
    known = pickle.loads(pickle.dumps(Dimensions(UNITS, "m", ["1"])))
    assert known.admissible(parse("x")) and not known.admissible(parse("v"))
