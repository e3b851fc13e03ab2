"""Deep terms, and terms that share so much that no walk over all nodes would end."""

from __future__ import annotations

import time

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.expressions import Term, evaluate, parse
from jaxsr.expressions.parsing import LONGEST, MAX_LEVELS, levels
from jaxsr.expressions.printing import excerpt
from jaxsr.expressions.slopes import evaluate_with_slopes
from jaxsr.models import Simulator
from jaxsr.models.field import folded
from jaxsr.models.reading import build_model
from jaxsr.models.units import unit_of


def doubled(count: int) -> Term:
    term = Term.variable("x")
    for _ in range(count):
        term = Term.apply("add", term, Term.apply("sin", term))
    return term


def deep(count: int) -> Term:
    term = Term.variable("x")
    for _ in range(count):
        term = Term.apply("sin", term)
    return term


def test_large_terms_of_one_structure_are_one_term() -> None:
    same = doubled(80) is doubled(80)
    assert same


def test_equal_terms_that_share_their_parts_are_compared_in_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    began = time.process_time()
    first = doubled(80)
    monkeypatch.setattr("jaxsr.expressions.term._LARGE", {})  # what was kept before is gone
    second = doubled(80)
    apart, equal = first is not second, first == second
    assert apart and equal
    other = Term.apply("add", first, Term.variable("y"))
    assert other != Term.apply("add", second, Term.variable("z"))
    assert len(set(first.distinct()) | set(second.distinct())) == 161
    assert len(excerpt(first)) <= 80
    assert time.process_time() - began < 1.0


def test_arguments_come_before_what_holds_them_and_each_once() -> None:
    term = parse("sin(x)*sin(x) + cos(sin(x) - 1.0)")
    order = list(term.upward())
    assert len(order) == len(set(order)) == 5 and order[-1] == term
    for k, node in enumerate(order):
        assert all(arg in order[:k] for arg in node.args if arg.args)
    assert list(term.upward({parse("sin(x)")})) == [n for n in order if n != parse("sin(x)")]


def test_terms_deeper_than_the_stack_are_evaluated() -> None:
    term, x = deep(3000), np.array([0.5, 1.0])
    expected = x
    for _ in range(3000):
        expected = np.sin(expected)
    np.testing.assert_allclose(evaluate(term, {"x": x}), expected)
    value, slopes = evaluate_with_slopes(term, {"x": x}, {"x"})
    np.testing.assert_allclose(value, expected)
    assert slopes["x"].shape == (2,)
    assert folded(term, {"y": 0.0}) is term
    assert levels(term) == 3000
    assert unit_of(term, {}) is None


@pytest.mark.parametrize(
    "law",
    [
        "-" + " + ".join(["0.001*q"] * (MAX_LEVELS - 5)),
        "-" * (MAX_LEVELS - 5) + "q",
        "-(" * 90 + "-" * 60 + "q" + ")" * 90,
        "-" + "tanh(" * 98 + "sign(q)" + ")" * 98,
    ],
    ids=["sum", "signs", "brackets", "calls"],
)
def test_the_deepest_laws_that_are_read_can_be_run(law: str) -> None:
    document = {
        "model": {"states": ["q"], "outputs": ["y"]},
        "equations": {"q": law},
        "readings": {"y": "q"},
    }
    simulator = Simulator(build_model(document))
    (rate,) = simulator.rates(0.0, (0.5,), (), ())
    assert np.isfinite(float(rate))


@pytest.mark.parametrize(
    "text",
    [
        "x" + " + x" * (MAX_LEVELS + 1),
        "(" * 101 + "x" + ")" * 101,
        "-(" * 99 + "-" * 140 + "x" + ")" * 99,
        "-" * 5000 + "x",
        "x**" * 2000 + "x",
        "1.0" + " " * LONGEST,
        "9**9**9**9",
        "x**1e9",
    ],
    ids=["sum", "brackets", "signs in brackets", "signs", "powers", "long", "tower", "power"],
)
def test_what_is_too_long_or_too_deep_is_refused_in_time(text: str) -> None:
    began = time.process_time()
    with pytest.raises(InputError) as caught:
        parse(text)
    assert len(str(caught.value)) < 250 and time.process_time() - began < 1.0


def test_definitions_nested_in_each_other_count_together() -> None:
    inner = ["q", "d0", "d1", "d2", "d3"]
    document = {
        "model": {"states": ["q"], "outputs": ["y"]},
        "definitions": {f"d{k}": "sin(" * 60 + inner[k] + ")" * 60 for k in range(5)},
        "equations": {"q": "-d3"},
        "readings": {"y": "q"},
    }
    with pytest.raises(InputError, match=r"\[definitions\] d4: has 300 levels .*written out"):
        build_model(document, "m.toml")
    del document["definitions"]["d4"]
    assert levels(build_model(document, "m.toml").equation_terms["q"]) == 241
