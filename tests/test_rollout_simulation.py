"""Roll-outs: integration, and systems of terms as compiled functions."""

from __future__ import annotations

import numpy as np
from rollout_systems import (
    PENDULUM,
    TRUE,
    pendulum,
    solved,
    system_of,
    trace_of,
)

from jaxsr.discovery.rollout import System, cut
from jaxsr.discovery.rollout.simulate import simulate
from jaxsr.discovery.rollout.system import inner
from jaxsr.evolution import PrimitiveSet
from jaxsr.evolution.create import random_term
from jaxsr.expressions import evaluate
from jaxsr.expressions.editing import edit
from jaxsr.expressions.term import Term


def test_the_integration_converges_with_order_four_to_another_solver() -> None:
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 3.0, 16)
    inputs = rng.normal(size=(2, 16))
    traces = [trace_of(t + 5.0 * k, {"q": t, "v": t, "u": u}) for k, u in enumerate(inputs)]
    segments = cut(traces, 16, 9)
    constants = TRUE * rng.uniform(0.8, 1.2, size=(3, 6))
    starts = rng.uniform(-1.0, 1.0, size=(2, 3, 2))
    exact = np.empty((16, 2, 3, 2))
    for copy, k in np.ndindex(3, 2):
        times = t + 5.0 * k
        rates = pendulum(
            constants[copy], lambda s, k=k, times=times: np.interp(s, times, inputs[k])
        )
        exact[:, :, copy, k] = solved(rates, list(starts[:, copy, k]), times).T
    errors = []
    for substeps in (2, 4, 8, 16):
        out = simulate(PENDULUM.function(), ("q", "v"), "t", segments, constants, starts, substeps)
        assert np.array_equal(out[0], starts)
        errors.append(np.sqrt(np.mean((out - exact) ** 2, axis=(0, 1))))
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.all(np.abs(orders[1:] - 4.0) < 0.35), orders
    assert np.max(errors[-1]) < 1e-6


def test_a_copy_that_diverges_stops_and_leaves_the_others_alone() -> None:
    t = np.linspace(0.0, 2.0, 41)
    system = system_of({"x": ["x**2"]})
    segments = cut([trace_of(t, {"x": t})], 41, 1)
    starts = np.array([[[1.0], [0.3]]])  # 1/(1/x0 - t): the first ends at t = 1
    out = simulate(system.function(), ("x",), "t", segments, np.ones((2, 1)), starts, 8)[:, 0, :, 0]
    finite = np.isfinite(out)
    assert np.all(finite[:20, 0]) and not np.any(finite[30:, 0])
    assert np.all(np.diff(finite[:, 0].astype(int)) <= 0)  # once gone, gone for good
    np.testing.assert_allclose(out[:, 1], 1.0 / (1.0 / 0.3 - t), rtol=1e-8)


MANY = PrimitiveSet(
    functions=tuple("add sub mul div sin cos exp abs sign tanh log sqrt pow max heaviside".split()),
    constants=(-5.0, 5.0),
)


def _drawn(seed: int) -> tuple[np.random.Generator, System, dict[str, list[float]]]:
    rng = np.random.default_rng([seed, 1])
    names = ["t", "x", "y", "u"]
    terms: dict[str, list[Term]] = {}
    for state in ("x", "y"):
        drawn = [random_term(rng, names, MANY, int(rng.integers(1, 14))) for _ in range(3)]
        terms[state] = [t for t in edit(drawn) if t.args or t.is_variable]
    known = {"y": random_term(rng, names, MANY, 6)}
    weights = {s: rng.normal(size=len(found)).tolist() for s, found in terms.items()}
    return rng, System(terms, known), weights


def test_the_compiled_function_is_what_the_terms_say() -> None:
    """300 random systems of up to 6 terms; constants other than those written in the terms."""
    compared = 0
    for seed in range(300):
        rng, system, weights = _drawn(seed)
        free = system.constants(weights)
        other = free * rng.uniform(0.9, 1.1, size=len(free))
        other[other == np.round(other)] += 0.03125  # whole numbers would be read as given
        values = {name: rng.uniform(-2.0, 2.0, size=7) for name in ("t", "x", "y", "u")}
        with np.errstate(all="ignore"):
            rates = system.function()(values, other)
            for (state, rows), rate in zip(system.unpacked(other).items(), rates, strict=True):
                parts = [system.known[state]] if state in system.known else []
                expected = sum((evaluate(p, values) for p in parts), np.zeros(7))
                for term, weight, _ in rows:
                    expected = expected + weight * evaluate(term, values)
                np.testing.assert_allclose(rate + np.zeros(7), expected, rtol=1e-9, atol=1e-9)
                compared += int(np.count_nonzero(np.isfinite(expected)))
    assert compared > 300 * 7  # half of it has a value


def test_constants_of_a_system_come_back_and_whole_numbers_stay() -> None:
    counted = whole = 0
    for seed in range(200):
        rng, system, weights = _drawn(seed)
        free = system.constants(weights)
        back = system.unpacked(free)
        assert {s: [t for t, _, _ in rows] for s, rows in back.items()} == dict(system.terms)
        assert {s: [c for _, c, _ in rows] for s, rows in back.items()} == weights
        moved = free + rng.uniform(0.01, 0.02, size=len(free))
        moved[moved == np.round(moved)] += 0.001
        terms = {s: [t for t, _, _ in rows] for s, rows in system.unpacked(moved).items()}
        again = System(terms, system.known)
        parts = {s: [c for _, c, _ in rows] for s, rows in system.unpacked(moved).items()}
        np.testing.assert_array_equal(again.constants(parts), moved)
        places = [p for rows in back.values() for _, _, p in rows]
        assert np.array_equal(np.r_[tuple(places)] if places else [], np.arange(len(free)))
        for old, new in zip(system.terms["x"], terms["x"], strict=True):
            for a, b in zip(old.walk(), new.walk(), strict=True):
                if a.is_constant and a.value.is_integer():
                    whole += 1
                    assert a == b
            counted += len(inner(old))
    assert counted > 50 and whole > 50
