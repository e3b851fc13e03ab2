"""Postfix arrays against a plain recursive writer, back to terms, and what is refused."""

from __future__ import annotations

import time

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.expressions import Term, parse
from jaxsr.expressions.postfix import (
    CONSTANT,
    NOP,
    OPERATORS,
    VARIABLE,
    PostfixBatch,
    arity_of,
    compile_postfix,
    decompile,
)

NAMES = ("t", "x", "z")


def _draw(rng: np.random.Generator, size: int) -> Term:
    """Draw a term of at most ``size`` nodes over every operator of postfix code."""
    op = str(rng.choice(OPERATORS))
    if size == 1 or arity_of(op) >= size:
        if rng.random() < 0.4:
            return Term.constant(float(rng.normal()))
        return Term.variable(str(rng.choice(NAMES)))
    if arity_of(op) == 1:
        return Term.apply(op, _draw(rng, size - 1))
    left = int(rng.integers(1, size - 1))
    return Term.apply(op, _draw(rng, left), _draw(rng, size - 1 - left))


def _draws(seed: int, count: int, size: int = 31) -> list[Term]:
    rng = np.random.default_rng(seed)
    return [_draw(rng, int(rng.integers(1, size + 1))) for _ in range(count)]


def _written(term: Term) -> list[tuple[int, int, float]]:
    """Return (opcode, operand, constant) of every node, arguments first."""
    if term.is_constant:
        return [(CONSTANT, 0, term.value)]
    if term.is_variable:
        return [(VARIABLE, NAMES.index(term.name), 0.0)]
    code = (3 + OPERATORS.index(term.op), 0, 0.0)
    out = _written(term.args[0])
    if len(term.args) == 1:
        return out if term.op in ("max", "min") else [*out, code]
    for arg in term.args[1:]:
        out = [*out, *_written(arg), code]
    return out


@pytest.mark.parametrize("seed", range(5))
def test_arrays_hold_every_node_after_its_arguments(seed: int) -> None:
    terms = _draws(seed, 200)
    batch = compile_postfix(terms, NAMES)
    assert batch.opcode.dtype == batch.operand.dtype == np.int32
    assert batch.constants.dtype == np.float64
    for row, term in enumerate(terms):
        written = _written(term)
        arrays = (batch.opcode[row], batch.operand[row], batch.constants[row])
        for array, expected in zip(arrays, zip(*written, strict=True), strict=True):
            np.testing.assert_array_equal(array[: len(written)], expected)
            assert not array[len(written) :].any()


@pytest.mark.parametrize("seed", range(5))
def test_terms_come_back_from_their_arrays(seed: int) -> None:
    terms = _draws(seed + 10, 500)
    assert decompile(compile_postfix(terms, NAMES)) == terms
    assert decompile(compile_postfix(terms, NAMES, bucket=64)) == terms


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
def test_max_and_min_of_any_number_are_pairs(count: int) -> None:
    args = tuple(parse(f"x + {k}", NAMES) for k in range(count))
    term = Term.apply("sin", Term.apply("max", *args))
    batch = compile_postfix([term, Term.variable("z")], NAMES)
    written = _written(term)
    np.testing.assert_array_equal(batch.opcode[0, : len(written)], [w[0] for w in written])
    assert np.sum(batch.opcode[0] == 3 + OPERATORS.index("max")) == count - 1


def test_a_batch_may_be_empty() -> None:
    batch = compile_postfix([], NAMES)
    assert len(batch) == 0 and decompile(batch) == []


def test_what_has_no_code_is_refused() -> None:
    with pytest.raises(InputError, match=r"unknown variable q.*Known: t, x, z"):
        compile_postfix([parse("x + q")], NAMES)
    with pytest.raises(InputError, match="piecewise has no postfix code"):
        compile_postfix([parse("Piecewise((x, z > 0), (t, z < 0))")], NAMES)


@pytest.mark.parametrize(
    ("codes", "operands", "message"),
    [
        ([VARIABLE, 999], [0, 0], "row 1, slot 1: unknown opcode 999"),
        ([VARIABLE, -1], [0, 0], "row 1, slot 1: unknown opcode -1"),
        ([VARIABLE, NOP], [3, 0], "row 1, slot 0: no variable stands at position 3"),
        ([VARIABLE, 3], [0, 0], "row 1: add lacks arguments at slot 1"),
        ([VARIABLE, VARIABLE], [0, 1], "row 1: code leaves 2 values, not one"),
        ([NOP, NOP], [0, 0], "row 1: code leaves 0 values, not one"),
    ],
)
def test_arrays_that_are_no_terms_are_refused(
    codes: list[int], operands: list[int], message: str
) -> None:
    opcode = np.array([[VARIABLE, NOP], codes], np.int32)
    operand = np.array([[0, 0], operands], np.int32)
    with pytest.raises(InputError, match=message):
        decompile(PostfixBatch(opcode, operand, np.zeros((2, 2)), NAMES))


def test_writing_arrays_takes_no_longer_than_a_few_walks_over_the_terms() -> None:
    terms = _draws(3, 2000, size=15)

    def seconds(work: object) -> float:
        assert callable(work)
        times = []
        for _ in range(5):
            start = time.perf_counter()
            work()
            times.append(time.perf_counter() - start)
        return min(times)

    walk = seconds(lambda: [[node.op for node in term.walk()] for term in terms])
    assert seconds(lambda: compile_postfix(terms, NAMES)) < 3.0 * walk
