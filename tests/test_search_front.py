"""Complexity and the front: what is plainer, and what stays."""

from __future__ import annotations

import numpy as np
import pytest

from jaxsr.evolution import (
    Front,
    Individual,
    complexity,
)
from jaxsr.expressions import Term, parse


@pytest.mark.parametrize(
    ("plain", "costly"),
    [
        (["x"], ["x**2"]),
        (["x**2"], ["x**3"]),
        (["x**3"], ["x**5"]),
        (["x", "x**2"], ["sin(cos(x))"]),
        (["sin(x)"], ["sin(cos(x))"]),
        (["sin(x)"], ["sin(1.3*x)"]),
        (["sin(2.0*x)"], ["sin(2.3*x)"]),
        (["1/(x + 1.0)"], ["1/(x + 1.2)"]),
        (["x**2"], ["x**2.3"]),
        (["x"], ["x", "y"]),
        (["sign(x)"], ["tanh(x)"]),
        (["x*y"], ["x*y*y"]),
        (["x", "y"], ["sin(x + y)"]),
    ],
)
def test_what_is_plainer_costs_less(plain: list[str], costly: list[str]) -> None:
    a, b = ([parse(w, ["x", "y"]) for w in words] for words in (plain, costly))
    assert complexity(a) < complexity(b)


def test_complexity_adds_over_terms_and_knows_no_order() -> None:
    terms = [parse(w, ["x", "y"]) for w in ("x", "sin(1.3*x)", "x*y**2", "exp(sin(y))")]
    assert complexity(terms) == sum(complexity([t]) for t in terms)
    assert complexity(terms[::-1]) == complexity(terms)
    assert complexity([]) == 0
    # a value costs the same whatever it is, as long as it is fitted
    fitted = [parse(f"sin({c}*x)", ["x"]) for c in (0.1, 1.7, 123.4)]
    assert len({complexity([t]) for t in fitted}) == 1


def _individual(loss: float, size: int) -> Individual:
    return Individual((Term.variable("x"),), loss, size, 0)


def test_a_front_takes_losses_below_its_floor_for_equal() -> None:
    seen = [_individual(x, s) for x, s in ((1e-2, 3), (1e-9, 5), (1e-12, 6), (1e-30, 9), (0.0, 12))]
    assert [m.size for m in Front(floor=1e-8).with_(seen).members] == [3, 5]
    assert [m.size for m in Front(floor=1e-11).with_(seen).members] == [3, 5, 6]
    assert [m.size for m in Front(floor=1e-24).with_(seen).members] == [3, 5, 6, 9]


def test_a_front_does_not_depend_on_the_order_in_which_it_sees() -> None:
    rng = np.random.default_rng(18)
    for _ in range(50):
        floor = 10.0 ** rng.uniform(-20, -3)
        losses = 10.0 ** rng.uniform(-24.0, 0.0, size=80)
        seen = [_individual(float(x), int(rng.integers(1, 30))) for x in losses]
        whole = Front(floor=floor).with_(seen)
        parts = Front(floor=floor)
        for k in rng.permutation(80).tolist():
            parts = parts.with_([seen[k]])
        assert parts.members == whole.members and parts.floor == floor
        # of those below the floor one is left, and it is of the smallest such size
        below = [m for m in whole.members if m.loss <= floor]
        smallest = min((i.size for i in seen if i.loss <= floor), default=None)
        assert [m.size for m in below] == ([] if smallest is None else [smallest])
        for member in whole.members:
            assert not any(
                other.size < member.size and other.loss <= max(member.loss, floor) for other in seen
            )


def test_a_front_ignores_what_has_no_loss_or_no_terms() -> None:
    seen = [_individual(np.nan, 1), _individual(np.inf, 1), Individual((), 0.0, 0, 0)]
    assert Front().with_(seen) == Front()
