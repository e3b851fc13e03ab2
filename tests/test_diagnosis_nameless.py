"""Laws without a name, found by a diagnosis."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from diagnosis_systems import CART, TANKS, TWO_MASSES
from scipy.integrate import solve_ivp

from jaxsr import diagnose
from jaxsr.diagnosis.laws.unnamed import (
    has_a_name,
)
from jaxsr.expressions import parse
from jaxsr.models import Simulator, parse_model
from jaxsr.recordings import Recording


def detent(q):
    """A force that pulls to the middle near it, and far away no longer."""
    s = q / 0.4
    return -4.0 * s / (1.0 + s**2) ** 2


def test_powers_drags_and_ripples_have_names():
    def proposal(*texts: str):
        return SimpleNamespace(terms=tuple(parse(t) for t in texts))

    for named in (("q",), ("q**3", "q"), ("q*Abs(q)",), ("sin(3.1*q + 0.2)", "q"), ("q**2*q",)):
        assert has_a_name(proposal(*named)), named
    laws = ("q*exp(-q**2)",), ("q/(q**4 + 1.7)",), ("q**5",), ("q", "tanh(3*q)"), ("1/q",)
    for law in (*laws, ("q**2*v",)):
        assert not has_a_name(proposal(*law)), law


@pytest.mark.long
def test_a_law_without_a_name_is_found_where_its_equation_hides():
    """Only the first of two masses is measured; a detent acts on the second."""
    rng = np.random.default_rng(5)
    time, phases = np.arange(0.0, 60.0, 0.02), rng.uniform(0.0, 6.0, 8)
    u = 3.0 * np.sin(2 * np.pi * np.linspace(0.1, 1.2, 8) * time[:, None] + phases).sum(1)

    def rates(t, x):
        a, b, va, vb = x
        first = np.interp(t, time, u) - 9.0 * a - 0.4 * va + 6.0 * (b - a)
        return [va, vb, first, -4.0 * b - 0.3 * vb + 6.0 * (a - b) + 1.6 * detent(b)]

    path = solve_ivp(rates, (0.0, time[-1]), np.zeros(4), t_eval=time, rtol=1e-9, max_step=0.02)
    y = path.y[0] + 2e-3 * rng.normal(size=time.size)
    model = parse_model(TWO_MASSES.replace('"y", "z"', '"y"').replace('z = "b"\n', ""))
    found = diagnose(Simulator(model), [Recording("a.csv", time, {"u": u, "y": y})], budget=120.0)
    first = found.findings[0]
    assert (first["mechanism"], first["site"]) == ("unnamed", "equation:vb")
    train = found.fit["train"]
    assert train["explained"][-1] < 0.5 * train["recalibrated"][-1]


@pytest.mark.long
def test_damping_by_the_square_of_the_way_is_no_friction_that_jumps():
    """Dry friction by the position, its jump rounded over all speeds, would be the same law.

    The explained model, run as it is written, has the errors that are reported.
    """

    def squeezed(t, x):
        force = np.interp(t, time, u) - 3.0 * x[1] - 8.0 * x[0] - 4.0 * x[0] ** 2 * x[1]
        return [x[1], force / 2.0]

    rng = np.random.default_rng(8)
    time, phases = np.arange(0.0, 20.0, 0.02), rng.uniform(0.0, 6.0, 8)
    u = 8.0 * np.sin(2 * np.pi * np.linspace(0.1, 1.2, 8) * time[:, None] + phases).sum(1)
    path = solve_ivp(squeezed, (0.0, 20.0), [0.0, 0.0], t_eval=time, rtol=1e-9, max_step=0.02)
    y = path.y[0] + 2e-3 * rng.normal(size=time.size)
    recording = Recording("a.csv", time, {"u": u, "y": y})
    found = diagnose(Simulator(parse_model(CART)), [recording], budget=60.0)
    first = found.findings[0]
    assert (first["mechanism"], first["site"]) == ("unnamed", "equation:v")
    run = found.explained.simulate(recording)
    error = np.sqrt(np.mean((run.channels["y"] - y) ** 2)) / np.std(y)
    train = found.fit["train"]
    assert train["explained"][-1] < 0.5 * train["recalibrated"][-1]
    assert error < 1.5 * train["explained"][-1]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_an_outflow_of_another_law_is_said_to_have_no_name(seed: int) -> None:
    """The lower tank empties by 0.05*sqrt(h) + 0.01*h; the upper level is not measured."""
    rng = np.random.default_rng(seed)
    drive = np.repeat(rng.uniform(0.5, 4.5, 50), 12)
    upper, lower, level, fine = 4.0, 4.0, np.empty(drive.size), 40
    for k, u in enumerate(drive):
        level[k] = lower
        for _ in range(fine):
            flow = 0.06 * np.sqrt(upper)
            upper += (0.065 * u - flow) * 4.0 / fine
            lower += (flow - 0.05 * np.sqrt(lower) - 0.01 * lower) * 4.0 / fine
    y = level + 0.01 * rng.normal(size=level.size)
    recording = Recording("run.csv", 4.0 * np.arange(drive.size), {"u": drive, "y": y})
    found = diagnose(Simulator(parse_model(TANKS)), [recording], seed=0)
    assert found.verdict == "structure"
    named = {(row["mechanism"], row["site"]) for row in found.findings}
    assert ("unnamed", "equation:h2") in named
    train = found.fit["train"]
    assert train["explained"][-1] < 0.3 * train["recalibrated"][-1]
