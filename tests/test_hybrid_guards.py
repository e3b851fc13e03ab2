"""Guards, the regions they make, and the mode sequence."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from jaxsr.discovery.hybrid.guards import Guard, guard_variables, inside, plain, region_term
from jaxsr.discovery.hybrid.intervals import joined_regions
from jaxsr.discovery.hybrid.switching import dwell_times, joined, labels, next_to_switch, sequence
from jaxsr.discovery.samples import roles
from jaxsr.expressions import parse, to_numpy, to_text
from jaxsr.expressions.term import Term

X = Term.variable("x")
SIZE = Term.apply("abs", X)


def test_a_guard_is_a_condition_in_the_model_grammar() -> None:
    guard = Guard(SIZE, 0.1)
    assert str(guard) == "Abs(x) > 0.1" and str(guard.other) == "Abs(x) <= 0.1"
    values = {"x": np.array([-0.2, -0.1, 0.0, 0.2])}
    assert guard.holds(values).tolist() == [True, False, False, True]
    read = to_numpy(parse(str(guard)))(values)
    assert np.array_equal(read, guard.holds(values))
    assert np.array_equal(guard.holds(values), ~guard.other.holds(values))


def test_a_region_keeps_the_tightest_bound_of_each_side() -> None:
    region = plain((Guard(X, 0.0), Guard(X, 1.0), Guard(X, 3.0, False), Guard(X, 2.0, False)))
    assert to_text(region_term([region])) == "And(x > 1.0, x <= 2.0)"
    assert to_text(region_term([()])) == "True"


@pytest.mark.parametrize(
    ("regions", "text"),
    [
        ([(Guard(X, 0.0, False), g) for g in (Guard(SIZE, 1.0), Guard(SIZE, 1.0, False))],
         "x <= 0.0"),
        ([(Guard(X, 1.0),), (Guard(X, -1.0, False),)], "Abs(x) > 1.0"),
        ([(Guard(X, 0.0), Guard(X, 2.0, False)), (Guard(X, -1.0), Guard(X, 0.0, False))],
         "And(x > -1.0, x <= 2.0)"),
        ([(Guard(SIZE, 1.0, False),)], "Abs(x) <= 1.0"),
    ],
)  # fmt: skip
def test_regions_of_one_variable_are_joined(regions, text) -> None:
    joined = joined_regions(regions)
    assert to_text(region_term(joined)) == text
    values = {"x": np.linspace(-3.0, 3.0, 601) + 1e-4}
    before = np.any([inside(region, values) for region in regions], axis=0)
    assert np.array_equal(before, np.any([inside(region, values) for region in joined], axis=0))


def test_regions_of_two_variables_stay_as_they_are() -> None:
    regions = [(Guard(X, 0.0),), (Guard(Term.variable("y"), 1.0),)]
    assert joined_regions(regions) == tuple(regions)


def test_guards_may_hang_on_gaps_between_two_states_of_one_kind() -> None:
    part = roles(["q1", "q2"], None, 1, ["u"], None)
    rng = np.random.default_rng(0)
    values = {n: rng.normal(size=50) for n in ("t", "q1", "q2", "u")}
    texts = [to_text(v) for v in guard_variables(part, [("q1", "q2")], values)]
    assert {"q1", "Abs(q1)", "u", "q1 - q2", "Abs(q1 - q2)", "t"} <= set(texts)
    assert "t" not in [to_text(v) for v in guard_variables(part, [], values, timed=False)]


def test_switches_are_located_between_samples() -> None:
    time = np.linspace(0.0, 4.0, 41)
    values = {"t": time, "x": np.abs(time - 2.0)}
    regions = [[(Guard(X, 0.55),)], [(Guard(X, 0.55, False),)]]
    rows = sequence(time, regions, values)
    assert [m for _, _, m in rows] == [0, 1, 0]
    assert rows[0][0] == 0.0 and rows[-1][1] == 4.0
    assert rows[1][:2] == pytest.approx((1.45, 2.55), abs=1e-6)
    assert all(a[1] == b[0] for a, b in itertools.pairwise(rows))
    assert dwell_times(rows, 1) == pytest.approx([1.1], abs=1e-6)
    near = next_to_switch(labels(regions, values), np.zeros(41, int), 2)
    assert np.flatnonzero(near).tolist() == [13, 14, 15, 16, 24, 25, 26, 27]


def test_pieces_of_a_recording_are_joined_where_a_state_was_reset() -> None:
    first = [(0.0, 1.0, 0), (1.0, 2.0, 1)]
    assert joined(first, [(2.1, 3.0, 1), (3.0, 4.0, 0)]) == [
        (0.0, 1.0, 0),
        (1.0, 3.0, 1),
        (3.0, 4.0, 0),
    ]
    assert joined(first, [(2.5, 3.0, 0)]) == [(0.0, 1.0, 0), (1.0, 2.25, 1), (2.25, 3.0, 0)]
