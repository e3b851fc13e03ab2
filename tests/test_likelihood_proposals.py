"""What the table proposes: exclusions, swaps and pairs, against sets weighed one by one."""

from __future__ import annotations

import numpy as np

from jaxsr.diagnosis.likelihood.estimate import Belief
from jaxsr.diagnosis.likelihood.evidence import Gram
from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis, _inherited
from jaxsr.diagnosis.likelihood.proposals import (
    exclusive,
    pairs,
    plain_of_kin,
    shifts,
    swaps,
    without,
)
from jaxsr.diagnosis.likelihood.scales import Scales
from jaxsr.diagnosis.likelihood.sensor_noise import Noise
from jaxsr.diagnosis.likelihood.table import Table
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.memory import memory_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.mechanisms.timing import timing_candidates
from jaxsr.models import parse_model

MODEL = """
[model]
name = "cart"
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u - k*q"
[readings]
y = "q"
[parameters]
k = { value = 2.0, bounds = [1.0, 4.0] }
"""
SCALE = {"q": np.linspace(-1.0, 1.0, 21), "v": np.linspace(-2.0, 2.0, 21)}


def offered() -> SuperModel:
    model = parse_model(MODEL)
    return SuperModel.build(model, force_candidates(model, SCALE))


def first(every: SuperModel, mechanism: str, containing: str = "") -> int:
    """Number of the first candidate of a mechanism whose term contains some text."""
    found = enumerate(every.candidates)
    return next(
        i for i, c in found if c.mechanism == mechanism and any(containing in t for _, t in c.terms)
    )


def tabled(every: SuperModel, columns: dict[int, np.ndarray], y: np.ndarray, at=()) -> Table:
    """A table of one column a candidate, noise one; `at` are constants that are on."""
    numbers = list(columns)
    rows = np.column_stack([y, *(columns[i] for i in numbers)])
    none, wide = np.zeros(len(numbers)), np.full(len(numbers), 1e12)
    value = np.array([dict(at).get(i, 0.0) for i in numbers])
    belief = Belief(none, np.ones(len(numbers)), -wide, wide)
    own = {i: (k,) for k, i in enumerate(numbers)}
    noise = Noise(np.ones(1), np.zeros(1), np.zeros(1))
    scales = Scales(
        (), np.zeros(0), np.zeros(1), 0.0, (), noise, np.ones(1), np.ones(2), np.zeros(1)
    )
    return Table([Gram(rows.T @ rows, 0.0, len(y))], (), value, belief, own, {}, scales)


def test_forms_of_one_law_exclude_each_other_and_stops_on_both_sides_do_not() -> None:
    every = offered()
    coulomb, stribeck = first(every, "coulomb_friction"), first(every, "stribeck_friction")
    other = first(every, "stribeck_friction", "vs}))")
    drag, spring = first(every, "quadratic_drag"), first(every, "cubic_stiffness")
    above = first(every, "piecewise_stiffness", "Max")
    below = first(every, "piecewise_stiffness", "Min")
    assert exclusive(every, (coulomb, stribeck))
    assert exclusive(every, (stribeck, other, spring))
    assert exclusive(every, (drag, first(every, "power_law_drag")))
    assert exclusive(every, (above, above + 1))
    assert not exclusive(every, (above, below))
    assert not exclusive(every, (coulomb, drag, spring))


def test_what_makes_a_signal_late_has_the_others_that_do_as_rivals() -> None:
    model = parse_model(MODEL)
    two = parse_model(MODEL.replace('["y"]', '["y", "w"]').replace("[param", 'w = "v"\n[param'))
    for given, outputs in ((model, ["y"]), (two, ["y", "w"])):
        known = [*memory_candidates(given, SCALE, 0.01), *timing_candidates(given, 0.01, 1.0)]
        every = SuperModel.build(given, known)
        place = {c.label: i for i, c in enumerate(every.candidates)}
        lag = place["actuator_lag@input:u"]
        rivals = {every.candidates[i].label for (i,) in shifts(every, (lag,))}
        # of one input and one output the delay stands at the sensor for both
        single = len(outputs) == 1
        assert rivals == {"sensor_delay@output:y" if single else "input_delay@input:u"}
        late = place["sensor_delay@output:y"]
        assert bool(shifts(every, (late,))) == single
        # the rival begins with its time
        theta = np.array([p.value for p in every.model.parameters.values()])
        constants = {every.names[lag]["tau"]: (0.02, 1e-3)}
        near = estimated((lag,), {lag: every.names[lag]}, constants)
        (rival,) = shifts(every, (lag,))
        begun = _inherited(every, rival, near, theta)
        at = list(every.model.parameters).index(every.names[rival[0]]["tau"])
        assert begun[at] == 0.02


def estimated(
    members: tuple[int, ...],
    names: dict[int, dict[str, str]],
    constants: dict[str, tuple[float, float]],
) -> Hypothesis:
    """A set with its constants, and nothing else."""
    none, noise = np.zeros(0), Noise(np.ones(1), np.zeros(1), np.zeros(1))
    return Hypothesis(members, 0.0, 0.0, constants, names, none, none, True, noise, 0.0)


def test_of_laws_that_jump_those_inside_others_are_asked_first() -> None:
    every = offered()
    coulomb, stribeck = first(every, "coulomb_friction"), first(every, "stribeck_friction")
    drag, spring = first(every, "power_law_drag"), first(every, "cubic_stiffness")
    proposed = [(stribeck,), (drag,), (coulomb,), (spring,), (stribeck, spring), (coulomb, spring)]
    plain, kindred = plain_of_kin(every, proposed)
    assert plain == [(drag,), (coulomb,), (spring,), (coulomb, spring)]
    assert kindred == [(stribeck,), (stribeck, spring)]
    # where the law inside is not proposed, none is put off
    assert plain_of_kin(every, [(stribeck,), (drag,)]) == ([(stribeck,), (drag,)], [])


def test_a_swap_is_weighed_as_the_set_itself_would_be() -> None:
    """From a table about a path on which one law is on: as if the other alone had been there."""
    rng = np.random.default_rng(1)
    every = offered()
    a, b, c = (first(every, m) for m in ("coulomb_friction", "quadratic_drag", "cubic_stiffness"))
    columns = {i: rng.normal(size=80) for i in (a, b, c)}
    left = rng.normal(size=80) + 0.8 * columns[b]  # with nothing on
    there = left - 0.5 * columns[a]  # innovations are v + W c: a is on at -0.5
    about = tabled(every, columns, there, at={a: -0.5}.items())
    plain = tabled(every, columns, left)
    assert np.isclose(without(about, [0, 1], [0]), plain.best([1]), atol=1e-6)
    assert swaps(every, about, (a,), 1, 12.0) == [(b,)]
    assert swaps(every, about, (a,), 3, -1e3) == []


def test_a_pair_that_shows_only_together_is_proposed() -> None:
    """Two columns that nearly cancel: each alone explains next to nothing of their difference."""
    rng = np.random.default_rng(2)
    every = offered()
    a, b, c = (first(every, m) for m in ("coulomb_friction", "quadratic_drag", "cubic_stiffness"))
    common, apart = rng.normal(size=(2, 200))
    columns = {a: 8.0 * common + apart, b: 8.0 * common - apart, c: rng.normal(size=200)}
    y = rng.normal(size=200) + 0.7 * (columns[a] - columns[b])
    table = tabled(every, columns, y)
    alone = [table.best([k]) - table.best([]) for k in range(3)]
    assert max(alone) < 3.0
    assert pairs(every, table, (), 2, 5.0) == [tuple(sorted((a, b)))]
    assert pairs(every, tabled(every, columns, rng.normal(size=200)), (), 2, 5.0) == []


def test_a_pair_of_one_law_is_none() -> None:
    rng = np.random.default_rng(3)
    every = offered()
    a, b = first(every, "coulomb_friction"), first(every, "stribeck_friction")
    common, apart = rng.normal(size=(2, 200))
    columns = {a: 8.0 * common + apart, b: 8.0 * common - apart}
    y = rng.normal(size=200) + 0.7 * (columns[a] - columns[b])
    assert pairs(every, tabled(every, columns, y), (), 2, 5.0) == []


def test_a_power_of_a_rate_does_not_jump_and_dry_friction_does() -> None:
    every = {c.mechanism: c.jumps for c in offered().candidates}
    assert not every["power_law_drag"] and not every["quadratic_drag"]
    assert every["coulomb_friction"] and every["stribeck_friction"]
