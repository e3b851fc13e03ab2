"""Columns that stay on a device: the path of a GPU, here on CPU devices."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import jax
import numpy as np
import pytest

from jaxsr.evaluation import Evaluator, Reference, compile_terms
from jaxsr.evaluation import evaluator as module
from jaxsr.evaluation.engine import EngineConfig
from jaxsr.evaluation.kernel import EXPRESSIONS
from jaxsr.evaluation.stream import LOAD, NAMES, streamed, unpacked
from jaxsr.evolution import PrimitiveSet, SearchConfig, init
from jaxsr.evolution.create import random_term
from jaxsr.evolution.loop import step
from jaxsr.expressions import Term, parse
from jaxsr.expressions.postfix import OPERATORS, compile_postfix
from jaxsr.regression import RegressionProblem, Resources
from jaxsr.regression.resident import ResidentStore

VARIABLES = ("t", "x", "z")
EVERYTHING = PrimitiveSet(functions=OPERATORS)


class Resident(Evaluator):
    """Keeps columns on a device whatever the number of samples."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.device = jax.devices()[0]

    def differentiates(self, sets: int) -> bool:
        return True


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Treat a CPU device as one with a memory of its own."""
    monkeypatch.setattr(EngineConfig, "resident", property(lambda self: True))


def _terms(seed: int, count: int, size: int = 15) -> list[Term]:
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, size + 1, count)
    return [random_term(rng, list(VARIABLES), EVERYTHING, int(n)) for n in sizes]


def _samples(rows: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-2.0, 2.0, (rows, len(VARIABLES)))


def _walked(terms: list[Term], data: np.ndarray) -> np.ndarray:
    """Run a stream instruction by instruction in NumPy, as a thread of the kernel does."""
    stream = streamed(compile_postfix(terms, VARIABLES))
    operation, way, place = unpacked(stream.words)
    out = np.empty((len(terms), len(data)))
    names = {"math": np, "ZERO": 0.0, "HALF": 0.5, "ONE": 1.0, "INF": np.inf}
    for term in range(len(terms)):
        top, stack = np.zeros(len(data)), []
        for k in range(stream.starts[term], stream.starts[term + 1]):
            leaf = data[:, place[k] - 1] if place[k] else np.full(len(data), stream.values[k])
            if operation[k] == LOAD:
                stack.append(top)
                top = leaf
                assert len(stack) <= stream.depths[term]
                continue
            name, a, b = NAMES[operation[k]], top, top
            if way[k]:
                a, b = (top, leaf) if way[k] == 1 else (leaf, top)
            elif name in OPERATORS and stream_takes_two(name):
                a = stack.pop()
            pairs = zip(a.tolist(), b.tolist(), strict=True)
            code = compile(EXPRESSIONS[name], name, "eval")
            top = np.array(
                [eval(code, names | {"a": np.float64(p), "b": np.float64(q)}) for p, q in pairs]
            )
        assert len(stack) == 1
        out[term] = top
    return out


def stream_takes_two(name: str) -> bool:
    from jaxsr.expressions.postfix import arity_of

    return arity_of(name) == 2


def test_streams_say_what_terms_say() -> None:
    terms, data = _terms(1, 120), _samples(7)
    with np.errstate(all="ignore"):
        found = _walked(terms, data).T
    truth = compile_terms(terms, VARIABLES).evaluate(data, "columns")
    assert found == pytest.approx(truth, rel=1e-9, nan_ok=True)


def test_the_kernel_knows_every_operator() -> None:
    assert set(EXPRESSIONS) == set(NAMES[1:]) >= set(OPERATORS)
    assert len(NAMES) <= 64  # six bits


def test_leaves_are_read_by_the_instruction_beside_them() -> None:
    texts = ["2.5*x + t", "t - sin(x)", "(x + 1)*(z - 2)", "x**2", "x"]
    stream = streamed(compile_postfix([parse(t, VARIABLES) for t in texts], VARIABLES))
    assert np.diff(stream.starts).tolist() == [3, 3, 5, 2, 1]
    assert stream.depths.tolist() == [1, 1, 2, 1, 1]


SIMULATED = """
import sys
import numpy as np
from jaxsr.evaluation import compile_terms, kernel
from jaxsr.evaluation.stream import streamed
from jaxsr.expressions.postfix import compile_postfix
sys.path.insert(0, sys.argv[1])
from test_resident import VARIABLES, _samples, _terms
terms, rows = _terms(2, 24), 11
data = _samples(rows)
stream = streamed(compile_postfix(terms, VARIABLES))
for kind, digits in (("float64", 1e-9), ("float32", 1e-3)):
    out = np.full((len(terms), rows), -7.0, kind)
    run = kernel.kernel(8, kind, np)[(2, len(terms)), 2]  # a thread each: few
    chosen = np.arange(len(terms))[::-1].astype(np.int32)
    code = (stream.words, stream.values.astype(kind), stream.starts, chosen)
    run(*code, data.T.astype(kind), out)
    truth = compile_terms(terms, VARIABLES).evaluate(data.astype(kind), "columns").T
    np.testing.assert_allclose(out, truth, rtol=digits, atol=digits)
print("same")
"""


@pytest.mark.long
def test_the_kernel_on_numbas_simulator() -> None:
    from pathlib import Path

    pytest.importorskip("numba")
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", SIMULATED, str(Path(__file__).parent)],
        capture_output=True,
        text=True,
        env={**__import__("os").environ, "NUMBA_ENABLE_CUDASIM": "1"},
        check=False,
    )
    assert done.stdout.strip() == "same", done.stderr[-2000:]


@pytest.mark.parametrize("kind", ["float32", "float64"])
def test_columns_on_a_device_are_those_of_the_host(elsewhere: None, kind: str) -> None:
    terms, data = _terms(3, 40, 9), _samples(50).astype(kind)
    batch = compile_terms(terms, VARIABLES)
    there = batch.resident(jax.numpy.asarray(data)) if kind == "float32" else None
    truth = batch.evaluate(data, "columns")
    digits = 1e-3 if kind == "float32" else 1e-9
    assert batch.evaluate(data) == pytest.approx(truth, rel=digits, abs=digits, nan_ok=True)
    if there is not None:
        assert there.dtype == kind and np.array_equal(there, batch.evaluate(data), equal_nan=True)


def test_less_memory_gives_smaller_chunks(elsewhere: None, monkeypatch: pytest.MonkeyPatch) -> None:
    from jaxsr.evaluation.engine import Engine

    terms, data = _terms(4, 10, 5), _samples(100)
    batch = compile_terms(terms, VARIABLES)
    whole, asked = batch.evaluate(data), []
    plain = Engine.resident

    def scarce(self: Engine, there: Any, constants: Any = None) -> Any:
        asked.append(there.shape[1])
        if there.shape[1] > 20:
            raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: out of memory")
        return plain(self, there, constants)

    monkeypatch.setattr(Engine, "resident", scarce)
    assert np.array_equal(batch.evaluate(data), whole, equal_nan=True)
    assert max(asked[-5:]) <= 20 < asked[0]


def _problem(kind: Any, rows: int = 400, noise: float = 0.1) -> RegressionProblem:
    rng = np.random.default_rng(5)
    x, z = rng.normal(size=(2, rows))
    data = {"t": np.linspace(0.0, 10.0, rows), "x": x, "z": z}
    y = 3.0 * x + 5.0 * np.sin(2.5 * data["t"] + 0.4) - 2.0 / (x**2 + 1.5)
    return RegressionProblem(y + noise * rng.normal(size=rows), data, resources=Resources(kind))


def test_sets_weigh_alike_on_both_sides() -> None:
    texts = ["x", "sin(2.5*t)", "cos(2.5*t)", "1/(x**2 + 1.5)", "integral(x)", "sqrt(x)", "z*x"]
    terms = [parse(t, VARIABLES, integrals=True) for t in texts]
    sets = [terms[:1], terms[:3], terms[:4], terms[1:5], terms[4:6], terms]
    for noise in (0.1, 0.0):
        here, there = _problem(Reference, noise=noise), _problem(Resident, noise=noise)
        assert isinstance(there.resident, ResidentStore) and here.resident is None
        (own, losses), (other, found) = here.solve(sets), there.solve(sets)
        assert found == pytest.approx(losses, rel=1e-9, abs=1e-28)
        assert np.concatenate(own[:4]) == pytest.approx(np.concatenate(other[:4]), rel=1e-7)
        assert there.in_units(sets[2], other[2]) == pytest.approx(here.in_units(sets[2], own[2]))


def test_an_exact_fit_is_found_exact() -> None:
    terms = [parse(t, VARIABLES) for t in ("x", "sin(2.5*t + 0.4)", "1/(x**2 + 1.5)")]
    for kind in (Reference, Resident):
        assert _problem(kind, noise=0.0).solve([terms])[1][0] < 1e-25


def test_constants_move_alike_on_both_sides() -> None:
    texts = ["sin(2.3*t + 0.1)", "1/(x**2 + 1.1)", "exp(0.3*z)", "x", "z*x", "x**2"]
    terms = [parse(t, VARIABLES) for t in texts]
    sets = [[terms[0], terms[3]], [terms[0], terms[1], terms[3]], [terms[2], *terms[3:]], terms]
    here, there = (_problem(kind).refine_many(sets) for kind in (Reference, Resident))
    for (_, loss), (_, found) in zip(here, there, strict=True):
        assert found == pytest.approx(loss, rel=1e-5)


def test_columns_beyond_the_room_are_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    from jaxsr.regression import resident

    monkeypatch.setattr(resident, "_MOST", 256)
    monkeypatch.setattr(resident, "_LEAST", 1)
    problem, other = _problem(Resident), _problem(Reference)
    terms = [parse(f"sin({k}*t/50)*x", VARIABLES) for k in range(1, 700)]
    for first in (0, 150, 300, 450, 0):
        sets = [[terms[k], terms[k + 1]] for k in range(first, first + 200)]
        assert problem.solve(sets)[1] == pytest.approx(other.solve(sets)[1], rel=1e-9)
    assert problem.resident is not None and problem.resident.epoch > 1


@pytest.mark.slow
def test_generations_on_a_device_find_what_those_on_the_host_do() -> None:
    config = SearchConfig(population=40)
    best = []
    for kind in (Reference, Resident):
        rng, problem = np.random.default_rng(0), _problem(kind)
        state = init(rng, problem, config)
        for _ in range(2):
            state, _ = step(rng, state, problem)
        best.append(state.front.best_loss)
    assert best[1] == pytest.approx(best[0], rel=1e-3)


def test_few_samples_stay_on_the_host(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(module, "has_kernel", lambda: True)
    assert module.resident_device(200) is None
    assert module.resident_device(10**6) is not None
    monkeypatch.setattr(module, "has_kernel", lambda: False)
    assert module.resident_device(10**6) is None
