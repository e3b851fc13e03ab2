"""The scheduled register machine: what it computes, what it shares, how often it is compiled."""

import os
import subprocess
import sys

import jax
import numpy as np
import pytest

import jaxsr.evaluation.engine as engine_module
from jaxsr._result import InputError
from jaxsr.evaluation import ColumnCache, EngineConfig, compile_terms, sharing
from jaxsr.evaluation.engine import Engine
from jaxsr.evaluation.machine import compilations
from jaxsr.evaluation.schedule import INSTRUCTIONS, schedule
from jaxsr.evolution import PrimitiveSet
from jaxsr.evolution.create import random_term
from jaxsr.expressions import Term, parse
from jaxsr.expressions.postfix import OPERATORS, compile_postfix
from jaxsr.expressions.primitives import PRIMITIVES

NAMES = ("t", "x", "z")
SMOOTH = PrimitiveSet(functions=("add", "sub", "mul", "div", "sin", "cos", "exp", "abs", "tanh"))
# the sine of an exponential of an exponential is whatever rounding makes it
TAME = PrimitiveSet(functions=("add", "sub", "mul", "sin", "cos", "abs", "tanh", "atan", "max"))
EVERYTHING = PrimitiveSet(functions=OPERATORS)
COMMUTES = ("add", "mul", "max", "min", "eq", "ne")


def _terms(seed, count, size=15, primitives=SMOOTH):
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, size + 1, count)
    return [random_term(rng, list(NAMES), primitives, int(n)) for n in sizes]


def _data(seed, rows, dtype=np.float64):
    return np.random.default_rng(seed).uniform(-2.0, 2.0, (rows, 3)).astype(dtype)


def _plain(plan, data):
    """Run a schedule instruction by instruction in NumPy, registers, segments and all."""
    buffer = np.full((plan.rows, len(data)), 1e300)
    buffer[plan.window : plan.window + plan.variables] = data.T
    columns, start = [], 0
    for segment, stop in enumerate(plan.ends):
        for k in range(start, stop):
            buffer[plan.target[k]] = _result(plan, k, buffer)
        columns.append(buffer[: min(plan.window, plan.outputs - segment * plan.window)].copy())
        start = stop
    assert start == len(plan)
    return np.concatenate(columns).T


def _result(plan, k, buffer):
    name, value = INSTRUCTIONS[plan.code[k]], plan.immediate[k]
    a, b = buffer[plan.left[k]], buffer[plan.right[k]]
    base, _, side = name.partition("_")
    match base:
        case "copy":
            return a
        case "constant":
            return value
        case "square":
            return a**2
        case "cube":
            return a**3
    with np.errstate(all="ignore"):
        if side:
            return PRIMITIVES[base].numpy(*((a, value) if side == "right" else (value, a)))
        return PRIMITIVES[base].numpy(*((a,) if PRIMITIVES[base].arity == 1 else (a, b)))


def _canonical(term):
    """A key that is equal for sums and products in either order."""
    if not term.args:
        return (term.op, term.name, term.value)
    parts = tuple(map(_canonical, term.args))
    return (term.op, *(sorted(parts, key=repr) if term.op in COMMUTES else parts))


@pytest.mark.parametrize("window", [16, 64, 512])
@pytest.mark.parametrize("seed", range(3))
def test_no_row_is_overwritten_before_its_last_use(seed, window):
    terms = _terms(seed, 400, primitives=EVERYTHING)
    data = _data(seed, 7)
    found = _plain(schedule(compile_postfix(terms, NAMES), window), data)
    cache = ColumnCache(dict(zip(NAMES, data.T, strict=True)))
    expected = np.stack([cache.column(term) for term in terms], axis=1)
    # sums of three in another order differ by rounding alone: every instruction is the same
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-300)


def test_each_distinct_subtree_is_computed_once_whatever_the_order_of_a_sum():
    terms = _terms(9, 500)
    plan = schedule(compile_postfix(terms, NAMES))
    inner = [_canonical(node) for term in terms for node in term.walk() if node.args]
    assert plan.inner_nodes == len(inner)
    assert plan.unique_nodes == len(set(inner))
    assert plan.unique_fraction == len(set(inner)) / len(inner)
    operations = [INSTRUCTIONS[c] for c in plan.code]
    copies = operations.count("copy") + operations.count("constant")
    assert len(plan) == plan.unique_nodes + copies
    written = sum(t < plan.window for t in plan.target)
    assert written == len(terms)  # one segment: each output is written once
    # copied there is what an earlier term has computed, and leaves
    expected, seen = 0, set()
    for term in terms:
        expected += not term.args or _canonical(term) in seen
        seen |= {_canonical(node) for node in term.walk() if node.args}
    copied = [o for o, t in zip(operations, plan.target, strict=True) if t < plan.window]
    assert copied.count("copy") + copied.count("constant") == expected > 20


def test_two_hashes_that_collide_cost_sharing_not_truth(monkeypatch):
    terms = _terms(3, 60)
    data = _data(3, 5)
    expected = _plain(schedule(compile_postfix(terms, NAMES)), data)
    whole = sharing._mixed
    monkeypatch.setattr(sharing, "_mixed", lambda x: whole(x) & np.uint64(7))
    plan = schedule(compile_postfix(terms, NAMES))
    assert plan.unique_nodes == plan.inner_nodes
    np.testing.assert_array_equal(_plain(plan, data), expected)


@pytest.mark.long
@pytest.mark.parametrize(("dtype", "rtol"), [(np.float64, 1e-9), (np.float32, 2e-3)])
@pytest.mark.parametrize(
    "rows", [1, 127, 1024, 1025, 2100, pytest.param(9000, marks=pytest.mark.slow)]
)
def test_machine_columns_and_interpreter_agree(dtype, rtol, rows):
    batch = compile_terms(_terms(rows, 150, size=9, primitives=TAME), NAMES)
    data = _data(rows, rows, dtype)
    found = batch.evaluate(data)
    assert found.shape == (rows, 150) and found.dtype == dtype
    for engine in ("columns", "interpreter"):
        other = batch.evaluate(data, engine)
        both = np.isfinite(found) & np.isfinite(other) & (np.abs(other) < 1e6)
        assert np.mean(both) > 0.9
        # float32 loses digits where a term subtracts near-equal or large numbers
        close = np.isclose(found[both], other[both], rtol=rtol, atol=rtol)
        assert np.mean(close) > (0.999 if dtype == np.float64 else 0.98)


@pytest.mark.parametrize("name", OPERATORS)
def test_every_operator_takes_columns_and_constants_from_either_side(name):
    x, z, c = Term.variable("x"), Term.variable("z"), Term.constant(0.75)
    unary = PRIMITIVES[name].arity == 1
    arguments = [(x,), (c,)] if unary else [(x, z), (x, c), (c, x), (c, c), (x, x)]
    terms = [Term.apply(name, *args) for args in arguments]
    data = np.abs(_data(4, 40)) / 2.0 + 1e-3  # inside every domain
    found = compile_terms(terms, NAMES).evaluate(data)
    cache = ColumnCache(dict(zip(NAMES, data.T, strict=True)))
    expected = np.stack([cache.column(term) for term in terms], axis=1)
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-15)


def test_leaves_twins_and_powers():
    texts = ["x", "2.5", "x", "x*z", "z*x", "2.5", "x**2", "x**3", "x**2.0*t", "exp(1.0)", "t - t"]
    data = _data(5, 50)
    t, x, z = data.T
    expected = [x, 2.5 + 0 * x, x, x * z, x * z, 2.5 + 0 * x]
    expected += [x**2, x**3, x**2 * t, np.e + 0 * x, 0 * t]
    found = compile_terms(texts, NAMES).evaluate(data)
    np.testing.assert_allclose(found, np.stack(expected, axis=1), rtol=1e-14)
    leaves = compile_terms(["x", "2.5"], NAMES).evaluate(data)
    np.testing.assert_array_equal(leaves, np.stack(expected[:2], axis=1))
    assert compile_terms([], NAMES).evaluate(data).shape == (50, 0)
    assert compile_terms(["x*z"], NAMES).evaluate(data[:0]).shape == (0, 1)
    np.testing.assert_array_equal(compile_terms(["1.5 + 1"], ()).evaluate(np.zeros((3, 0))), 2.5)


@pytest.mark.long
def test_one_compilation_serves_every_population_of_a_bucket():
    data = _data(6, 900, np.float32)
    one = EngineConfig(threads=1)
    for rows in (data, np.tile(data, (5, 1))):  # one chunk at a time, and several
        compile_terms(_terms(100, 300), NAMES, one).evaluate(rows)
    before = compilations()
    for seed in range(101, 106):
        compile_terms(_terms(seed, 250 + 10 * (seed - 100)), NAMES, one).evaluate(data)
        compile_terms(_terms(seed, 300), NAMES, one).evaluate(data[: 600 + seed])
        compile_terms(_terms(seed, 300), NAMES, one).evaluate(np.tile(data, (5, 1)))
    assert compilations() == before


def test_every_segment_is_written_into_the_same_memory():
    terms = _terms(11, 5000)
    places = set()

    def place(block, own, samples):
        places.add(block.__array_interface__["data"][0])

    Engine(compile_postfix(terms, NAMES), EngineConfig(threads=1)).each(_data(1, 512).T, place)
    assert len(places) == 1


@pytest.mark.long
@pytest.mark.parametrize("threads", [2, 3])
def test_threads_change_no_bit_and_chunks_only_the_last(threads):
    terms, data = _terms(7, 120, primitives=TAME), _data(7, 700)
    whole = compile_terms(terms, NAMES, EngineConfig(threads=1)).evaluate(data)
    few = EngineConfig(threads=threads)
    np.testing.assert_array_equal(compile_terms(terms, NAMES, few).evaluate(data), whole)
    alone, shared = (EngineConfig(threads=n, chunk=16) for n in (1, threads))
    found = compile_terms(terms, NAMES, alone).evaluate(data)
    np.testing.assert_array_equal(compile_terms(terms, NAMES, shared).evaluate(data), found)
    np.testing.assert_allclose(found, whole, rtol=1e-9, atol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("engine", ["machine", "columns", "interpreter"])
def test_theta_may_be_written_where_the_caller_says(engine):
    batch, data = compile_terms(_terms(14, 30, primitives=TAME), NAMES), _data(14, 300)
    expected = batch.evaluate(data, engine)
    for out in (np.empty((30, 300)).T, np.empty((300, 30))):
        assert np.shares_memory(batch.evaluate(data, engine, out=out), out)
        np.testing.assert_array_equal(out, expected)
    with pytest.raises(InputError, match="float32"):
        batch.evaluate(data, out=np.empty((300, 30), np.float32))


def test_moments_are_those_of_the_library():
    batch, data = compile_terms(_terms(8, 90), NAMES), _data(8, 3000)
    y = np.sin(data[:, 0]) + data[:, 1]
    theta = batch.evaluate(data)
    ones, squares, products = batch.moments(data, y)
    with np.errstate(all="ignore"):
        usable = np.isfinite(np.sum(theta**2, axis=0))
        scale = np.sum(theta**2, axis=0)[usable]
    assert np.mean(usable) > 0.8
    np.testing.assert_allclose(squares[usable], scale, rtol=1e-12)
    theta = theta[:, usable]
    np.testing.assert_allclose(ones[usable], theta.sum(axis=0), atol=1e-9 * scale.max() ** 0.5)
    slack = 1e-12 * np.sqrt(scale * (y @ y))
    assert np.all(np.abs(products[usable] - theta.T @ y) <= slack + 1e-12)
    assert not np.any(np.isfinite(squares[~usable]))


def test_a_device_without_memory_gets_smaller_chunks(monkeypatch):
    batch, data = _terms(11, 50, primitives=TAME), _data(11, 2048)
    expected = compile_terms(batch, NAMES).evaluate(data)
    whole, sizes = engine_module.run, []

    def small(program, part, use):  # as a device with room for 128 samples
        sizes.append(part.shape[2])
        if part.shape[2] > 128:
            raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: out of memory")
        return whole(program, part, use)

    monkeypatch.setattr(engine_module, "run", small)
    found = compile_terms(batch, NAMES, EngineConfig(threads=1)).evaluate(data)
    assert max(sizes) == 1024 and min(sizes) == 128
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)

    def broken(program, part, use):
        raise jax.errors.JaxRuntimeError("INTERNAL: something else")

    monkeypatch.setattr(engine_module, "run", broken)
    with pytest.raises(jax.errors.JaxRuntimeError, match="INTERNAL"):
        compile_terms(batch, NAMES).evaluate(data)


def test_a_device_may_be_named_and_jax_stays_as_it_was():
    config = EngineConfig(device=jax.devices("cpu")[0], threads=1)
    assert config.platform == "cpu"
    data = _data(12, 10)
    np.testing.assert_allclose(
        compile_terms(["x*z"], NAMES, config).evaluate(data)[:, 0],
        data[:, 1] * data[:, 2],
        rtol=1e-15,
    )
    assert not jax.config.jax_enable_x64
    with pytest.raises(ValueError, match="power of two"):
        EngineConfig(chunk=1000)
    with pytest.raises(ValueError, match="threads"):
        EngineConfig(threads=0)


def test_terms_without_postfix_code_are_evaluated_beside_the_others():
    terms = [parse(s, NAMES) for s in ("x*z", "Piecewise((x, t > 0), (z, True))", "sin(t)")]
    terms.append(Term.apply("integral", Term.variable("x")))
    data = _data(13, 30)
    data[:, 0] = np.linspace(0.0, 1.0, 30)
    batch = compile_terms(terms, NAMES)
    np.testing.assert_allclose(batch.evaluate(data), batch.evaluate(data, "columns"), rtol=1e-14)
    with pytest.raises(InputError, match="blocks"):
        batch.moments(data, data[:, 1])
    with pytest.raises(InputError, match="unknown variable q"):
        compile_terms([parse("Piecewise((q, t > 0), (z, True))", ("q", "t", "z"))], NAMES)


def test_padding_may_stand_amid_the_code():
    batch = compile_postfix([parse("x*z + t", NAMES), parse("sin(x)", NAMES)], NAMES)
    order = np.array([7, 0, 1, 6, 2, 3, 5, 4])
    shuffled = type(batch)(
        *(part[:, order] for part in (batch.opcode, batch.operand, batch.constants)), NAMES
    )
    data = _data(15, 20)
    np.testing.assert_array_equal(
        compile_terms(shuffled).evaluate(data), compile_terms(batch).evaluate(data)
    )


def test_code_that_is_no_expression_is_refused():
    batch = compile_postfix([parse("x + z", NAMES)], NAMES)
    broken = batch.opcode.copy()
    broken[0, 1] = 0
    lacking = type(batch)(broken, batch.operand, batch.constants, NAMES)
    with pytest.raises(ValueError, match="lacks arguments"):
        Engine(lacking).columns(np.zeros((3, 4)))
    broken[0, 1:3] = [2, 0]
    several = type(batch)(broken, batch.operand, batch.constants, NAMES)
    with pytest.raises(ValueError, match="several"):
        Engine(several).columns(np.zeros((3, 4)))


_COMPILES = """
import os, signal, sys
from jaxsr.evaluation import keep_compiled
folder = keep_compiled(sys.argv[1])
for name in sys.argv[3:]:
    (folder / name).write_bytes(b"half of it")
if sys.argv[2] == "killed":
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.slow
def test_what_a_killed_run_compiled_is_not_believed(tmp_path):
    """An entry whose writing was cut off would warn, and be compiled, in all runs to come."""

    def left(*words):
        subprocess.run([sys.executable, "-c", _COMPILES, str(tmp_path), *words], check=False)
        return sorted(path.name for path in tmp_path.iterdir())

    before, after = "jit_f-0123-cache", "jit_g-4567-cache"
    assert left("whole", before) == [before]
    os.utime(tmp_path / before, (1e9, 1e9))
    assert len(left("killed", after)) == 3  # with the mark of the dead run
    assert left("whole") == [before]
    assert left("whole", after) == [before, after]
    assert left("whole") == [before, after]


_PROCESS = """
import sys, numpy as np
from jaxsr.evaluation import compile_terms, keep_compiled
keep_compiled(sys.argv[1])
compile_terms(["sin(x)*z", "x + z"], ["x", "z"]).evaluate(np.ones((100, 2), np.float32))
"""


@pytest.mark.slow
def test_the_next_process_finds_what_was_compiled(tmp_path):
    folder = tmp_path / "compiled"
    kept = []
    for _ in range(2):
        command = [sys.executable, "-c", _PROCESS, str(folder)]
        subprocess.run(command, check=True, capture_output=True)
        kept.append(sorted(path.name for path in folder.iterdir() if "atime" not in path.name))
    assert kept[0] and kept[1] == kept[0]
