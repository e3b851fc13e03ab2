"""Reading text: Python's own arithmetic as the measure, errors that point, and speed."""

from __future__ import annotations

import ast
import math
import time
from collections.abc import Callable

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.expressions import Term, evaluate, parse, to_text

NAMES = ("t", "x", "z")
VALUES = {"t": 0.7, "x": -1.3, "z": 2.1}


def _text(rng: np.random.Generator, depth: int) -> str:
    """Draw text with brackets and spaces anywhere; powers are small whole numbers."""
    gap = str(rng.choice(["", " "]))
    kind = rng.random() if depth else 1.0
    if kind < 0.5:
        a, b = _text(rng, depth - 1), _text(rng, depth - 1)
        return f"{a}{gap}{rng.choice(['+', '-', '*', '/'])}{gap}{b}"
    if kind < 0.62:
        base = str(rng.choice(["x", "2", f"({_text(rng, depth - 1)})"]))
        return f"{base}**{gap}{rng.choice(['2', '3', '-1', '(-2)', '+1'])}"
    if kind < 0.75:
        return f"({gap}{_text(rng, depth - 1)}{gap})"
    if kind < 0.85:
        return f"{rng.choice(['-', '+'])}{gap}{_text(rng, depth - 1)}"
    if kind < 0.9:
        return f"atan2({_text(rng, depth - 1)},{gap}{_text(rng, depth - 1)})"
    if kind < 1.0:
        return f"{rng.choice(['sin', 'tanh', 'cos'])}{gap}({_text(rng, depth - 1)})"
    return str(rng.choice([*NAMES, "2", "0.5", ".25", "3.", "1e-1", "1_0.5"]))


def _term(rng: np.random.Generator, size: int) -> Term:
    """Draw a term of exactly ``size`` nodes."""
    if size == 1:
        if rng.random() < 0.3:
            return Term.constant(float(np.round(rng.uniform(0.01, 10.0), 3)))
        return Term.variable(str(rng.choice(NAMES)))
    if size == 2 or rng.random() < 0.25:
        op = str(rng.choice(["sin", "cos", "exp", "tanh", "abs", "sqrt"]))
        return Term.apply(op, _term(rng, size - 1))
    if rng.random() < 0.12:
        exponent = Term.constant(float(rng.choice([2.0, 3.0, 0.5])))
        return Term.apply("pow", _term(rng, size - 2), exponent)
    left = int(rng.integers(1, size - 1))
    op = str(rng.choice(["add", "sub", "mul", "div"]))
    return Term.apply(op, _term(rng, left), _term(rng, size - 1 - left))


def _population(count: int) -> tuple[list[Term], list[str]]:
    rng = np.random.default_rng(0)
    terms = [_term(rng, 15) for _ in range(count)]
    return terms, [to_text(term) for term in terms]


def _seconds(work: Callable[[], object]) -> float:
    """Return the shortest of three times."""
    times = []
    for _ in range(3):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def test_text_means_what_python_computes() -> None:
    rng = np.random.default_rng(1)
    functions = {"sin": math.sin, "tanh": math.tanh, "cos": math.cos, "atan2": math.atan2}
    compared = 0
    for _ in range(1500):
        text = _text(rng, int(rng.integers(1, 6)))
        try:
            expected = eval(text, {"__builtins__": {}}, {**functions, **VALUES})
        except (ZeroDivisionError, OverflowError):
            continue
        with np.errstate(all="ignore"):
            found = float(evaluate(parse(text, NAMES), VALUES))
        if abs(expected) < 1e10:
            assert found == pytest.approx(expected, rel=1e-8, abs=1e-8), text
            compared += 1
    assert compared > 1000


def test_terms_come_back_from_their_text() -> None:
    terms, texts = _population(1000)
    assert all(term.size == 15 for term in terms)
    assert [parse(text, NAMES) for text in texts] == terms


def test_any_text_is_a_term_or_one_plain_error() -> None:
    rng = np.random.default_rng(2)
    pieces = [*"+-*/()<=,.^x1e ", "**", "sin(", "Max(", "Piecewise(", "(x, True)", "pi", "\n", "é"]
    refused = 0
    for _ in range(4000):
        text = "".join(rng.choice(pieces, size=int(rng.integers(1, 9))))
        try:
            term = parse(text)
        except InputError as error:
            refused += 1
            assert "\n" not in str(error)
        else:
            assert parse(to_text(term)) == term or "neg" in {node.op for node in term.walk()}
    assert 1000 < refused < 4000


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x + + ", "ends where a number, a symbol or a function is expected"),
        ("", "is empty where a number"),
        ("sin(x", "ends where ')' is expected"),
        ("x z", "character 3: an operator expected, got 'z'"),
        ("2x", "character 2: an operator expected, got 'x'"),
        ("(x))", "character 4: an operator expected, got ')'"),
        ("x*/z", "character 3: a number, a symbol or a function expected, got '/'"),
        ("x^2", "character 2: an operator expected, got '^'). Write ** for a power"),
        ("x and z", "got 'and'). Write And(a, b)"),
        ("x = z", "got '='). Write == to compare"),
        ("x if z else t", "got 'if'). Write Piecewise("),
        ("x # note", "got '#'). A comment stands outside the expression"),
        ("(x, z)", "character 3: ')' expected, got ','"),
        ("x**sin(2)", "power 'sin(2.0)' is not a plain number. Write it out"),
        ("y + x", "unknown symbol 'y'"),
        ("sine(x)", "unknown function 'sine'. Did you mean 'sin'?"),
        ("atan2(x)", "atan2 takes 2 arguments, got 1"),
        ("1e999*x", "number 1e999 is not finite"),
        ("Piecewise(x > 0, z)", "Piecewise takes pairs"),
    ],
)
def test_an_error_says_where_and_what_to_write(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(text, NAMES)
    assert message in str(caught.value)


def test_an_error_in_a_long_text_shows_the_place() -> None:
    text = " + ".join(["x"] * 100) + " ? z + " + " + ".join(["t"] * 100)
    with pytest.raises(InputError, match=r"x \+ x \? z \+ t.*character 399:") as caught:
        parse(text, NAMES)
    assert len(str(caught.value)) < 250


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("x +\n  z", "x + z"),
        ("sin(x,)", "sin(x)"),
        ("- 2*x", "-2*x"),
        ("2**-x", "2**(-x)"),
        ("1_000.5*x", "1000.5*x"),
        ("x < z < t", "And(x < z, z < t)"),
        ("sin (x)", "sin(x)"),
    ],
)
def test_two_ways_to_write_one_term(text: str, same: str) -> None:
    assert parse(text, NAMES) == parse(same, NAMES)


def test_reading_takes_no_longer_than_twice_python_s_own_parser() -> None:
    _, texts = _population(500)
    ours = _seconds(lambda: [parse(text, NAMES) for text in texts])
    python = _seconds(lambda: [ast.parse(text, mode="eval") for text in texts])
    assert ours < 2.0 * python


@pytest.mark.slow
def test_six_thousand_strings_of_fifteen_nodes_are_read_within_a_second() -> None:
    _, texts = _population(6000)
    assert _seconds(lambda: [parse(text, NAMES) for text in texts]) < 1.0
