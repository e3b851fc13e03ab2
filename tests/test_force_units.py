"""Units of forces and of their constants, and parameters that are constants of nature."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from test_models_vector_fields import read as read_function

from jaxsr.diagnosis.mechanisms import force_candidates, sites_of
from jaxsr.expressions.unit_text import dimensionality, si_factor
from jaxsr.models import Parameter, parse_model
from jaxsr.models.force_units import compose, force_unit, in_base_units
from jaxsr.models.physical_constants import constant_of, fixed_for_good, remarks

UNITS = ("N", "N*m", "m/s^2", "kg*m^2", "V", "A", "N*s/m", "1/s", "1", "(N*m)/(rad/s)", "Pa", "K/W")


@pytest.mark.parametrize(("above", "below"), list(itertools.product(UNITS, UNITS)))
def test_composed_units_have_the_dimension_of_the_quotient(above: str, below: str) -> None:
    text = compose(above, [below])
    assert text is not None
    assert dimensionality(text) == dimensionality(above) / dimensionality(below)
    product = compose(text, [compose("1", [below]) or ""])
    assert product is not None
    assert dimensionality(product) == dimensionality(above)


@pytest.mark.parametrize("unit", UNITS)
def test_base_units_say_the_dimension(unit: str) -> None:
    assert dimensionality(in_base_units(dimensionality(unit))) == dimensionality(unit)


def test_roots_are_written_with_brackets() -> None:
    text = compose("1", ["V*s^(1/2)"])
    assert text == "1/V/s^(0.5)"
    assert dimensionality(text) == dimensionality("V**-1*s**(-1/2)")


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("cm/s^2", 0.01), ("m/s^2", 1.0), ("kN*mm", 1.0), ("g", 1e-3), ("Nm", 1.0), ("1", 1.0)],
)
def test_factors_of_the_si(unit: str, factor: float) -> None:
    assert si_factor(unit) == pytest.approx(factor, rel=1e-12)


SERVO = """
[model]
states = ["q", "w"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "w"
w = "{equation}"
[readings]
y = "q"
[parameters]
{parameters}
[units]
q = "rad"
w = "rad/s"
u = "{input}"
y = "rad"
"""
PARAMETERS = {
    "J": 'value = 0.1, unit = "kg*m^2"',
    "b": 'value = 0.1, unit = "N*m*s/rad"',
    "G": 'value = 0.1, unit = "N*m"',
    "K": 'value = 0.1, unit = "N*m/A"',
    "Km": 'value = 0.1, unit = "rad/s^2/A"',
    "c": 'value = 0.1, unit = "1/s"',
    "w0": 'value = 2.0, unit = "1/s"',
}


def servo(equation: str, unit: str = "N*m", without: str = ""):
    parameters = "\n".join(f"{n} = {{ {v} }}" for n, v in PARAMETERS.items() if n in equation)
    if without:
        parameters = parameters.replace(f', unit = "{without}"', "")
    return parse_model(SERVO.format(equation=equation, parameters=parameters, input=unit))


@pytest.mark.parametrize(
    ("equation", "input_unit", "expected"),
    [
        ("(u - b*w - G*sin(q))/J", "N*m", "N*m"),
        ("u/J - b*w/J", "N*m", "N*m"),
        ("(K*u - b*w)/J", "A", "N*m"),
        ("K*u/J - b*w/J", "A", "N*m"),  # not in A, as beside the current
        ("u/J - c*w", "N*m", "N*m"),
        ("u - c*w", "rad/s^2", "rad/s^2"),
        ("w0**2*(u - q)", "rad", "rad/s^2"),  # a force is no angle
        ("Km*(u - c*w/Km)", "A", "A"),
    ],
)
def test_units_of_forces(equation: str, input_unit: str, expected: str) -> None:
    model = servo(equation, input_unit)
    assert force_unit(model, "w") == expected
    (site,) = sites_of(model, {})
    units = {c.mechanism: c.parameters[0].unit for c in force_candidates(model, {})}
    assert units["coulomb_friction"] == expected
    assert units["viscous_damping"] == site.per("w")
    found = dimensionality(units["viscous_damping"])
    assert found * dimensionality("1/s") == dimensionality(expected)


def test_units_that_are_missing_are_not_made_up() -> None:
    # the input stands in the bracket by itself
    assert force_unit(servo("(u - b*w)/J", without="kg*m^2"), "w") == "N*m"
    # of K*u nothing is known without the inertia's unit
    assert force_unit(servo("(K*u - b*w)/J", "A", without="kg*m^2"), "w") is None
    text = SERVO.partition("[units]")[0]
    plain = parse_model(text.format(equation="(u - b*w)/J", parameters="J.value = 1\nb.value = 1"))
    assert force_unit(plain, "w") is None


def test_levels_and_flows_have_the_unit_of_a_flow() -> None:
    model = parse_model("""
        [model]
        states = ["h"]
        inputs = ["flow"]
        outputs = ["y"]
        [equations]
        h = "(flow - k*sqrt(h))/A"
        [readings]
        y = "h"
        [parameters]
        k = { value = 0.1, unit = "m^2.5/s" }
        A = { value = 0.1, unit = "m^2" }
        [units]
        h = "m"
        flow = "m^3/s"
        y = "m"
        """)
    assert force_unit(model, "h") == "m^3/s"


def test_a_python_function_keeps_the_unit_of_its_input() -> None:
    model = read_function(lambda t, x, u, p: [x[1], (u[0] - p["m"] * x[1]) / p["m"]]).model
    assert model.force_factors == {}  # its columns say how forces enter


@pytest.mark.parametrize(
    ("value", "unit", "name"),
    [
        (9.81, "m/s^2", "standard acceleration of gravity"),
        (-9.8, "m/s**2", "standard acceleration of gravity"),
        (981.0, "cm/s^2", "standard acceleration of gravity"),
        (9.81, "N/kg", "standard acceleration of gravity"),
        (8.314, "J/(mol*K)", "molar gas constant"),
        (1.381e-23, "J/K", "Boltzmann constant"),
        (96485.0, "C/mol", "Faraday constant"),
        (9.83, "m/s^2", None),  # two per mille
        (9.81, "N", None),
        (9.81, None, None),
        (9.81, "1", None),
        (1.0, "ohm", None),  # as a unit was once realised
        (1.0e5, "Pa", None),  # a round number
        (0.0, "m/s^2", None),
    ],
)
def test_constants_of_nature(value: float, unit: str | None, name: str | None) -> None:
    found = constant_of(Parameter(value, unit))
    assert (None if found is None else found.name) == name
    assert constant_of(Parameter(value, unit, (0.5 * value, 2.0 * value))) is None


def test_a_fifth_of_a_per_mille_of_drawn_values_at_most_is_a_constant() -> None:
    rng = np.random.default_rng(0)
    units = ("m/s^2", "N", "kg", "ohm", "Pa", "V", "m", "N*m/A")
    drawn = [Parameter(float(v), u) for u in units for v in np.exp(rng.uniform(-5.0, 5.0, 2000))]
    assert sum(constant_of(p) is not None for p in drawn) < 2e-4 * len(drawn)


PENDULUM = """
[model]
states = ["q", "w"]
outputs = ["y"]
[equations]
q = "w"
w = "-g/l*sin(q)"
[readings]
y = "q"
[parameters]
g = { value = 9.81UNIT }
l = { value = 0.5 }
"""


def test_gravity_is_never_called_wrong() -> None:
    model = parse_model(PENDULUM.replace("UNIT", ', unit = "m/s^2"'))
    wrong = [c.fixed_parameter for c in force_candidates(model, {}) if c.fixed_parameter]
    assert wrong == ["l"]
    assert list(fixed_for_good(model)) == ["g"] and not list(remarks(model))


def test_a_gravity_without_a_unit_is_told() -> None:
    model = parse_model(PENDULUM.replace("UNIT", ""))
    wrong = [c.fixed_parameter for c in force_candidates(model, {}) if c.fixed_parameter]
    assert wrong == ["g", "l"]
    (row,) = remarks(model)
    assert row["message"] == "g = 9.81 looks like standard gravity; give its unit (m/s^2) to fix it"
