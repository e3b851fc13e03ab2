"""pysindy as a baseline: it finds a plain term of a library among collinear others."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.concealed.sindy import Library, edited, select
from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.models import parse_model

pytest.importorskip("pysindy")

CART = """
[model]
name = "cart"
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u - k*q"
[parameters]
k = { value = 2.0, bounds = [0.5, 8.0] }
[readings]
y = "q"
"""


def candidate(name: str, term: str) -> Candidate:
    own = (ParameterSpec("c"),)
    return Candidate(name, "elastic", "equation:v", own, "", terms=(("v", f"- {{c}}*{term}"),))


def test_a_planted_term_is_chosen_and_written():
    rng = np.random.default_rng(0)
    base, columns = rng.normal(size=(400, 1)), rng.normal(size=(400, 6))
    columns[:, 5] = columns[:, 2] + 0.05 * columns[:, 5]  # nearly the planted one
    y = 0.3 * base[:, 0] + 2.0 * columns[:, 2] + 0.05 * rng.normal(size=400)
    every = tuple(candidate(f"m{k}", f"q**{k + 2}") for k in range(6))
    ones, check = np.ones(6), np.arange(400) >= 300
    found = Library(y, columns, base, every, ("c",) * 6, 0.0 * ones, ones, check, ("k",))
    terms, shifts = select(found)
    assert terms[0].candidate.mechanism == "m2"
    assert terms[0].values["c"] == pytest.approx(2.0, abs=0.3)
    assert shifts["k"] == pytest.approx(0.3, abs=0.02)
    model = edited(parse_model(CART), terms[:1], shifts)
    assert model is not None and "q**4" in model.equations["v"]
    assert model.parameters["k"].value == pytest.approx(2.3, abs=0.02)


def test_noise_alone_gives_no_terms():
    rng = np.random.default_rng(1)
    count = 4000  # by chance a term then gains a thousandth on the rows held back
    base, columns, y = (rng.normal(size=(count, n)) for n in (1, 5, 1))
    every = tuple(candidate(f"m{k}", f"q**{k + 2}") for k in range(5))
    ones, check = np.ones(5), np.arange(count) >= 2000
    found = Library(y[:, 0], columns, base, every, ("c",) * 5, 0.0 * ones, ones, check, ("k",))
    assert select(found) == ([], {})
