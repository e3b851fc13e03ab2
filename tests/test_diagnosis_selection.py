"""Which of the laws that were written are weighed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from jaxsr.diagnosis.laws.place import Place
from jaxsr.diagnosis.laws.selection import MOST, finite_around, laws_of
from jaxsr.diagnosis.likelihood.course import Course
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.evolution.propose import Proposal
from jaxsr.expressions import parse
from jaxsr.models import parse_model

MODEL = """
[model]
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u - k*q - 0.4*v"
[readings]
y = "q"
[parameters]
k = { value = 6.0, bounds = [1.0, 20.0] }
"""
ROWS = 300


def proposal(text: str, loss: float, coefficients: tuple[float, ...] = (1.0,)) -> Proposal:
    terms = tuple(parse(part) for part in text.split(" ; "))
    size = sum(term.size for term in terms) + len(terms)
    return Proposal(terms, np.array(coefficients), np.zeros(1), loss, loss, size)


def weighed(proposed: list[Proposal]) -> list[str]:
    """The laws chosen along a motion in which all signals are independent."""
    rng = np.random.default_rng(0)
    signals = {n: rng.uniform(-2.0, 2.0, ROWS) for n in ("q", "v", "u")}
    signals |= {"t": np.arange(float(ROWS))}
    model = parse_model(MODEL)
    states = np.stack([signals["q"], signals["v"]], axis=1)
    item = SimpleNamespace(states=SimpleNamespace(values=states), inputs=signals["u"][:, None])
    work = SimpleNamespace(super_model=SuperModel.build(model, []), prepared=[item])
    course = SimpleNamespace(motion=SimpleNamespace(integrate=lambda columns: columns))
    site = next(s for s in sites_of(model, {}) if s.state == "v")
    rows = np.zeros(ROWS), np.zeros(ROWS), np.zeros((ROWS, 1))
    place = Place(site, (), *rows, signals, *np.array([[6.0], [1.0], [1.0], [20.0]]))
    laws = laws_of(cast(Workspace, work), cast(Course, course), place, proposed)
    return [law.terms[0][1].removeprefix("+ ") for law, _ in laws]


def test_laws_are_the_simplest_of_their_error() -> None:
    """Of a front those stay that err clearly less than all simpler ones, names apart."""
    proposed = [
        proposal("v", 1.0),  # has a name
        proposal("q*v", 0.5),
        proposal("q*v ; 1", 0.45, (1.0, 0.1)),  # hardly better
        proposal("sqrt(q)*v", 0.25),  # no number where q is negative
        proposal("q**2*v", 0.2),
        proposal("exp(q)*v**3", 0.01),
    ]
    laws = weighed(proposed)
    assert len(laws) == 3
    for text, part in zip(laws, ("{c1}*(q", "**2", "exp("), strict=True):
        assert part in text


def test_laws_that_err_as_the_best_are_weighed_beside_it_where_they_differ() -> None:
    """v/(|v| + 0.2) and v/(v**2 + 1.5) err alike and are two laws.

    The first with a trace of something else is the first, as is what it is over 1; what errs twice
    as much is no rival.
    """
    first = proposal("v/(Abs(v) + 0.2)", 0.1)
    proposed = [
        first,
        proposal("v/(Abs(v) + 0.2) ; q", 0.0995, (1.0, 1e-3)),
        proposal("1/((Abs(v) + 0.2)/v)", 0.1),
        proposal("v/(v**2 + 1.5)", 0.105, (2.5,)),
        proposal("exp(q)*v/(v**2 + 1.5)", 0.2),
    ]
    laws = weighed(proposed)
    assert len(laws) == 2
    assert "Abs(v)" in laws[0] and "v**2" in laws[1]
    assert weighed([first]) == laws[:1]


def test_there_are_never_more_laws_than_are_weighed() -> None:
    """And those are as different as there are: of pairs all but alike one of each is taken."""
    texts = [f"sin({k}*q)*v" for k in range(1, MOST + 3)]
    alike = [proposal(text, 0.1) for text in texts]
    alike += [proposal(f"{text} ; 1", 0.1, (1.0, 0.1)) for text in texts]
    laws = weighed(alike)
    assert len(laws) == MOST
    assert not any("c2" in law for law in laws)
    assert len(weighed(alike[:3] + alike[MOST + 2 :][:3])) == 6
    assert len(weighed([*alike[:3], proposal("sin(q)*v ; 1", 0.1, (1.0, 1e-2))])) == 3


@pytest.mark.parametrize(
    ("text", "finite"),
    [("1/(q - 3)", True), ("log(q + 1.1)", True), ("log(q + 1.04)", False), ("q**0.5", False)],
)
def test_a_law_is_a_number_a_little_beyond_the_motion(text: str, finite: bool) -> None:
    """A fortieth of the range beyond either end: q from -1 to 1 is asked from -1.05 to 1.05."""
    assert finite_around(parse(text), {"q": np.linspace(-1.0, 1.0, 101)}) is finite
