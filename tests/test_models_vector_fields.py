"""Python vector fields: read as terms, called where they are none, and refused in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.expressions import PRIMITIVES, evaluate, parse, to_text
from jaxsr.expressions.derivative import derivative
from jaxsr.models import Model, Simulator, apply_edit, model_text, parse_model
from jaxsr.models.balance import Balance
from jaxsr.models.edits import Edit
from jaxsr.models.field import Field, Point
from jaxsr.models.opaque import OpaquePrimitive
from jaxsr.models.python_base import with_function

HEAD = """
[model]
name = "m"
base = "m.py:f"
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[readings]
y = "q"
[parameters]
k = { value = 3.0, bounds = [1.0, 9.0] }
m = { value = 2.0, bounds = [1.0, 4.0] }
"""
Function = Callable[..., Any]


def table(lengths: jax.Array) -> jax.Array:
    return jnp.interp(lengths, jnp.array([-1.0, 0.0, 0.5, 2.0]), jnp.array([0.0, 1.0, 3.0, -1.0]))


def looped(t: Any, x: Any, u: Any, p: Any) -> Any:
    """A loop whose end is decided at run time: no term."""
    root = jax.lax.while_loop(lambda s: s[1] < 30, lambda s: (jnp.cos(s[0]), s[1] + 1), (x[0], 0))
    return jnp.array([x[1], (u[0] - p["k"] * root[0]) / p["m"]])


def newton(t: Any, x: Any, u: Any, p: Any) -> Any:
    """A Bessel function: differentiable, and no term."""
    return jnp.array([x[1], (u[0] - p["k"] * jax.scipy.special.i0(x[0])) / p["m"]])


READ: dict[str, Function] = {
    "array": lambda t, x, u, p: jnp.array([x[1], (u[0] - p["k"] * x[0]) / p["m"]]),
    "list": lambda t, x, u, p: [x[1], (u[0] - p["k"] * x[0]) / p["m"]],
    "tuple": lambda t, x, u, p: (x[1], u[0] - p["k"] * jnp.sin(x[0]) * jnp.exp(-t)),
    "mapping": lambda t, x, u, p: {"v": u[0] - p["k"] * x[0], "q": x[1]},
    "parameters as an array": lambda t, x, u, p: jnp.stack([x[1], (u[0] - p[0] * x[0]) / p[1]]),
    "where": lambda t, x, u, p: [x[1], jnp.where(x[0] > 0.2, -p["k"], jnp.abs(u[0])) - x[0] ** 2],
    "cond": lambda t, x, u, p: [
        x[1],
        jax.lax.cond(x[1] > 0, lambda a: a * p["k"], lambda a: -a / p["m"], x[0]) + u[0],
    ],
    "scan": lambda t, x, u, p: [
        x[1],
        jax.lax.fori_loop(0, 4, lambda i, a: a + 0.1 * jnp.sin(a) * i, x[0]) * p["k"] + u[0],
    ],
    "matrices": lambda t, x, u, p: (
        jnp.array([[0.0, 1.0], [-1.0, 0.0]]) @ x * jnp.stack([1.0, p["k"]])
        + jnp.array([0.0, 1.0]) * u
    ),
    "set": lambda t, x, u, p: jnp.zeros(2).at[0].set(x[1]).at[1].set(u[0] - p["k"] * x.sum()),
    "clip and table": lambda t, x, u, p: [x[1], jnp.clip(u[0], -1, 1) * p["k"] + table(x[0])],
    "running sums": lambda t, x, u, p: [x[1], u[0] - p["k"] * jnp.sin(jnp.cumsum(x)).sum()],
    "split": lambda t, x, u, p: [*jnp.split(x, 2)[1], jnp.tile(u, 2)[1] - p["k"] * x[0]],
    "norm": lambda t, x, u, p: [x[1], -p["k"] * jnp.max(x) * jnp.tanh(x[0]) + jnp.prod(x) + u[0]],
    "Python's if": lambda t, x, u, p: [x[1], -p["k"] * x[0] + u[0]] if len(x) == 2 else None,
    "a call": newton,
}


def read(function: Function, text: str = HEAD) -> Simulator:
    return with_function(parse_model(text), function)


def sampled(model: Model, count: int = 7) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(3)
    t, x = rng.normal(size=count), rng.normal(size=(len(model.states), count))
    return t, x, rng.normal(size=(len(model.inputs), count))


def truth(function: Function, simulator: Simulator, t: Any, x: Any, u: Any) -> np.ndarray:
    values = simulator.values()
    p: Any = dict(zip(simulator.model.parameters, values, strict=True))
    with jax.enable_x64(True):
        rows = []
        for k in range(t.size):
            try:
                found = function(t[k], jnp.asarray(x[:, k]), jnp.asarray(u[:, k]), p)
            except (KeyError, TypeError):
                found = function(t[k], jnp.asarray(x[:, k]), jnp.asarray(u[:, k]), np.array(values))
            found = [found[s] for s in ("q", "v")] if isinstance(found, dict) else found
            rows.append([float(v) for v in found])
        return np.array(rows).T


@pytest.mark.long
@pytest.mark.parametrize("name", READ)
def test_a_function_runs_as_it_says_with_exact_slopes(name: str) -> None:
    simulator = read(READ[name])
    model = simulator.model
    t, x, u = sampled(model)
    called = isinstance(PRIMITIVES.get(model.equation_terms["v"].op), OpaquePrimitive)
    assert called == (name == "a call")
    field = Field(simulator, simulator.values(), active=["k"])
    expected = truth(READ[name], simulator, t, x, u)
    rates, rows = field.slopes(Point(t, list(x), list(u)))
    np.testing.assert_allclose(np.stack(rates), expected, rtol=1e-9, atol=1e-12)
    assert model.kinematic_parent("v") == "q" and model.dynamic_states == ("v",)
    eps = 1e-6  # central differences: 1e-12 of truncation, 1e-10 of rounding
    for j, symbol in enumerate(model.states):
        shift = np.zeros_like(x)
        shift[j] = eps
        difference = truth(READ[name], simulator, t, x + shift, u) - truth(
            READ[name], simulator, t, x - shift, u
        )
        own = np.broadcast_to(rows[1].get(symbol, 0.0), t.shape)
        np.testing.assert_allclose(own, difference[1] / (2 * eps), rtol=1e-6, atol=1e-8)


@pytest.mark.long
def test_what_is_no_term_is_called_and_depends_on_what_it_uses() -> None:
    model = read(newton).model
    rate = model.equation_terms["v"]
    assert isinstance(PRIMITIVES[rate.op], OpaquePrimitive)
    assert rate.variables == {"q", "u", "k", "m"} and model.equation_terms["q"].is_variable
    assert model.vector_field is not None
    ((row, factor),) = model.vector_field.columns["v"].rows
    gain = model.term(factor or "1")
    np.testing.assert_allclose(evaluate(gain, {"k": 3.0, "m": 2.0, "q": 0.1}), 0.5)
    assert row == "v" and model.vector_field.columns["v"].beside == "u"


WRONG = [
    (lambda t, x, u, p: [x[1]], "rates of shape (1,) for the 2 states q, v"),
    (lambda t, x, u, p: jnp.ones((2, 2)), "rates of shape (2, 2)"),
    (lambda t, x, u, p: [x, u], "arrays of shapes"),
    (lambda t, x, u, p: None, "returns nothing"),
    (lambda t, x, u, p: {"a": 1.0}, "returns the rates of a"),
    (lambda t, x, u, p: [x[1], 1.0 if x[0] > 0 else -1.0], "decides by if"),
    (lambda t, x, u, p: [x[1], np.sin(x[0])], "NumPy array or a Python number"),
    (lambda t, x, u, p: [x[1], float(x[0])], "NumPy array or a Python number"),
    (lambda t, x, u, p: [x[1], p["none"]], "raises KeyError: 'none'"),
    (lambda t, x, u: [x[1], u[0]], "raises TypeError"),
    (lambda t, x, u, p: [x[1], x[0] * jnp.nan], "the rate of v is nan, whatever the states are"),
    (looped, None),
    (
        lambda t, x, u, p: [
            x[1],
            jax.pure_callback(np.sin, jax.ShapeDtypeStruct((), x.dtype), x[0]),
        ],
        "cannot be run for many samples by JAX",
    ),
]


@pytest.mark.parametrize(("function", "message"), WRONG)
def test_what_is_no_vector_field_is_refused_in_one_line(
    function: Function, message: str | None
) -> None:
    if message is None:  # forward differentiation passes through a loop
        assert read(function).model.dynamic_states == ("v",)
        return
    with pytest.raises(InputError) as caught:
        read(function)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_the_line_that_raises_is_named(tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(HEAD)
    (tmp_path / "m.py").write_text("def f(t, x, u, p):\n    a = 1\n    return x[1], {}['b']\n")
    with pytest.raises(InputError, match=r"raises KeyError: 'b'.*|m.py:f, line 3"):
        Simulator.from_file(f"{tmp_path / 'm.py'}:f")
    (tmp_path / "m.py").write_text("import sys\nsys.exit('no')\n")
    with pytest.raises(InputError, match="fails on import: SystemExit: no"):
        Simulator.from_file(f"{tmp_path / 'm.py'}:f")


ARM = """
[model]
base = "arm.py:arm"
states = ["q1", "q2", "w1", "w2"]
inputs = ["u1", "u2"]
outputs = ["y1", "y2"]
[readings]
y1 = "q1"
y2 = "q2"
[parameters]
a = { value = 1.0, bounds = [0.5, 2.0] }
b = { value = 0.25, bounds = [0.1, 0.5] }
d = { value = 0.2, bounds = [0.1, 0.4] }
"""


def solved(M: Any, F: Any) -> Any:
    return jnp.linalg.solve(M, F)


def inverted(M: Any, F: Any) -> Any:
    return jnp.linalg.inv(M) @ F


def by_hand(M: Any, F: Any) -> Any:
    det = M[0, 0] * M[1, 1] - M[0, 1] * M[1, 0]
    return jnp.stack(
        [(M[1, 1] * F[0] - M[0, 1] * F[1]) / det, (M[0, 0] * F[1] - M[1, 0] * F[0]) / det]
    )


def cholesky(M: Any, F: Any) -> Any:
    return jax.scipy.linalg.solve(M, F, assume_a="pos")


def arm(way: Function) -> Function:
    def rates(t: Any, x: Any, u: Any, p: Any) -> Any:
        c = jnp.cos(x[1])
        off = p["d"] + p["b"] * c
        M = jnp.array([[p["a"] + 2 * p["b"] * c, off], [off, p["d"]]])
        F = u + p["b"] * jnp.sin(x[1]) * jnp.array([(2 * x[2] + x[3]) * x[3], -(x[2] ** 2)])
        return jnp.concatenate([x[2:], way(M, F)])

    return rates


@pytest.mark.parametrize("way", [solved, inverted, by_hand, cholesky])
def test_a_mass_matrix_is_found_in_the_columns_of_the_inputs(way: Function) -> None:
    simulator = read(arm(way), ARM)
    model, balance = simulator.model, Balance.of(simulator.model)
    assert balance is not None and balance.states == ("w1", "w2")
    assert model.vector_field is not None
    beside = {s: e.beside for s, e in model.vector_field.columns.items()}
    assert beside == {"w1": "u1", "w2": "u2"}  # though u1 moves the light second link more
    t, x, u = sampled(model)
    field = Field(simulator, simulator.values(), active=["a", "b", "d"])
    at = Point(t, list(x), list(u))
    forces, masses = balance.weighed(field.evaluated(balance.gains, at), field.forces(at), t.size)
    c, s = np.cos(x[1]), np.sin(x[1])
    np.testing.assert_allclose(masses["w1", "w1"][0], 1.0 + 0.5 * c, atol=1e-12)
    np.testing.assert_allclose(masses["w2", "w1"][0], 0.2 + 0.25 * c, atol=1e-12)
    np.testing.assert_allclose(masses["w1", "w1"][1]["b"], 2.0 * c, atol=1e-12)
    np.testing.assert_allclose(forces["w2"][0], u[1] - 0.25 * s * x[2] ** 2, atol=1e-12)
    np.testing.assert_allclose(forces["w2"][1]["b"], -s * x[2] ** 2, atol=1e-12)
    np.testing.assert_allclose(forces["w2"][1]["a"], 0.0, atol=1e-12)


@pytest.mark.parametrize("way", [solved, by_hand])
def test_a_force_along_a_state_and_its_additions_to_the_rates_agree(way: Function) -> None:
    model = read(arm(way), ARM).model
    inside = apply_edit(model, Edit({"forces.w1": "-0.3*w1"}))
    rows = dict(model.entries("w1"))
    assert set(rows) == {"w1", "w2"}
    written = apply_edit(model, Edit({f"additions.{s}": f"{g}*(-0.3*w1)" for s, g in rows.items()}))
    changed = read(lambda t, x, u, p: arm(way)(t, x, u - jnp.array([0.3 * x[2], 0.0]), p), ARM)
    t, x, u = sampled(model)
    runs = []
    for simulator in (Simulator(inside), Simulator(written), changed):
        field = Field(simulator, simulator.values())
        runs.append(np.stack(field.rates(Point(t, list(x), list(u)))))
    np.testing.assert_allclose(runs[0], runs[2], atol=1e-12)
    np.testing.assert_allclose(runs[1], runs[2], atol=1e-12)


def test_what_is_added_is_written_and_read_with_the_function() -> None:
    edit = {
        "model.states": ("q", "v", "z"),
        "initial.z": "free",
        "equations.z": "v - z",
        "additions.v": "-z/m",
        "definitions.v_per_u": "1/m",
    }
    model = apply_edit(read(READ["array"]).model, Edit(edit))
    again = with_function(parse_model(model_text(model)), READ["array"]).model
    assert again == model
    rates = Simulator(again).rates(0.0, (0.5, 1.0, 2.0), (0.0,), (3.0, 2.0))
    assert [float(r) for r in rates] == pytest.approx([1.0, -0.75 - 1.0, -1.0])


def test_two_functions_of_one_table_are_two_simulators() -> None:
    first, second = (read(lambda t, x, u, p, a=a: [x[1], a * x[0]]) for a in (1.0, 2.0))
    assert first.model == second.model and first != second


def test_a_factor_common_to_the_terms_serves_where_no_input_enters() -> None:
    model = read(lambda t, x, u, p: [x[1], -(x[0] + x[1]) / p["m"]]).model
    assert model.entries("v") == (("v", "1.0/m"),)
    assert read(lambda t, x, u, p: [x[1], -x[0] * u[0]]).model.entries("v") == (("v", ""),)


def test_an_explained_model_says_how_it_is_run(tmp_path: Path) -> None:
    (tmp_path / "explained.toml").write_text(HEAD)
    with pytest.raises(InputError, match=r"path/m.py:f with --model .*explained.toml"):
        Simulator.from_file(tmp_path / "explained.toml")
    (tmp_path / "m.py").write_text("def f(t, x, u, p):\n    return x[1], u[0]\n")
    with pytest.raises(InputError, match=r"/m.py:f with --model .*explained.toml") as caught:
        Simulator.from_file(tmp_path / "explained.toml")
    assert "path/m.py" not in str(caught.value)
    function = f"{tmp_path / 'm.py'}:f"
    assert Simulator.from_file(function, tmp_path / "explained.toml").model.name == "m"


EXPRESSIONS = [
    "sin(a*b)/b",
    "a**3 - 2*a*b",
    "exp(-a)*sqrt(b)",
    "atan2(a, b) + atan(a/b)",
    "Max(a, b)*Min(a, 0.5)",
    "Piecewise((a*b, a > 0.3), (b**2, True))",
    "log(b)*tanh(a) - cosh(a)/sinh(b)",
    "Abs(a) + b**a",
    "asin(a/9)*acos(b/9) + tan(a)",
    "floor(a)*a + sign(b)*a",
]


@pytest.mark.parametrize("text", EXPRESSIONS)
def test_derivatives_are_those_of_differences(text: str) -> None:
    term = parse(text, ("a", "b"))
    rng = np.random.default_rng(1)
    at = {"a": rng.uniform(0.1, 2.0, 20), "b": rng.uniform(0.6, 2.0, 20)}
    for name in ("a", "b"):
        exact = np.broadcast_to(evaluate(derivative(term, name), at), 20)
        up, down = ({**at, name: at[name] + d} for d in (1e-6, -1e-6))
        difference = (evaluate(term, up) - evaluate(term, down)) / 2e-6
        np.testing.assert_allclose(exact, difference, rtol=1e-7, atol=1e-8)
    assert to_text(derivative(parse("3*a + b", ("a", "b")), "a")) == "3.0"
