"""Recorded formulas: a tape computes what the walk over the formula computes."""

import contextlib

import numpy as np
import pytest

from jaxsr.expressions import Term, evaluate, parse, sines
from jaxsr.expressions.slopes import evaluate_with_slopes
from jaxsr.expressions.tape import Recording, Tape, UntraceableError
from jaxsr.models import Simulator, parse_model
from jaxsr.models.calculations import TAPED_FROM
from jaxsr.models.field import Field, Point

BINARY, UNARY = ("add", "sub", "mul", "div", "max", "min"), ("neg", "sin", "tanh", "abs", "exp")
LEAVES = ("x", "y", "p", "q")
ARM = parse_model(
    """
[model]
states = ["a", "b", "va", "vb"]
inputs = ["u"]
outputs = ["ya", "yb"]
[equations]
a = "va"
b = "vb"
va = "u - c*va - F*sign(va) + m*l*sin(a - b)*vb**2"
vb = "-m*l*sin(a - b)*va**2 - F*Abs(vb)**n*sign(vb) - 9.81*sin(b)"
[inertia]
va = { va = "2.0*m*l**2", vb = "m*l**2*cos(a - b)" }
vb = { va = "m*l**2*cos(a - b)", vb = "m*l**2" }
[readings]
ya = "a"
yb = "b"
[parameters]
m = { value = 1.2 }
l = { value = 0.7 }
c = { value = 0.0 }
n = { value = 1.7 }
F = { value = 0.4 }
"""
)
SPRING = parse_model(
    """
[model]
states = ["q", "v"]
outputs = ["y"]
[equations]
q = "v"
v = "-k*q - d*v"
[readings]
y = "q"
[parameters]
k = { value = 40.0 }
d = { value = 3.0 }
"""
)


def drawn(rng: np.random.Generator, depth: int) -> Term:
    """Draw an expression, zeros, ones and signs among its constants."""
    if depth == 0 or rng.random() < 0.1:
        if rng.random() < 0.3:
            return Term.constant(float(rng.choice([0.0, 1.0, -1.0, 2.5])))
        return Term.variable(str(rng.choice(LEAVES)))
    if rng.random() < 0.35:
        return Term.apply(str(rng.choice(UNARY)), drawn(rng, depth - 1))
    if rng.random() < 0.1:
        exponent = Term.constant(float(rng.choice([2.0, 3.0, 1.5])))
        return Term.apply("pow", drawn(rng, depth - 1), exponent)
    return Term.apply(str(rng.choice(BINARY)), drawn(rng, depth - 1), drawn(rng, depth - 1))


@pytest.mark.long
@pytest.mark.parametrize("seed", range(200))
def test_a_tape_repeats_the_walk_bit_by_bit(seed):
    """Where no number is divided by zero or beyond all bounds: 0 times it is 0 on a tape."""
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(2, 50))
    env = {"x": x, "y": y, "p": float(rng.normal()), "q": float(rng.uniform(0.5, 2.0))}
    terms: list[Term] = []

    def walk(values: dict) -> list:
        shared: dict = {}
        return [evaluate_with_slopes(t, values, ("x", "p"), shared) for t in terms]

    expected: list = []
    while not expected:
        terms = [drawn(rng, 6) for _ in range(3)]
        with contextlib.suppress(FloatingPointError), np.errstate(all="raise", under="ignore"):
            expected = walk(env)
    found = Tape(Recording.of(walk, list(env)))(env)
    for (value, slopes), (own, own_slopes) in zip(expected, found, strict=True):
        assert set(own_slopes) <= set(slopes)
        for one, other in [(value, own), *((slopes[n], own_slopes.get(n, 0.0)) for n in slopes)]:
            np.testing.assert_array_equal(*np.broadcast_arrays(other, one))


def test_equal_subexpressions_are_computed_once_and_unused_ones_never():
    term = parse("sin(x*y)*cos(x*y) + sin(x*y)")
    tape = Tape(
        Recording.of(
            lambda env: [evaluate(term, env), (evaluate(parse("exp(x)"), env), 1.0)[1]], "xy"
        )
    )
    assert len(tape) == 5
    x, y = np.array([0.3, 1.0]), np.array([2.0, -1.0])
    value, one = tape({"x": x, "y": y})
    np.testing.assert_array_equal(value, np.sin(x * y) * np.cos(x * y) + np.sin(x * y))
    assert one == 1.0


def test_what_decides_by_values_cannot_be_recorded():
    with pytest.raises(UntraceableError):
        Tape(Recording.of(lambda env: 1.0 if env["x"] > 0 else 0.0, ["x"]))
    with pytest.raises(UntraceableError):
        Tape(Recording.of(lambda env: np.asarray(env["x"]), ["x"]))


@pytest.mark.parametrize("n", (1.7, 2.0))
def test_a_field_replayed_is_the_field_interpreted(n):
    """Mass matrix, jumps, and a power whose exponent may or may not be whole."""
    rng, simulator = np.random.default_rng(4), Simulator(ARM)
    theta = [1.2, 0.7, 0.0, n, 0.4]
    x, k = rng.normal(size=(2, 4, 60))
    at = Point(np.zeros(60), list(x), [rng.normal(size=60)])

    def everything(field: Field) -> list[np.ndarray]:
        rates, rows = field.slopes(at)
        left, step, again = field.newton(at, list(k), np.full(60, 0.01))
        slopes = [row[name] for row in (*rows, *again) for name in sorted(row)]
        return [np.zeros(60) + a for a in (*field.rates(at), *rates, *left, *step, *slopes)]

    first = everything(Field(simulator, theta, (1e-3, 1e-3), ("m", "c", "n")))
    for _ in range(TAPED_FROM + 1):
        last = everything(Field(simulator, theta, (1e-3, 1e-3), ("m", "c", "n")))
    for one, other in zip(first, last, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_newton_step_solves_the_implicit_equation_of_a_linear_field():
    """k = A (x + s k) has the solution (1 - s A)^-1 A x, found in one step from anywhere."""
    matrix, size = np.array([[0.0, 1.0], [-40.0, -3.0]]), 0.05
    rng = np.random.default_rng(0)
    x, k = rng.normal(size=(2, 2, 5))
    field = Field(Simulator(SPRING), (40.0, 3.0))
    _, step, _ = field.newton(Point(np.zeros(5), list(x + size * k), []), list(k), np.array(size))
    expected = np.linalg.solve(np.eye(2) - size * matrix, matrix @ x)
    np.testing.assert_allclose(k + np.stack(step), expected, rtol=1e-12)


@pytest.mark.parametrize("largest", [1.0, 30.0, 0.9999 * sines.LARGEST])
def test_sines_and_cosines_of_large_arrays_are_those_of_numpy(largest: float) -> None:
    """Within 2e-16 each, at multiples of a right angle and of the table's step too."""
    rng = np.random.default_rng(0)
    quarters = np.arange(-40, 41) * (np.pi / 2)
    steps = np.arange(-2000, 2001) * (2.0 * np.pi / sines.STEPS)
    x = np.concatenate([rng.uniform(-largest, largest, 20000), quarters, steps, [0.0, -0.0]])
    with np.errstate(all="raise"):
        sine, cosine = sines.sine_and_cosine(x)
    # half a unit in the last place of NumPy's own on top
    np.testing.assert_allclose(sine, np.sin(x), rtol=0.0, atol=3e-16)
    np.testing.assert_allclose(cosine, np.cos(x), rtol=0.0, atol=3e-16)
    small = np.abs(x) < 1e-3
    np.testing.assert_allclose(sine[small], np.sin(x[small]), rtol=4e-16)


@pytest.mark.parametrize("x", [1.0, np.full(2000, np.nan), np.full(2000, 1e9), np.full(3, 0.5)])
def test_sines_of_other_angles_are_left_to_numpy(x: float | np.ndarray) -> None:
    sine, cosine = sines.sine_and_cosine(x)
    np.testing.assert_array_equal(sine, np.sin(x))
    np.testing.assert_array_equal(cosine, np.cos(x))


@pytest.mark.parametrize("text", ["sin(x)*cos(x)", "cos(x)*sin(x)", "cos(x)", "sin(x - y)*sin(y)"])
def test_a_tape_takes_sines_and_cosines_of_large_arrays_together(text: str) -> None:
    rng = np.random.default_rng(1)
    env = {name: rng.normal(size=(50, 40)) for name in "xy"}
    term = parse(text)
    tape = Tape(
        Recording.of(lambda given: evaluate_with_slopes(term, given, {"x", "y"}), ["x", "y"])
    )
    value, slopes = tape(env)
    expected, by = evaluate_with_slopes(term, env, {"x", "y"})
    np.testing.assert_allclose(value, expected, atol=1e-15)
    assert slopes.keys() == by.keys()
    for name in by:
        np.testing.assert_allclose(slopes[name], by[name], atol=2e-15)
