"""Mass matrices of any pattern are solved, and those without an inverse are refused."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.expressions import evaluate, parse
from jaxsr.models import Model, Simulator, parse_model
from jaxsr.models.field import Field, Point
from jaxsr.models.mass_matrix import pivoted_rows
from jaxsr.models.reading import build_model
from jaxsr.models.solvability import never_finite
from jaxsr.models.stepping import factorised


def plant(inertia: str, values: str = "m = 2.0\nl = 0.5") -> Model:
    states = ["w0", "w1", "w2"]
    equations = "\n".join(f'{s} = "{k}.0*w0 + sin(w1) + m"' for k, s in enumerate(states, 1))
    return parse_model(
        f'[model]\nstates = {json.dumps(states)}\noutputs = ["y"]\n[equations]\n{equations}\n'
        f'[readings]\ny = "w0"\n[parameters]\n{values}\n[inertia]\n{inertia}',
        "m.toml",
    )


REGULAR = {
    "swapped": ('w0 = { w1 = "1.0" }\nw1 = { w0 = "1.0" }', ("w1", "w0")),
    "pivot vanishes at w2 = pi/2": (
        'w0 = { w0 = "cos(w2)", w1 = "m" }\nw1 = { w0 = "3 + m", w1 = "cos(w2)" }',
        ("w1", "w0"),
    ),
    "ring": (
        'w0 = { w1 = "l", w2 = "1" }\nw1 = { w0 = "2", w2 = "3*m" }\nw2 = { w0 = "l" }',
        ("w2", "w0", "w1"),
    ),
    "leading minor of nothing": (
        'w0 = { w0 = "1", w1 = "1" }\nw1 = { w0 = "1", w1 = "1", w2 = "1" }\nw2 = { w1 = "1" }',
        None,
    ),
    "a rate known beforehand": ('w0 = { w0 = "m", w2 = "l" }', ("w0",)),
    "positive definite": (
        'w0 = { w0 = "m", w1 = "l*cos(w2)" }\nw1 = { w0 = "l*cos(w2)", w1 = "m" }',
        ("w0", "w1"),
    ),
}


@pytest.mark.parametrize("name", REGULAR)
def test_rates_are_those_of_a_general_solver(name: str) -> None:
    inertia, order = REGULAR[name]
    model = plant(inertia)
    simulator = Simulator(model)
    x, p = (0.3, 0.2, np.pi / 2), simulator.values()
    env = dict(zip((*model.states, *model.parameters), (*x, *p), strict=True))
    matrix = np.eye(3)
    for i, row in model.inertia_terms.items():
        matrix[model.states.index(i)] = [
            evaluate(row[j], env) if j in row else 0.0 for j in model.states
        ]
    forces = [float(evaluate(model.equation_terms[s], env)) for s in model.states]
    expected = np.linalg.solve(matrix, forces)
    if order is not None:
        assert simulator.mass_rows == order
    np.testing.assert_allclose(np.ravel(simulator.rates(0.0, x, (), p)), expected, rtol=1e-5)
    field = Field(simulator, p, active=("m",))
    at = Point(0.0, [np.array([a]) for a in x], [])
    rates, slopes = field.slopes(at)
    np.testing.assert_allclose(np.ravel(rates), expected, rtol=1e-10)
    for name, column in (("w1", 1), ("w2", 2)):
        moved = [np.array([a + 1e-6 * (k == column)]) for k, a in enumerate(x)]
        ahead = np.ravel(field.rates(Point(0.0, moved, [])))
        told = [float(np.ravel(row.get(name, 0.0))[0]) for row in slopes]
        np.testing.assert_allclose(told, (ahead - expected) / 1e-6, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("inertia", "values", "words"),
    [
        ('w0 = { w0 = "m" }', "m = 0.0", ["[inertia] w0", "m = 0", "other than zero"]),
        ('w0 = { w0 = "0.0" }', "m = 1.0", ["[inertia] w0", "zero"]),
        ('w0 = { w1 = "m" }', "m = 1.0", ["[inertia] w0", "no mass for the rates of w0"]),
        ('w0 = { w0 = "m*(l - 0.5)" }', "m = 1.0\nl = 0.5", ["[inertia] w0", "m = 1, l = 0.5"]),
        ('w0 = { w1 = "m" }\nw1 = { w1 = "m" }', "m = 1.0", ["[inertia]", "the rate of w0"]),
        (
            'w0 = { w0 = "m", w1 = "m" }\nw1 = { w0 = "m", w1 = "m" }',
            "m = 1.0",
            ["[inertia]", "w0, w1", "singular", "independent"],
        ),
        (
            'w0 = { w0 = "cos(w2)", w1 = "2*sin(w2)" }\n'
            'w1 = { w0 = "3*cos(w2)", w1 = "6*sin(w2)" }',
            "m = 1.0",
            ["singular"],
        ),
        ('w0 = { w0 = "1/m" }', "m = 0.0", ["[inertia] w0.w0", "m = 0", "finite"]),
    ],
)
def test_matrices_without_an_inverse_are_refused(
    inertia: str, values: str, words: list[str]
) -> None:
    with pytest.raises(InputError) as caught:
        plant(inertia, values)
    for word in ["m.toml", *words]:
        assert word in str(caught.value), str(caught.value)


def test_masses_far_apart_are_not_singular() -> None:
    model = plant(
        'w0 = { w0 = "m", w1 = "l" }\nw1 = { w0 = "l", w1 = "1.0" }', "m = 1e-12\nl = 1e-7"
    )
    assert model.inertia["w0"]["w0"] == "m"


def test_a_singular_matrix_gives_no_numbers() -> None:
    solved = factorised([[1.0, 2.0], [0.0, 0.0]])((np.array([1.0]), np.array([1.0])))
    assert np.isnan(solved).all()


VALUES = {"m": 0.0, "k": 2.0, "J": -1.0}


@pytest.mark.parametrize(
    "text",
    [
        *(
            "x/m",
            "k/m",
            "log(m)",
            "sqrt(J)*x",
            "x/(k - 2.0)",
            "exp(1/m)*x",
            "x + log(J)",
            "m**(-1)*x",
        ),
        *("-(x/m)", "x*(k/m)", "Abs(x/m)/k", "1e308*1e308 - x", "Piecewise((2.0, m > 0))"),
    ],
)
def test_what_never_has_a_value_is_found(text: str) -> None:
    assert never_finite(parse(text), VALUES) is not None


@pytest.mark.parametrize(
    "text",
    [
        *("x/k", "m/x", "q**1.5", "log(x)", "sqrt(x*J)", "tanh(1/m)*x", "1/(1/m)", "Max(x, 1/m)"),
        *("Piecewise((x/m, m > 0), (x, True))", "Piecewise((1/m, m > 0), (2.0, True))", "x > 1"),
        *("Piecewise((2.0, m > 0), (x, x > 1))", "atan(x/m)", "Heaviside(m)", "True"),
    ],
)
def test_what_may_have_a_value_is_left_alone(text: str) -> None:
    assert never_finite(parse(text), VALUES) is None


def test_a_parameter_that_differs_by_recording_is_not_judged_by_its_other_value() -> None:
    text = (
        '[model]\nstates = ["q"]\noutputs = ["y"]\n[equations]\nq = "-q/m"\n[readings]\ny = "q"\n'
        "[parameters]\nm = 0.0\n"
    )
    with pytest.raises(InputError, match=r"\[equations\] q: '.*q/m' has no finite value at m = 0"):
        parse_model(text)
    assert parse_model(text + '[per_recording]\nm = { "a.csv" = 1.0 }\n').parameters["m"].value == 0


def test_thousands_of_rows_are_checked_in_time() -> None:
    states = [f"w{k}" for k in range(3000)]
    document = {
        "model": {"states": states, "outputs": ["y"]},
        "equations": dict.fromkeys(states, "1.0"),
        "readings": {"y": "w0"},
        "inertia": {s: {s: "2.0", states[k - 1]: "0.5"} for k, s in enumerate(states)},
    }
    began = time.process_time()
    assert len(pivoted_rows(build_model(document))) == 3000
    assert time.process_time() - began < 2.0
