"""Libraries: small terms hold the laws of mechanics, shapes fit their data."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from jaxsr.evolution import (
    PrimitiveSet,
)
from jaxsr.evolution.library import shape_terms, small_terms
from jaxsr.expressions import Term, evaluate, parse, to_text
from jaxsr.expressions.editing import edit
from jaxsr.expressions.printing import kind

LAWS = {
    "pendulum": (["q", "v"], ["sin(q)", "v", "Abs(v)*v", "sign(v)"]),
    "Duffing": (["x", "v"], ["x", "x**3", "v"]),
    "Lorenz": (["x", "y", "z"], ["x", "y", "z", "x*y", "x*z"]),
    "Van der Pol": (["x", "v"], ["x", "v", "x**2*v"]),
    "coupled pendulums": (["q1", "q2", "v1"], ["sin(q1 - q2)", "sin(q1)", "v1"]),
    "cart and pole": (["q", "v", "u"], ["v**2*sin(q)", "sin(q)*cos(q)", "u*cos(q)", "u"]),
}


@pytest.mark.parametrize("law", LAWS)
def test_small_terms_hold_the_laws_of_mechanics(law: str) -> None:
    names, words = LAWS[law]
    terms = set(small_terms(names, PrimitiveSet()))
    for text in words:
        (term,) = edit([parse(text, names)])
        assert term in terms, text


@pytest.mark.parametrize("names", [["x"], ["x", "v"], ["t", "x", "v", "u"], list("abcdefghij")])
def test_small_terms_are_plain_and_different(names: list[str]) -> None:
    terms = small_terms(names, PrimitiveSet())
    assert len(set(terms)) == len(terms) <= 2000
    assert len({to_text(t) for t in terms}) == len(terms)
    assert list(edit(terms)) == terms
    for term in terms:
        assert all(n.value.is_integer() for n in term.walk() if n.is_constant), to_text(term)
    assert terms[: 1 + len(names)] == [Term.constant(1.0), *map(Term.variable, names)]


def test_few_small_terms_say_what_another_says() -> None:
    names = ["x", "v"]
    rng = np.random.default_rng(15)
    data = {n: rng.uniform(-2.0, 2.0, size=100) for n in names}
    with np.errstate(all="ignore"):
        columns = [
            np.broadcast_to(evaluate(t, data), 100) for t in small_terms(names, PrimitiveSet())
        ]
    unit = np.array([c / np.linalg.norm(c) for c in columns if np.all(np.isfinite(c))])
    same = np.triu(np.abs(unit @ unit.T), 1) > 1.0 - 1e-13
    # sign(x)**2 = 1, x/sign(x) = Abs(x): editing does not know them all
    assert np.mean(np.any(same, axis=0)) < 0.1, np.mean(np.any(same, axis=0))


def test_small_terms_use_what_is_allowed_only() -> None:
    allowed = {"add", "sub", "mul", "sin"}
    terms = small_terms(["x", "v"], PrimitiveSet(functions=("add", "mul", "sin")))
    ops = {n.op for t in terms for n in t.walk()} - {"variable", "constant"}
    assert ops <= allowed | {"pow", "neg"}


def _spread(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {
        "x": rng.uniform(0.1, 4.0, size=200) * 10.0 ** rng.uniform(-2, 2),
        "v": rng.normal(size=200) * 10.0 ** rng.uniform(-2, 2),
    }


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("shift", [0.0, 0.37, 0.9])
def test_shapes_are_finite_on_the_data_they_are_made_for(seed: int, shift: float) -> None:
    data = _spread(seed)
    terms = shape_terms(data, PrimitiveSet(), shift)
    assert len(set(terms)) == len(terms)
    with np.errstate(all="ignore"):
        columns = np.array([np.broadcast_to(evaluate(t, data), 200) for t in terms])
    good = np.all(np.isfinite(columns), axis=1) & (np.ptp(columns, axis=1) > 0.0)
    assert np.mean(good) > 0.95


def test_the_shift_moves_the_grid_and_keeps_its_forms() -> None:
    data = _spread(0)
    grids = [shape_terms(data, PrimitiveSet(), s) for s in (0.0, 0.3, 0.6)]
    assert len({len(grid) for grid in grids}) == 1
    for a, b in itertools.combinations(grids, 2):
        shared = len(set(a) & set(b)) / len(a)
        # powers and roots have no scale to move along
        assert shared < 0.35
    assert shape_terms(data, PrimitiveSet(), 0.3) == grids[1]


def test_steps_of_two_variables_have_the_slopes_of_the_grid() -> None:
    data = {"x": np.linspace(0.0, 1.0, 50), "v": np.linspace(-1.0, 1.0, 50)}
    slopes = set()
    for term in shape_terms(data, PrimitiveSet()):
        if term.variables == {"x", "v"} and kind(term).count("exp") == 1 and term.op == "div":
            inner = next(n for n in term.walk() if n.op == "exp")
            if inner.variables == {"x", "v"}:
                at = [evaluate(inner, {"x": np.array([a]), "v": np.array([0.0])}) for a in (0, 1)]
                slopes.add(round(float(np.log(at[1] / at[0])[0]), 2))
    assert {abs(s) for s in slopes} == {1.5, 5.0}
