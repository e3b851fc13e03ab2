"""The register machine steps as NumPy does, over operations, models and shapes."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxsr._machine_code import compiled, kept
from jaxsr.expressions.instructions import CODE, Instructions
from jaxsr.expressions.tape import Recording
from jaxsr.models import Simulator, parse_model, programs
from jaxsr.models.directions import Directions, Stages
from jaxsr.models.field import Field
from jaxsr.models.following import followed
from jaxsr.models.machine_steps import rk4_steps
from jaxsr.models.parts import Part
from jaxsr.models.programs import compile_steps, program_of
from jaxsr.models.register_machine import executed

ROOT = Path(__file__).resolve().parents[1]
LAWS = {
    "products": "p*x*y/(1 + x**2) - q*u - x",
    "circles": "sin(p*x) - cos(y)*sin(y) + tan(0.1*x)",
    "an angle between its sine and its cosine": "sin(x - y)*u + p*(x - y)*tanh(y) + cos(x - y)",
    "circles of large angles": "1e-4*sin(1e4*x) + 1e-4*cos(1e4*y)",
    "growth": "exp(-p*x**2) - log(1 + q*Abs(y)) + sqrt(1 + x*x)",
    "hyperbolas": "tanh(x/p) + sinh(0.1*x) - cosh(0.1*y) - x",
    "angles": "asin(0.1*x) - acos(0.1*tanh(y)) + atan(p*x) + atan2(y, 2 + x**2)",
    "powers": "-sign(x)*Abs(x)**p - Abs(y)**1.5 + (1 + x**2)**q",
    "whole powers": "-x**3 + 0.1*y**4/(1 + y**6)",
    "corners": "Max(x, p*y, 0.1) - Min(x, q) - Abs(x)",
    "choices": "Piecewise((p*x, x > y), (-x, And(x <= 0, y < q)), (u, True))",
    "conditions": "Piecewise((1, Or(x >= y, Not(y < 0.2))), (-x, True))",
    "steps": "floor(3*x) - Heaviside(y)*x",
    "clock": "p*sin(3*t) - x",
    "nothing": "0.0",
    "constant": "p",
}


PIECES = (
    *("x - y", "x + u", "sin(x - y)", "cos(x - y)", "sin(x + u)", "cos(x + u)", "p*y", "q"),
    *("(x - y)**2", "Abs(x + u)", "tanh(p*y)", "sign(x - y)", "(1 + x**2)**q", "exp(-(x + u)**2)"),
)


def drawn(rng: np.random.Generator) -> str:
    """Return a sum of products of pieces, which share their parts in a random order."""
    products = (rng.choice(PIECES, rng.integers(1, 4)) for _ in range(rng.integers(3, 9)))
    whole = " + ".join("*".join(f"({piece})" for piece in product) for product in products)
    return f"0.01*({whole})"


def model_of(law: str) -> Simulator:
    """Return two states, one driven by a law."""
    text = f"""
[model]
time = "t"
states = ["x", "y"]
inputs = ["u"]
outputs = ["z"]
[equations]
x = "y"
y = "{law}"
[readings]
z = "x"
[parameters]
p = {{ value = 0.8 }}
q = {{ value = 1.3 }}
"""
    return Simulator(parse_model(text))


def course(rng: np.random.Generator, shape: tuple[int, int], inputs: int, steps: int) -> list[Part]:
    """Return steps of every sample, the last of them in two parts."""
    begin, parts = rng.uniform(size=shape), list[Part]()
    for number in range(steps):
        h = rng.uniform(0.01, 0.05, shape)
        rates = {0: rng.normal(size=(3, *shape))} if inputs else {}
        stages = Stages(rng.normal(size=(3, inputs, *shape)), rates)
        share = rng.uniform(0.2, 0.8, shape)
        if number == steps - 1:
            parts += [Part(stages, begin, h, 0.0, share), Part(stages, begin, h, share, 1.0)]
        else:
            parts.append(Part(stages, begin, h))
        begin = begin + h
    return parts


@pytest.fixture(autouse=True, scope="module")
def machine() -> None:
    """Compile it, if nothing did before; then it is used from here on."""
    compile_steps()
    kept.cache_clear()


def by_numpy(
    field: Field, to: Directions, x: list[np.ndarray], parts: list[Part]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the last states and their derivatives, as they are found without the machine."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jaxsr.models.following.program_of", lambda *_: None)
        along, slopes = followed(field, to, "rk4", x, parts)
    return np.stack(along[-1]), slopes


def directions(simulator: Simulator, delays: dict[int, int] | None = None) -> Directions:
    """Return all states and parameters, and delays."""
    model = simulator.model
    n = len(model.states)
    columns = {name: n + k for k, name in enumerate(model.parameters)}
    return Directions(tuple(model.states), columns, delays or {}, tuple(model.inputs))


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("shape", [(1, 1), (300, 3)])
def test_every_operation_is_that_of_numpy(name: str, shape: tuple[int, int]) -> None:
    agrees(LAWS[name], shape, np.random.default_rng(0))


@pytest.mark.parametrize("seed", range(40))
def test_what_several_operations_use_stays_until_the_last(seed: int) -> None:
    """Registers are used anew: of laws that share their parts none is used too early."""
    rng = np.random.default_rng(seed)
    agrees(drawn(rng), (20, 1), rng)


def agrees(law: str, shape: tuple[int, int], rng: np.random.Generator) -> None:
    """Check states and derivatives of a law against NumPy."""
    simulator = model_of(law)
    to = directions(simulator, {0: 4})
    field = Field(simulator, [0.8, 1.3], (), ["p", "q"], ["u"])
    x, parts = [rng.normal(size=shape) for _ in range(2)], course(rng, shape, 1, 3)
    assert program_of(field, to) is not None
    along, slopes = followed(field, to, "rk4", x, parts)
    wanted, by = by_numpy(field, to, x, parts)
    np.testing.assert_allclose(np.stack(along[-1]), wanted, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(slopes, by, rtol=1e-11, atol=1e-12)
    alone, none = followed(field, None, "rk4", x, parts)
    assert none.shape == (2, 0, *shape)
    np.testing.assert_allclose(np.stack(alone[-1]), wanted, rtol=1e-12, atol=1e-13)


def test_steps_are_the_same_on_any_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, shape = np.random.default_rng(3), (301, 3)
    simulator = model_of(LAWS["powers"])
    field, to = Field(simulator, [0.8, 1.3], (), ["p", "q"], ["u"]), directions(simulator)
    x, parts = [rng.uniform(0.5, 1.0, shape) for _ in range(2)], course(rng, shape, 1, 3)
    found = []
    for count in (1, 2, 3):
        monkeypatch.setattr(programs, "SHARED", 0)
        monkeypatch.setattr(programs, "cores", lambda count=count: count)
        along, slopes = followed(field, to, "rk4", x, parts)
        found.append((np.stack(along[-1]), slopes))
    for states, slopes in found[1:]:
        np.testing.assert_array_equal(states, found[0][0])
        np.testing.assert_array_equal(slopes, found[0][1])


def test_constants_differ_from_recording_to_recording() -> None:
    rng, shape = np.random.default_rng(1), (50, 4)
    simulator = model_of("-p*x - q*y")
    to, values = directions(simulator), [rng.uniform(1.0, 2.0, 4), 0.3]
    field = Field(simulator, values, (), ["p", "q"])
    x, parts = [rng.normal(size=shape) for _ in range(2)], course(rng, shape, 1, 2)
    along, slopes = followed(field, to, "rk4", x, parts)
    wanted, by = by_numpy(field, to, x, parts)
    np.testing.assert_allclose(np.stack(along[-1]), wanted, rtol=1e-13)
    np.testing.assert_allclose(slopes, by, rtol=1e-12, atol=1e-13)


def test_steps_converge_to_the_motion_with_order_four() -> None:
    """An undamped spring, x = cos t, and its derivative by the stiffness."""
    simulator = model_of("-p*x")
    to, errors = directions(simulator), []
    for steps in (8, 16, 32):
        field = Field(simulator, [1.0, 0.0], (), ["p", "q"])
        shape, h = (1, 1), 1.0 / steps
        none = Stages(np.zeros((3, 1, *shape)), {})
        parts = [Part(none, np.full(shape, k * h), np.full(shape, h)) for k in range(steps)]
        along, slopes = followed(field, to, "rk4", [np.ones(shape), np.zeros(shape)], parts)
        by = slopes[0, 2, 0, 0]  # x = cos(sqrt(p) t)
        errors.append([abs(along[-1][0][0, 0] - np.cos(1.0)), abs(by + 0.5 * np.sin(1.0))])
    orders = np.log2(np.array(errors)[:-1] / np.array(errors)[1:])
    assert (orders > 3.8).all()


def test_no_instruction_writes_over_what_it_reads() -> None:
    """The compiler takes a row of samples at once."""
    simulator = model_of(LAWS["powers"])
    field = Field(simulator, [0.8, 1.3], (), ["p", "q"])
    found = field.instructions("slopes")
    assert found is not None
    for operation, target, *operands in np.concatenate([found.once, found.each]):
        used = operands if operation == CODE["where"] else operands[:2]
        assert target not in used[: 1 if operation >= CODE["exp"] else None]


def run(operation: str, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return what the machine makes of two rows."""
    machine: Any = compiled(executed)
    register = np.stack([x, y, np.zeros_like(x), np.zeros_like(x)])
    machine(np.array([[CODE[operation], 2, 0, 1, 0]]), 0, 1, register, len(x))
    return register[2]


def test_hyperbolic_tangents_are_within_two_units_of_the_last_place() -> None:
    rng = np.random.default_rng(4)
    x = rng.choice([-1.0, 1.0], 20_000) * 10.0 ** rng.uniform(-300.0, 2.0, 20_000)
    x = np.concatenate([x, rng.normal(size=80_000), [0.0, -0.0, 1e308, np.inf, -np.inf, np.nan]])
    found, wanted = run("tanh", x, x), np.tanh(x.astype(np.longdouble)).astype(float)
    np.testing.assert_array_max_ulp(found[:-1], wanted[:-1], 2)
    np.testing.assert_array_equal(np.signbit(found[:-1]), np.signbit(x[:-1]))
    assert np.isnan(found[-1])


@pytest.mark.parametrize("exponent", [1.0, 2.0, 3.0, -1.0, 0.5, 2.5])
def test_powers_that_all_samples_have_are_those_of_each(exponent: float) -> None:
    x = np.random.default_rng(5).uniform(0.1, 3.0, 200)
    y = np.full(200, exponent)
    np.testing.assert_array_max_ulp(run("power", x, y), x**y, 2)
    y[7] = 1.5
    np.testing.assert_array_max_ulp(run("power", x, y), x**y, 2)


def test_what_the_machine_has_not_is_left_to_numpy() -> None:
    recording = Recording.of(lambda env: np.hypot(env["x"], 1.0), ["x"])
    assert Instructions.of(recording, ["x"]) is None


def test_it_is_compiled_for_all_models_together() -> None:
    for law in ("-x", "p*x + u"):
        simulator = model_of(law)
        field, to = Field(simulator, [0.8, 1.3], (), ["p"]), directions(simulator)
        rng = np.random.default_rng(2)
        x, parts = [rng.normal(size=(5, 2)) for _ in range(2)], course(rng, (5, 2), 1, 2)
        followed(field, to, "rk4", x, parts)
        followed(field, None, "rk4", x, parts)
    machine: Any = compiled(rk4_steps)
    assert len(machine.signatures) == 1


@pytest.mark.long
def test_what_is_not_compiled_yet_is_compiled_beside(tmp_path: Path) -> None:
    (tmp_path / "small.py").write_text("def twice(x):\n    return 2.0 * x\n", encoding="utf-8")
    script = '''
from jaxsr._machine_code import kept
from small import twice
made = """
from jaxsr._machine_code import compiled, mark
from small import twice
compiled(twice)(1.0)
mark(twice)
"""
found = kept(twice, made)
print(found if found is None else found(3.0))
'''
    paths = os.pathsep.join([str(ROOT), str(tmp_path)])
    own = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kept"), "PYTHONPATH": paths}

    def said() -> str:
        words = [sys.executable, "-c", script]
        return subprocess.run(words, env=own, capture_output=True, text=True, check=True).stdout

    assert said() == "None\n"
    until = time.monotonic() + 60.0
    while not any(tmp_path.glob("kept/*/*.kept")) and time.monotonic() < until:
        time.sleep(0.1)
    assert said() == "6.0\n"
    later = time.time() + 60.0  # as an installation that was made anew
    os.utime(tmp_path / "small.py", (later, later))
    assert said() == "6.0\n"


@pytest.mark.long
def test_what_calls_a_function_that_changed_is_compiled_anew(tmp_path: Path) -> None:
    folder = tmp_path / "parts"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "whole.py").write_text(
        "from parts.small import share\n\n\ndef twice(x):\n    return 2.0 * share(x)\n",
        encoding="utf-8",
    )
    script = """
from jaxsr._machine_code import compiled
from parts.whole import twice
print(compiled(twice)(3.0))
"""
    paths = os.pathsep.join([str(ROOT), str(tmp_path)])
    own = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kept"), "PYTHONPATH": paths}
    for law, wanted in (("x", "6.0"), ("x + 1.0", "8.0"), ("x", "6.0")):
        text = f"def share(x):\n    return {law}\n"
        (folder / "small.py").write_text(text, encoding="utf-8")
        words = [sys.executable, "-c", script]
        said = subprocess.run(words, env=own, capture_output=True, text=True, check=True).stdout
        assert said == f"{wanted}\n"
