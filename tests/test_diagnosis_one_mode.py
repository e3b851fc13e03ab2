"""Mechanisms that act on one side of a switch of the model only."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from diagnosis_systems import on_an_axis

from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.one_mode import SWITCHED, modes_of, one_mode
from jaxsr.expressions import parse, to_numpy, to_text
from jaxsr.models import Model, Simulator, apply_edit, parse_model

FREE = {"k": "value = 300.0, bounds = [1.0, 900.0]", "M": "value = 2.0", "q0": "value = 0.1"}
FORCES = {
    "piecewise": "u - Piecewise((k*(q - q0), q > q0), (0, True))",
    "ramp": "u - k*Max(q, q0)",
    "step": "u - k*Heaviside(q - q0)",
}
SCALE = {"q": np.linspace(-2.0, 2.0, 21), "v": np.linspace(-2.0, 2.0, 21)}
RNG = np.random.default_rng(4)
SIGNALS = {n: RNG.uniform(-2.0, 2.0, 400) for n in ("t", "q", "v", "u")}


def model_of(force: str) -> Model:
    return parse_model(on_an_axis(force, FREE))


def force(model: Model) -> np.ndarray:
    simulator = Simulator(model)
    states = SIGNALS["q"], SIGNALS["v"]
    with jax.enable_x64(True):
        out = simulator.forces(0.7, states, (SIGNALS["u"],), simulator.values())[1]
    return np.asarray(out)


@pytest.mark.parametrize("text", FORCES.values(), ids=FORCES)
def test_the_modes_of_a_model_are_the_two_sides_of_its_switch(text: str) -> None:
    modes = modes_of(model_of(text))
    known = SIGNALS | {"q0": 0.1, "k": 300.0}
    sides = [np.asarray(to_numpy(mode)(known)) for mode in modes]
    assert len(modes) == 2
    np.testing.assert_array_equal(sides[0], ~sides[1])
    np.testing.assert_array_equal(sides[0] if sides[0][0] == (SIGNALS["q"][0] > 0.1) else sides[1],
                                  SIGNALS["q"] > 0.1)  # fmt: skip


@pytest.mark.parametrize("text", ["u - k*q", "u - k*sign(q)", "u - k*Max(k, 1)*q"])
def test_a_model_of_one_law_has_no_modes(text: str) -> None:
    assert modes_of(model_of(text)) == []


def test_a_force_on_one_side_and_on_the_other_make_the_whole_force() -> None:
    model = model_of(FORCES["piecewise"])
    plain = [c for c in force_candidates(model, SCALE) if c.mechanism in SWITCHED]
    halves = list(one_mode(model, plain, SIGNALS))
    assert {c.mechanism for c in plain} == SWITCHED
    base = force(model)
    for candidate in plain:
        one, other = (c for c in halves if c.label == candidate.label)
        value = RNG.uniform(0.1, 5.0)
        (name,) = (p.name for p in candidate.parameters)
        added = [
            force(apply_edit(model, c.edit(model, {name: name}, {name: value}))) - base
            for c in (candidate, one, other)
        ]
        np.testing.assert_allclose(added[1] + added[2], added[0], rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(added[1] * added[2], 0.0)
        assert np.any(added[1] != 0.0) and np.any(added[2] != 0.0)


def test_a_mode_that_is_hardly_visited_is_left_out() -> None:
    model = model_of(FORCES["piecewise"])
    plain = force_candidates(model, SCALE)
    below = SIGNALS | {"q": np.minimum(SIGNALS["q"], 0.1)}
    assert not list(one_mode(model, plain, below))


def test_the_added_term_is_read_back_with_its_condition() -> None:
    model = model_of(FORCES["ramp"])
    plain = [c for c in force_candidates(model, SCALE) if c.mechanism == "viscous_damping"]
    for candidate in one_mode(model, plain, SIGNALS):
        text = candidate.term_text({"Fv": "Fv"})
        inner = next(n for n in parse(text).walk() if n.op == "piecewise")
        assert to_text(inner.args[1]) in candidate.sentence


def test_modes_of_equations_whose_definitions_share_parts_are_found() -> None:
    """Written out, forty definitions of two of the one before are more than can be visited."""
    chain = [f'd{k} = "0.5*d{k - 1} + 0.5*cos(d{k - 1})"' for k in range(1, 41)]
    text = "\n".join(
        [
            '[model]\nname = "shared"\nstates = ["q", "v"]\noutputs = ["y"]',
            '[definitions]\nd0 = "Max(q, 0.1)"',
            *chain,
            '[equations]\nq = "v"\nv = "-k*q - d40"',
            '[readings]\ny = "q"\n[parameters]\nk = 2.0',
        ]
    )
    modes = modes_of(parse_model(text))
    assert {to_text(mode) for mode in modes} == {"q > 0.1", "q <= 0.1"}
