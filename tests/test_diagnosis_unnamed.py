"""A force that no named mechanism covers is written by the evolution."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from diagnosis_systems import CART
from scipy.integrate import solve_ivp

from jaxsr.diagnosis import diagnose
from jaxsr.diagnosis.laws.natural import Natural
from jaxsr.evolution.config import PrimitiveSet
from jaxsr.evolution.create import random_term
from jaxsr.expressions import evaluate, parse, to_text
from jaxsr.models import Simulator, parse_model
from jaxsr.recordings import Recording


def recording(seed: int) -> Recording:
    """A cart on a spring whose rail ripples: the force -6 sin(5 q) is not in the model."""
    return driven(seed, lambda q, v: -6.0 * np.sin(5.0 * q))


def squeezed(seed: int) -> Recording:
    """A cart on a spring with a film whose damping grows with the square of the way."""
    return driven(seed, lambda q, v: -3.0 * v * (q / 0.3) ** 2)


def driven(seed: int, missing: Callable[[float, float], float]) -> Recording:
    """A driven cart on a spring, with a force of way and speed that is not in the model."""
    rng = np.random.default_rng(seed)
    time, phases = np.arange(0.0, 30.0, 0.01), rng.uniform(0.0, 6.0, 8)
    waves = np.linspace(0.15, 2.0, 8)
    u = 4.0 * np.sin(2 * np.pi * waves * time[:, None] + phases).sum(1)

    def rates(t: float, x: np.ndarray) -> list[float]:
        force = np.interp(t, time, u) - 3.0 * x[1] - 8.0 * x[0] + missing(x[0], x[1])
        return [x[1], force / 2.0]

    path = solve_ivp(
        rates, (0.0, time[-1]), [0.0, 0.0], t_eval=time, rtol=1e-9, atol=1e-10, max_step=0.01
    )
    y = path.y[0] + 1e-4 * rng.normal(size=time.size)
    return Recording("cart.csv", time, {"u": u, "y": y})


@pytest.mark.slow
def test_a_law_with_a_name_gets_it():
    """-6 sin(5 q) is a ripple of position: the search need not write it."""
    found = diagnose(Simulator(parse_model(CART)), [recording(3)], seed=0)
    assert found.verdict == "structure"
    (row,) = found.findings
    assert row["mechanism"] == "position_ripple" and row["site"] == "equation:v"
    assert row["parameters"]["A"]["value"] == pytest.approx(6.0, rel=0.01)
    assert row["parameters"]["n"]["value"] == pytest.approx(5.0, rel=0.01)


TRAIN = """
[model]
states = ["q1", "q2", "v1", "v2"]
inputs = ["u"]
outputs = ["y1", "y2", "w1", "w2"]
[equations]
q1 = "v1"
q2 = "v2"
v1 = "u - k*q1 - c*v1 + kc*(q2 - q1)"
v2 = "kc*(q1 - q2) - c*v2"
[inertia]
v1 = { v1 = "m" }
v2 = { v2 = "m" }
[readings]
y1 = "q1"
y2 = "q2"
w1 = "v1"
w2 = "v2"
[parameters]
m = { value = 2.0, bounds = [0.5, 8.0] }
k = { value = 8.0, bounds = [2.0, 30.0] }
c = { value = 1.0, bounds = [0.2, 5.0] }
kc = { value = 20.0, bounds = [5.0, 80.0] }
"""


def drawn(seed: int, missing: Callable[[float, float], float]) -> Recording:
    """Two carts in a row, the first driven, and a force on it that is not in the model."""
    rng = np.random.default_rng(seed)
    time, phases = np.arange(0.0, 20.0, 0.01), rng.uniform(0.0, 6.0, 6)
    u = 6.0 * np.sin(2 * np.pi * np.linspace(0.1, 1.5, 6) * time[:, None] + phases).sum(1)

    def rates(t: float, x: np.ndarray) -> list[float]:
        spring = 20.0 * (x[1] - x[0])
        first = np.interp(t, time, u) - 8.0 * x[0] - x[2] + spring + missing(x[0], x[2])
        return [x[2], x[3], first / 2.0, (-spring - x[3]) / 2.0]

    path = solve_ivp(rates, (0.0, time[-1]), np.zeros(4), t_eval=time, rtol=1e-9, max_step=0.01)
    y = path.y + 1e-4 * rng.normal(size=path.y.shape)
    names = dict(zip(("y1", "y2", "w1", "w2"), y, strict=True))
    return Recording(f"train{seed}.csv", time, {"u": u, **names})


@pytest.mark.slow
def test_a_nameless_law_is_written_at_its_equation_within_a_budget():
    """Drag on one side of the way, -1.5 v**2 tanh(4 q/0.6): no name, and the other cart is free."""

    def law(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return -1.5 * v**2 * np.tanh(4.0 * q / 0.6)

    data = [drawn(s, law) for s in (1, 2, 3)]
    found = diagnose(Simulator(parse_model(TRAIN)), data, seed=0, budget=90.0)
    first = found.findings[0]
    assert (first["mechanism"], first["site"]) == ("unnamed", "equation:v1")
    rng = np.random.default_rng(1)
    q, v = rng.uniform(-0.6, 0.6, 200), rng.uniform(-2.0, 2.0, 200)
    values = {name: p["value"] for name, p in first["parameters"].items()}
    term = evaluate(parse(first["term"]), {"q1": q, "v1": v, "q2": 0 * q, "v2": 0 * q, **values})
    assert np.std(term - law(q, v)) < 0.1 * np.std(law(q, v))


def test_a_proposal_is_written_in_the_states_themselves():
    """Scaled states and inner constants as parameters: the same values as the search saw."""
    sizes = {"q": 0.031, "v": 1.0}
    term = parse("exp(-0.7*q**2)*v/(2 + 1.3*q)")
    natural = Natural(sizes)
    factor, written = natural.of(term)
    text = to_text(written, 6).format(a1="a1", a2="a2", a3="a3")
    assert len(natural.inner) == 3 and "**2" in text
    rng = np.random.default_rng(0)
    q, v = 0.03 * rng.normal(size=20), rng.normal(size=20)
    own = dict(zip(("a1", "a2", "a3"), natural.inner, strict=True))
    np.testing.assert_allclose(
        factor * evaluate(parse(text), {"q": q, "v": v, **own}),
        evaluate(term, {"q": q / 0.031, "v": v}),
        rtol=1e-12,
    )


@pytest.mark.parametrize("seed", range(5))
def test_any_law_keeps_its_values_over_the_states_themselves(seed: int) -> None:
    """Two hundred random laws: sizes go into a factor and into constants, and nowhere else."""
    rng = np.random.default_rng(seed)
    sizes = {"x": 5.0, "y": 0.031}
    z = {n: rng.uniform(0.2, 1.5, 50) for n in sizes}
    signals = {n: sizes[n] * z[n] for n in sizes}
    for _ in range(200):
        term = random_term(rng, list(sizes), PrimitiveSet(real_exponents=0.3), 12)
        natural = Natural(sizes)
        factor, written = natural.of(term)
        own = {f"{{a{k}}}": value for k, value in enumerate(natural.inner, 1)}
        with np.errstate(all="ignore"):
            expected = np.asarray(evaluate(term, z)) + np.zeros(50)
            near = np.asarray(evaluate(term, {n: x * (1.0 + 1e-13) for n, x in z.items()}))
            found = factor * np.asarray(evaluate(written, {**signals, **own})) + np.zeros(50)
            # Waves of exponentials are rounding.
            good = np.abs(near - expected) < 1e-10 * np.abs(expected)
        np.testing.assert_allclose(found[good], expected[good], rtol=1e-6)


@pytest.mark.parametrize(
    ("text", "natural", "inner"),
    [
        ("x**2*y/(x + 0.6)", "x**2*y/(x + {a1})", [3.0]),
        ("y*exp(3.2*x)", "y*exp({a1}*x)", [0.64]),
        ("1/(x - 0.5)**2", "1/(x - {a1})**2", [2.5]),
        ("Abs(y)*y", "Abs(y)*y", []),
        ("x/exp(x**2)", "x/exp({a1}*x**2)", [0.04]),
        ("x**1.7*y", "x**{a1}*y", [1.7]),
        ("sin(x - 1.7*y)", "sin({a2}*(x - {a1}*y))", [5.0 * 1.7 / 0.031, 0.2]),
        ("1/(x**2 + y)", "1/(x**2 + {a1}*y)", [25.0 / 0.031]),
    ],
)
def test_a_law_reads_as_people_write_it(text: str, natural: str, inner: list[float]) -> None:
    written = Natural({"x": 5.0, "y": 0.031})
    _, term = written.of(parse(text))
    assert to_text(term, 6) == natural
    np.testing.assert_allclose(written.inner, inner)


@pytest.mark.slow
def test_one_law_stands_for_a_crowd_of_named_ones():
    """A squeeze film, -3 v (q/0.3)**2: cubic and other springs and drags together imitate it."""
    found = diagnose(Simulator(parse_model(CART)), [squeezed(s) for s in (4, 5)], seed=0)
    assert found.verdict == "structure"
    first = found.findings[0]
    assert first["mechanism"] == "unnamed" and first["site"] == "equation:v"
    rng = np.random.default_rng(1)
    q, v = rng.uniform(-0.6, 0.6, 200), rng.uniform(-2.0, 2.0, 200)
    values = {name: p["value"] for name, p in first["parameters"].items()}
    term = evaluate(parse(first["term"]), {"q": q, "v": v, **values})
    law = -3.0 * v * (q / 0.3) ** 2
    assert np.std(term - law) < 0.05 * np.std(law)
