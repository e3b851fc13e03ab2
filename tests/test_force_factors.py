"""How a force enters an equation: read off its text, and written beside the other forces."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from diagnosis_systems import ARM
from test_diagnosis_weak_system import arm_recording, rail_recording, weak

from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.expressions import evaluate
from jaxsr.models import Model, Parameter, Simulator, apply_edit, parse_model, read_model
from jaxsr.models.bracket import add_force
from jaxsr.models.edits import Edit, add_to_equation, difference
from jaxsr.models.field import Field, Point
from jaxsr.models.force_factor import random_points

VALUES = {
    **dict(b=0.1, J=0.5, G=2.0, K=0.3, R=2.0, N=5.0, Jm=0.01, m=2.0, d=0.3, k=10.0, g=9.81),
    **dict(l=0.5, w0=3.0, z=0.1, c1=0.7, Fc=0.4),
}


def model_of(
    equations: Mapping[str, str],
    inputs: Sequence[str] = ("u",),
    definitions: Mapping[str, str] | None = None,
) -> Model:
    states = tuple(equations)
    return Model(
        name="plant",
        states=states,
        inputs=tuple(inputs),
        outputs=("y",),
        equations=dict(equations),
        readings={"y": states[0]},
        definitions=dict(definitions or {}),
        parameters={n: Parameter(v) for n, v in VALUES.items()},
    )


def axis(equation: str, **more) -> Model:
    return model_of({"q": "w", "w": equation}, **more)


def factor_at(model: Model, state: str) -> np.ndarray | float:
    """The factor of a force along a state in its own rate, at random points."""
    if state not in model.force_factors:
        return 1.0
    return evaluate(dict(model.force_factors[state].rows)[state], random_points(model))


WRITTEN = [
    ("(u - b*w - G*sin(q))/J", "1/J", "(u - b*w - G*sin(q) - Fc*sign(w))/J"),
    ("u/J - b*w/J", "1/J", "u/J - b*w/J - Fc*sign(w)/J"),
    ("1/J*(u - b*w)", "1/J", "1/J*(u - b*w - Fc*sign(w))"),
    ("(u - b*w)*J**-1", "1/J", "(u - b*w - Fc*sign(w))*J**-1"),
    ("-(b*w - u)/J", "1/J", "-(b*w - u + Fc*sign(w))/J"),
    ("u/J - (b*w + G*sin(q))/J", "1/J", "u/J - (b*w + G*sin(q) + Fc*sign(w))/J"),
    ("(K*u - b*w)/(J + N**2*Jm)", "1/(J + N**2*Jm)", "(K*u - b*w - Fc*sign(w))/(J + N**2*Jm)"),
    ("(K/R*(u - K*w) - b*w)/J", "1/J", "(K/R*(u - K*w) - b*w - Fc*sign(w))/J"),
    ("(k*(u - q) - d*w)/m", "1/m", "(k*(u - q) - d*w - Fc*sign(w))/m"),
    ("u/m - d*w - g", "1/m", "u/m - d*w - g - Fc*sign(w)/m"),
    ("-k*q/m - d*w/m + g", "1/m", "-k*q/m - d*w/m + g - Fc*sign(w)/m"),
    ("(u - b*w)/(J + m*q**2)", "1/(J + m*q**2)", "(u - b*w - Fc*sign(w))/(J + m*q**2)"),
    # the inertia hangs on an input, the angle of a joint that is not part of the model
    (
        "(K*u - b*w)/(J + m*cos(r)**2)",
        "1/(J + m*cos(r)**2)",
        "(K*u - b*w - Fc*sign(w))/(J + m*cos(r)**2)",
    ),
    (
        "u/(J + m*r**2) - b*w/(J + m*r**2)",
        "1/(J + m*r**2)",
        "u/(J + m*r**2) - b*w/(J + m*r**2) - Fc*sign(w)/(J + m*r**2)",
    ),
    # a flow that carries heat multiplies a difference, and divides nothing
    ("r*(u - q)/J", "1/J", "(r*(u - q) - Fc*sign(w))/J"),
    # what may vanish is no inertia
    ("(K*u - b*w)/r", "1", "(K*u - b*w)/r - Fc*sign(w)"),
    # nothing tells a force from a rate
    ("u - d*w", "1", "u - d*w - Fc*sign(w)"),
    ("-g/l*sin(q) - d*w/(m*l**2)", "1", "-g/l*sin(q) - d*w/(m*l**2) - Fc*sign(w)"),
]


@pytest.mark.parametrize(("equation", "factor", "edited"), WRITTEN)
def test_a_force_stands_in_the_bracket(equation: str, factor: str, edited: str) -> None:
    inputs = [name for name in ("u", "r") if re.search(rf"\b{name}\b", equation)]
    model = axis(equation, inputs=inputs)
    expected = evaluate(model.term(factor), random_points(model))
    np.testing.assert_allclose(factor_at(model, "w"), expected, rtol=1e-12)
    assert add_force(model, "w", "- Fc*sign(w)") == (("equations.w", edited),)


def test_definitions_stand_between() -> None:
    definitions = {"torque": "u - b*w", "load": "G*sin(q)", "alpha": "(torque - load)/J"}
    inside = axis("(torque - load)/J", definitions=definitions)
    assert add_force(inside, "w", "- Fc*sign(w)") == (
        ("equations.w", "(torque - load - Fc*sign(w))/J"),
    )
    behind = axis("alpha", definitions=definitions)
    assert add_force(behind, "w", "- Fc*sign(w)") == (("equations.w", "alpha - Fc*sign(w)/J"),)
    alone = axis("torque/J", definitions=definitions)
    assert add_force(alone, "w", "+ c1*q") == (("equations.w", "(torque + c1*q)/J"),)


def drawn(rng: np.random.Generator) -> tuple[Model, str]:
    """A random equation of motion, and its inertia."""
    inertia = str(rng.choice(["J", "m", "(J + N**2*Jm)", "(m*l**2)", "(J + m*sin(q)**2)"]))
    pool = ["G*sin(q)", "b*w", "k*q", "d*w*Abs(w)", "c1*q**3", "K*cos(q)"]
    forces = [str(f) for f in rng.choice(pool, size=rng.integers(1, 4), replace=False)]
    terms = [(rng.choice(["+", "-"]), f) for f in ("u", *forces)]
    rng.shuffle(terms)
    text = " ".join(f"{s} {f}" for s, f in terms)
    opposite = " ".join(f"{'-' if s == '+' else '+'} {f}" for s, f in terms)
    shape = rng.integers(6)
    equation = {
        0: f"({text})/{inertia}",
        1: " ".join(f"{s} {f}/{inertia}" for s, f in terms),
        2: f"1/{inertia}*({text})",
        3: f"-({opposite})/{inertia}",
        4: f"({terms[0][0]} {terms[0][1]})/{inertia} + ({text[2 + len(terms[0][1]) :]})/{inertia}",
        5: f"force/{inertia}",
    }[int(shape)]
    equation = equation.replace("(+ ", "(").replace("(- ", "(-")
    equation = equation.removeprefix("+ ").replace("- ", "-", equation.startswith("- "))
    definitions = {"force": text.removeprefix("+ ").replace("- ", "-", text[0] == "-")}
    return axis(equation, definitions=definitions), inertia


@pytest.mark.parametrize("seed", range(60))
def test_drawn_equations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model, inertia = drawn(rng)
    points = random_points(model)
    expected = 1.0 / evaluate(model.term(inertia), points)
    np.testing.assert_allclose(factor_at(model, "w"), expected, rtol=1e-10)
    force = str(rng.choice(["- Fc*sign(w)", "+ c1*(q/2) + c1*q**2", "- c1*q**2 + Fc", "+ Fc"]))
    edited = apply_edit(model, Edit(dict(add_force(model, "w", force))))
    plain = evaluate(model.equation_terms["w"], points)
    added = evaluate(
        model.term(force.removeprefix("+ ").replace("- ", "-", force[0] == "-")), points
    )
    np.testing.assert_allclose(
        evaluate(edited.equation_terms["w"], points), plain + expected * added, rtol=1e-9
    )
    shape = edited.equations["w"]
    assert len(shape) <= len(model.equations["w"]) + len(force) + len(inertia) + 5, shape


ARM_RATES = {
    "q1": "w1",
    "q2": "w2",
    "w1": "(m22*(tau1 - h1) - m12*(tau2 - h2))/det",
    "w2": "(m11*(tau2 - h2) - m12*(tau1 - h1))/det",
}


def solved_arm() -> tuple[Model, Model]:
    """The demo arm with [inertia], and the same solved for its accelerations."""
    given = read_model(ARM)
    (m11, m12), (_, m22) = ([given.inertia[i][j] for j in ("w1", "w2")] for i in ("w1", "w2"))
    definitions = {
        **given.definitions,
        **{"m11": m11, "m12": m12, "m22": m22, "det": "m11*m22 - m12**2"},
    }
    u1, u2 = given.inputs
    forces = {s: f"({given.equations[s]})" for s in ("w1", "w2")}
    rates = {
        "w1": f"(m22*{forces['w1']} - m12*{forces['w2']})/det",
        "w2": f"(m11*{forces['w2']} - m12*{forces['w1']})/det",
    }
    equations = {**given.equations, **rates}
    solved = apply_edit(given, Edit({f"definitions.{n}": t for n, t in definitions.items()}))
    solved = apply_edit(solved, Edit({f"equations.{s}": t for s, t in equations.items()}))
    from dataclasses import replace

    assert {u1, u2} <= solved.equation_terms["w1"].variables
    return given, replace(solved, inertia={})


def test_joints_solved_for_their_accelerations_keep_their_torques() -> None:
    given, solved = solved_arm()
    assert {s: (f.why, f.beside) for s, f in solved.force_factors.items()} == {
        "w1": ("mass matrix", given.inputs[0]),
        "w2": ("mass matrix", given.inputs[1]),
    }
    force = "- 0.3*sign(w1)"
    edited = apply_edit(solved, Edit(dict(add_force(solved, "w1", force))))
    truth = apply_edit(given, Edit(dict(add_force(given, "w1", force))))
    inside = apply_edit(solved, Edit(dict([add_to_equation(solved, "w1", force, "forces")])))
    assert f"({given.inputs[0]} {force} - Fv1*w1" in edited.equations["w2"]
    rng = np.random.default_rng(0)
    x, u = rng.uniform(-1.0, 1.0, (4, 9)), rng.uniform(-3.0, 3.0, (2, 9))
    at = Point(np.zeros(9), list(x), list(u))
    rates = [
        np.stack(Field(Simulator(m), Simulator(m).values()).rates(at))
        for m in (truth, edited, inside)
    ]
    np.testing.assert_allclose(rates[1], rates[0], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(rates[2], rates[0], rtol=1e-10, atol=1e-12)


def test_the_weak_view_weighs_forces_however_they_are_written() -> None:
    given, solved = solved_arm()
    recording = arm_recording()
    first, second = weak(given, recording), weak(solved, recording)
    np.testing.assert_allclose(second.residual, first.residual, atol=2e-6)
    size = np.abs(first.jacobian).max(0) + 1e-12
    np.testing.assert_allclose(second.jacobian / size, first.jacobian / size, atol=1e-4)


RAIL = """
[model]
states = ["q", "v"]
inputs = ["force"]
outputs = ["y"]
[equations]
q = "v"
v = "(force - Fv*v)/M"
[readings]
y = "q"
[parameters]
M = { value = 1.7, bounds = [0.5, 10.0] }
Fv = { value = 3.3, bounds = [0.0, 30.0] }
"""


def test_the_weak_view_of_a_quotient_is_that_of_a_mass_matrix() -> None:
    divided = parse_model(RAIL)
    inertia = RAIL.replace("(force - Fv*v)/M", "force - Fv*v").replace(
        "[readings]", '[inertia]\nv = { v = "M" }\n[readings]'
    )
    first, second = (weak(m, rail_recording()) for m in (divided, parse_model(inertia)))
    np.testing.assert_allclose(first.residual, second.residual, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(first.jacobian, second.jacobian, rtol=1e-9, atol=1e-12)


def test_an_actuator_between_two_bodies_is_no_mass_matrix() -> None:
    model = model_of({"q": "v", "p": "w", "v": "(u - k*(q - p))/m", "w": "(k*(q - p) - u - b*w)/J"})
    rows = {s: [r for r, _ in f.rows] for s, f in model.force_factors.items()}
    assert rows == {"v": ["v"], "w": ["w"]}
    assert add_force(model, "w", "- Fc*sign(w)") == (
        ("equations.w", "(k*(q - p) - u - b*w - Fc*sign(w))/J"),
    )


def test_motors_of_an_aircraft_are_no_mass_matrix() -> None:
    model = model_of(
        {
            "a": "w",
            "v": "-k*(u1 + u2)*sin(a)/m",
            "c": "k*(u1 + u2)*cos(a)/m - g",
            "w": "k*l*(u2 - u1)/J",
        },
        ["u1", "u2"],
    )
    rows = {s: [r for r, _ in f.rows] for s, f in model.force_factors.items()}
    assert rows == {"v": ["v"], "c": ["c"], "w": ["w"]}
    np.testing.assert_allclose(factor_at(model, "c"), 1.0 / random_points(model)["m"])


def test_a_force_on_a_cart_swings_its_pole() -> None:
    model = model_of(
        {
            "x": "v",
            "q": "w",
            "v": "(u + m*l*w**2*sin(q) - m*g*sin(q)*cos(q))/(J + m*sin(q)**2)",
            "w": "(-u*cos(q) - m*l*w**2*sin(q)*cos(q) + (J + m)*g*sin(q))/(l*(J + m*sin(q)**2))",
        }
    )
    changes = dict(add_force(model, "v", "- Fc*sign(v)"))
    assert "(u - Fc*sign(v) + m*l*w**2*sin(q)" in changes["equations.v"]
    assert "(-(u - Fc*sign(v))*cos(q)" in changes["equations.w"]


def test_every_candidate_does_in_the_file_what_it_did_in_the_comparison() -> None:
    definitions = {"Jall": "J + N**2*Jm"}
    model = model_of(
        {"q": "w", "w": "(K*i - b*w - k*q)/Jall", "i": "(u - R*i - K*w)/l"}, ["u"], definitions
    ).pinned()
    scale = {s: np.linspace(-1.0, 1.0, 21) for s in (*model.states, "u", "t")}
    rng = np.random.default_rng(3)
    points = {n: rng.uniform(0.2, 1.5, 16) for n in (*model.states, "u", "t")}
    checked = set()
    for candidate in force_candidates(model, scale):
        if candidate.fixed_parameter or candidate.states or candidate.inertia:
            continue
        names = candidate.names(model.symbols)
        values = {p.name: min(max(0.4, p.low), p.high) for p in candidate.parameters}
        inside = apply_edit(model, candidate.edit(model, names))
        written = apply_edit(model, candidate.edit(model, names, values))
        own = {names[n]: v for n, v in values.items()}
        env = {n: p.value for n, p in model.parameters.items()} | own | points
        for state in model.states:
            np.testing.assert_allclose(
                evaluate(inside.equation_terms[state], env),
                evaluate(written.equation_terms[state], env),
                rtol=1e-9,
                err_msg=candidate.key,
            )
        assert not written.forces and not written.additions
        checked.add(candidate.mechanism)
    assert {"coulomb_friction", "input_saturation", "backlash", "harmonic_force"} <= checked


def test_a_change_of_an_input_is_a_force_of_its_own_size() -> None:
    model = axis("(K*u - b*w)/J").pinned()
    (limit, *_) = (c for c in force_candidates(model, {}) if c.mechanism == "input_saturation")
    edit = limit.edit(model, limit.names(model.symbols), {"us": 0.5})
    text = "(K*u - b*w + (K)*(Max(Min(u, us), -us) - u))/J"
    assert edit.changes["equations.w"] == text


def test_edits_do_not_change_how_forces_enter() -> None:
    model = axis("(u - b*w)/J").pinned()
    edited = apply_edit(model, Edit({"equations.w": "(u*Abs(u) - b*w)*Abs(q)/J"}))
    assert edited.force_factors is model.force_factors
    assert difference(axis("(u - b*w)/J"), model).changes == {}
    loose = apply_edit(axis("(u - b*w)/J"), Edit({"forces.w": "-Fc"}))
    points = random_points(loose)
    np.testing.assert_allclose(
        evaluate(loose.equation_terms["w"], points),
        evaluate(loose.term("(u - b*w - Fc)/J"), points),
        rtol=1e-12,
    )
    built = SuperModel.build(axis("(u - b*w)/J"), force_candidates(model, {}))
    assert built.model.equations == model.equations
