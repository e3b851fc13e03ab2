"""Terms multiplied out, against their values; and one sum inside another."""

from __future__ import annotations

import numpy as np
import pytest

from jaxsr.expressions import Term, evaluate, parse
from jaxsr.expressions.expansion import (
    MOST_PRODUCTS,
    contracted,
    expanded,
    factor_inside,
    without,
)

NAMES = ("a", "b", "c", "x", "y")


def term(text: str) -> Term:
    return parse(text, NAMES)


@pytest.mark.parametrize(
    ("text", "products"),
    [
        ("(a + b)*(x - y)", 4),
        ("(x + y)**2", 3),
        ("(x + y)*(x - y) - x**2 + y**2", 0),
        ("a*(x - y)/b - sin(x*y)", 3),
        ("x/(a + b) + y/(2*a + 2*b)", 2),
        ("-(a - x*(2 - y))", 3),
        ("sqrt(x)*sqrt(x)", 1),
        ("0*x", 0),
        ("3", 1),
    ],
)
def test_an_expansion_has_the_value_of_its_term(text: str, products: int) -> None:
    rng = np.random.default_rng(0)
    env = {name: rng.uniform(0.5, 2.0, 100) for name in NAMES}
    found = expanded(term(text))
    assert found is not None and len(found) == products
    again = np.broadcast_to(evaluate(contracted(found), env), 100)
    written = np.broadcast_to(evaluate(term(text), env), 100)
    np.testing.assert_allclose(again, written, atol=1e-12)


def test_what_would_be_too_long_is_left_alone() -> None:
    wide = "*".join(["(a + b + c + x)"] * 6)
    assert expanded(term(wide)) is None and 4**6 > MOST_PRODUCTS
    deep = Term.variable("x")
    for _ in range(2000):
        deep = Term.apply("sin", deep)
    assert expanded(deep) is None
    shared = Term.variable("x")
    for _ in range(100):  # 2**100 nodes, were they not shared
        shared = Term.apply("sin", Term.apply("add", shared, shared))
    assert expanded(shared) is not None


@pytest.mark.parametrize(
    ("whole", "part", "factor"),
    [
        ("3*a*x - 3*b*y + 7", "b*y - a*x", "-3"),
        ("c*(x + y) + x**2", "x + y", "c"),
        ("x*y + x**2", "x + y", None),  # the factor x is not allowed
        ("x + 2*y", "x + y", None),
        ("x", "x + y", None),
    ],
)
def test_a_sum_is_found_inside_another_with_its_factor(
    whole: str, part: str, factor: str | None
) -> None:
    both, inner = expanded(term(whole)), expanded(term(part))
    assert both is not None and inner is not None
    found = factor_inside(both, inner, frozenset("abc"))
    if factor is None:
        assert found is None
        return
    assert found is not None
    rest = contracted(without(both, inner, found))
    rng = np.random.default_rng(1)
    env = {name: rng.uniform(0.5, 2.0, 100) for name in NAMES}
    built = evaluate(contracted({found[0]: found[1]}), env) * evaluate(term(part), env)
    np.testing.assert_allclose(evaluate(rest, env) + built, evaluate(term(whole), env), rtol=1e-9)
    np.testing.assert_allclose(
        evaluate(contracted({found[0]: found[1]}), env), evaluate(term(factor), env)
    )
