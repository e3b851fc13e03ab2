"""Mechanisms: every candidate is a sound edit of a model, with the physics it names."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from diagnosis_systems import ARM as ARM_FILE
from diagnosis_systems import CART, STIFF

from jaxsr._result import Verdict
from jaxsr.diagnosis.mechanisms import (
    Candidate,
    Threshold,
    force_candidates,
    sensor_candidates,
    sites_of,
)
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.mechanisms.timing import timing_candidates
from jaxsr.models import (
    Model,
    Simulator,
    apply_edit,
    difference,
    model_text,
    parse_model,
    read_model,
    with_values,
)
from jaxsr.models.units import check_units

ARM = read_model(ARM_FILE)
MASS = parse_model(STIFF)
# Promised to users: family and parameters by name.
PROMISED = {
    "wrong_value": ("parameter", None),
    "viscous_damping": ("dissipative", {"Fv"}),
    "coulomb_friction": ("dissipative", {"Fc"}),
    "asymmetric_friction": ("dissipative", {"Fa"}),
    "stribeck_friction": ("dissipative", {"Fc", "Fs", "vs"}),
    "position_dependent_friction": ("dissipative", None),
    "load_dependent_friction": ("dissipative", None),
    "coupled_friction": ("dissipative", {"Fc", "Fv", "n"}),
    "quadratic_drag": ("dissipative", {"kd"}),
    "power_law_drag": ("dissipative", {"kd", "p"}),
    "linear_stiffness": ("elastic", {"k1"}),
    "quadratic_stiffness": ("elastic", {"k2"}),
    "cubic_stiffness": ("elastic", {"k3"}),
    "piecewise_stiffness": ("elastic", {"ks", "qs"}),
    "end_stop": ("elastic", None),
    "backlash": ("elastic", {"kb", "b"}),
    "added_mass": ("inertial", {"ma"}),
    "gravity": ("inertial", {"mg"}),
    "constant_force": ("inertial", {"F0"}),
    "centrifugal_coupling": ("inertial", {"h"}),
    "coupling_stiffness": ("coupling", {"kc"}),
    "coupling_damping": ("coupling", {"cc"}),
    "harmonic_force": ("periodic", {"A", "w", "phi"}),
    "position_ripple": ("periodic", {"A", "n", "phi"}),
    "parametric_excitation": ("periodic", {"kp", "w", "phi"}),
    "hysteresis": ("memory", None),
    "actuator_lag": ("memory", {"tau"}),
    "hidden_mode": ("memory", None),
    "drift": ("memory", None),
    "overflow": ("memory", None),
    "input_saturation": ("actuator", {"us"}),
    "input_deadzone": ("actuator", {"ud"}),
    "input_curve": ("actuator", {"gc"}),
    "input_gain_by_state": ("actuator", None),
    "input_gain": ("actuator", {"g"}),
    "input_delay": ("actuator", {"tau"}),
    "sensor_gain": ("measurement", {"g"}),
    "sensor_bias": ("measurement", {"y0"}),
    "sensor_delay": ("measurement", {"tau"}),
    "clipping": ("measurement", {"ymax"}),
    "quantisation": ("measurement", {"step"}),
    "clock_skew": ("measurement", {"s"}),
    "transient_force": ("external", None),
    "unnamed": ("unnamed", None),
}
PARAMETER_LIKE, SENSOR_LIKE = {"wrong_value", "input_gain"}, {"input_delay"}


def candidates_of(model: Model) -> list[Candidate]:
    scale = {s: np.linspace(-2.0, 2.0, 21) for s in model.states}
    return [*force_candidates(model, scale), *sensor_candidates(model)]


CASES = [
    pytest.param(model, candidate, id=f"{label} {candidate.key}")
    for label, model in (("arm", ARM), ("mass", MASS))
    for candidate in candidates_of(model)
]


def engaged(candidate: Candidate, by: float = 0.25) -> dict[str, float]:
    """Values at which the mechanism acts: coefficients off their neutral value, seeds reached."""
    return {
        p.name: p.seed if isinstance(p, Threshold) else p.neutral + by * p.coefficient
        for p in candidate.parameters
    }


def names_in(model: Model, candidate: Candidate) -> dict[str, str]:
    return candidate.names({*model.symbols, *model.definitions})


def random_states(model: Model, seed: int = 0, count: int = 300) -> tuple[tuple, tuple]:
    rng = np.random.default_rng(seed)
    x = rng.uniform(-2.0, 2.0, (len(model.states), count))
    x = np.where(np.abs(x) < 0.01, 0.01, x)  # sign is run as tanh(v/1e-4)
    return tuple(x), tuple(rng.uniform(-5.0, 5.0, (len(model.inputs), count)))


def rates(model: Model, x: tuple, u: tuple) -> np.ndarray:
    simulator = Simulator(model)
    with jax.enable_x64(True):
        return np.array([np.asarray(r) for r in simulator.rates(0.7, x, u, simulator.values())])


def added_force(model: Model, candidate: Candidate, values: dict[str, float]) -> np.ndarray:
    """Generalised forces with the candidate minus those without, (states, samples)."""
    x, u = random_states(model)
    edited = apply_edit(model, candidate.edit(model, names_in(model, candidate), values))
    with jax.enable_x64(True):
        found = [
            np.array([np.asarray(f + 0 * x[0]) for f in s.forces(0.7, x, u, s.values())])
            for s in (Simulator(edited), Simulator(model))
        ]
    return found[0] - found[1]


@pytest.mark.parametrize(("model", "candidate"), CASES)
def test_names_and_families_are_those_promised(model, candidate):
    family, parameters = PROMISED[candidate.mechanism]
    assert candidate.family == family
    if parameters is not None:
        own = {p.name for p in candidate.parameters} | {name for name, _ in candidate.borrowed}
        assert own == parameters
    kind, _, place = candidate.site.partition(":")
    known = {
        "equation": model.states,
        "input": model.inputs,
        "output": model.outputs,
        "parameter": tuple(model.parameters),
        "external": model.states,
    }
    assert place in known[kind]
    if candidate.mechanism in PARAMETER_LIKE:
        expected = Verdict.PARAMETER
    elif candidate.mechanism in SENSOR_LIKE or family == "measurement":
        expected = Verdict.MEASUREMENT
    else:
        expected = Verdict.EXTERNAL_INPUT if family == "external" else Verdict.STRUCTURE
    assert candidate.verdict == expected


@pytest.mark.long
@pytest.mark.parametrize(("model", "candidate"), CASES)
def test_neutral_values_leave_the_model_as_it_was(model, candidate):
    edited = apply_edit(model, candidate.edit(model, names_in(model, candidate)))
    x, u = random_states(model)
    np.testing.assert_allclose(rates(edited, x, u), rates(model, x, u), rtol=1e-12, atol=1e-12)
    simulators = Simulator(edited), Simulator(model)
    with jax.enable_x64(True):
        y = [np.array(s.readings(0.7, x, u, s.values())) for s in simulators]
    np.testing.assert_allclose(*y, rtol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize(("model", "candidate"), CASES)
def test_other_values_change_it(model, candidate):
    values = engaged(candidate)
    edited = apply_edit(model, candidate.edit(model, names_in(model, candidate), values))
    x, u = random_states(model)
    simulators = Simulator(edited), Simulator(model)
    with jax.enable_x64(True):
        y = [np.array(s.readings(0.7, x, u, s.values())) for s in simulators]
    moved = np.abs(rates(edited, x, u) - rates(model, x, u)).max() + np.abs(y[0] - y[1]).max()
    assert moved > 1e-3


@pytest.mark.long
@pytest.mark.parametrize(("model", "candidate"), CASES)
def test_edited_model_reads_back_with_sound_units(model, candidate):
    values = engaged(candidate)
    edited = apply_edit(model, candidate.edit(model, names_in(model, candidate), values))
    for name in names_in(model, candidate).values():
        assert edited.parameters[name].unit is not None
    check_units(edited, "edited")
    again = parse_model(model_text(edited))
    x, u = random_states(model)
    np.testing.assert_allclose(rates(again, x, u), rates(edited, x, u), rtol=1e-12)


@pytest.mark.parametrize(("model", "candidate"), CASES)
def test_edit_names_every_key_it_changes_and_no_other(model, candidate):
    values = engaged(candidate)
    edit = candidate.edit(model, names_in(model, candidate), values)
    edited = apply_edit(model, edit)
    assert set(edit.changes) == set(difference(model, edited).changes)
    for spec in candidate.parameters:
        full = names_in(model, candidate)[spec.name]
        assert f"parameters.{full}" in edit.changes
        assert edited.parameters[full].free is not spec.fixed


@pytest.mark.parametrize(("model", "candidate"), CASES)
def test_new_names_clash_with_nothing(model, candidate):
    names = names_in(model, candidate)
    assert len(set(names.values())) == len(names)
    if candidate.fixed_parameter is None:
        taken = {*model.symbols, *model.definitions, *model.outputs}
        assert not taken & set(names.values())


def test_clashing_names_get_the_state_appended():
    names = {
        c.site: names_in(MASS, c) for c in candidates_of(MASS) if c.mechanism == "viscous_damping"
    }
    assert names == {"equation:v": {"Fv": "Fv_v"}}


@pytest.mark.parametrize("model", [ARM, MASS], ids=["arm", "mass"])
def test_all_candidates_together_leave_the_model_as_it_was(model):
    candidates = candidates_of(model)
    built = SuperModel.build(model, candidates)
    named = [
        n
        for c, own in zip(candidates, built.names, strict=True)
        if c.fixed_parameter is None
        for n in own.values()
    ]
    assert len(set(named)) == len(named)
    x, u = random_states(model)
    np.testing.assert_allclose(rates(built.model, x, u), rates(model, x, u), rtol=1e-10, atol=1e-10)
    order = list(built.model.parameters)
    assert [order[i] for i in built.base_index()] == list(model.free_parameters)
    for number, candidate in enumerate(candidates):
        found = [order[i] for i in built.index(number)]
        free = [p.name for p in candidate.parameters if not p.fixed]
        assert found == [built.names[number][name] for name in free]


@pytest.mark.parametrize(
    ("model", "candidate"),
    [
        p
        for p in CASES
        if p.values[1].mechanism
        in {
            "viscous_damping",
            "coulomb_friction",
            "stribeck_friction",
            "quadratic_drag",
            "power_law_drag",
            "position_dependent_friction",
            "coupling_damping",
        }
    ],
)
def test_friction_takes_energy_out(model, candidate):
    values = {
        # friction that varies along the path must be positive everywhere on it
        p.name: {"Fs": 0.6, "g1": 0.05}.get(p.name, 0.4) if p.coefficient else p.neutral
        for p in candidate.parameters
    }
    assert candidate.physical is None or candidate.physical(values)
    x, _ = random_states(model)
    power = np.sum(added_force(model, candidate, values) * np.array(x), axis=0)
    assert (power <= 0.0).all() and power.min() < -1e-3
    for spec in candidate.parameters:
        if spec.coefficient:
            negative = {**values, spec.name: -10.0 * values["Fc"]} if "Fc" in values else values
            refused = candidate.physical is not None and not candidate.physical(negative)
            assert spec.low == 0.0 or refused


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_asymmetry_dissipates_beside_at_least_as_much_viscous_friction(sign):
    """-Fv*v - Fa*|v| opposes the motion while |Fa| <= Fv; Fv of the model is 1."""
    (candidate,) = [c for c in candidates_of(MASS) if c.mechanism == "asymmetric_friction"]
    (_, v), _ = random_states(MASS)
    force = added_force(MASS, candidate, {"Fa": 0.9 * sign})[1] - 1.0 * v
    assert (force * v < 0).all()


def test_couplings_push_both_axes_alike():
    """Action equals reaction, and the spring does no work when the axes move as one."""
    for candidate in candidates_of(ARM):
        if candidate.family != "coupling":
            continue
        force = added_force(ARM, candidate, {p.name: 0.7 for p in candidate.parameters})
        np.testing.assert_allclose(force[2], -force[3], atol=1e-12)


@pytest.mark.parametrize(
    ("mechanism", "name", "law"),
    [
        ("viscous_damping", "Fv", lambda q, v: -0.7 * v),
        ("quadratic_drag", "kd", lambda q, v: -0.7 * v * np.abs(v)),
        ("coulomb_friction", "Fc", lambda q, v: -0.7 * np.sign(v)),
        ("asymmetric_friction", "Fa", lambda q, v: -0.7 * np.abs(v)),
        ("linear_stiffness", "k1", lambda q, v: -0.7 * q),
        ("quadratic_stiffness", "k2", lambda q, v: -0.7 * q**2),
        ("cubic_stiffness", "k3", lambda q, v: -0.7 * q**3),
        ("constant_force", "F0", lambda q, v: 0.7 + 0 * q),
    ],
)
def test_force_laws_have_the_promised_sign_and_form(mechanism, name, law):
    (candidate,) = [c for c in candidates_of(MASS) if c.mechanism == mechanism]
    (q, v), _ = random_states(MASS)
    # sign is run as tanh(v/1e-4).
    np.testing.assert_allclose(
        added_force(MASS, candidate, {name: 0.7})[1], law(q, v), rtol=1e-9, atol=1e-9
    )


def test_added_mass_adds_to_the_inertia():
    (candidate,) = [c for c in candidates_of(MASS) if c.mechanism == "added_mass"]
    edited = apply_edit(MASS, candidate.edit(MASS, names_in(MASS, candidate), {"ma": 0.5}))
    x, u = random_states(MASS)
    heavier = with_values(MASS, {"M": 2.5})
    np.testing.assert_allclose(rates(edited, x, u), rates(heavier, x, u), rtol=1e-12)


def test_wrong_values_are_offered_for_fixed_parameters_alone():
    found = {c.fixed_parameter for c in candidates_of(MASS) if c.mechanism == "wrong_value"}
    assert found == {"M", "Fv", "c"}
    assert not [c for c in candidates_of(ARM) if c.mechanism == "wrong_value"]


def test_gravity_belongs_to_turning_axes():
    assert {c.site for c in candidates_of(ARM) if c.mechanism == "gravity"} == {
        "equation:w1",
        "equation:w2",
    }
    assert not [c for c in candidates_of(MASS) if c.mechanism == "gravity"]


def test_sites_know_position_and_unit():
    w1, w2 = sites_of(ARM, {})
    assert (w1.state, w1.position, w1.turning, w1.force_unit) == ("w1", "q1", True, "N*m")
    assert [o.state for o in w2.others] == ["w1"]
    (v,) = sites_of(MASS, {})
    assert (v.position, v.turning, v.force_unit) == ("q", False, "N")


def test_a_single_signal_has_no_clock_to_differ_from():
    falling = parse_model(
        """
[model]
states = ["y", "v"]
outputs = ["height"]
[equations]
y = "v"
v = "-9.81"
[readings]
height = "y"
"""
    )
    assert timing_candidates(falling, 0.01, 1.0) == []


def test_a_long_equation_takes_every_mechanism_offered_beside_it() -> None:
    """The force of a serial arm, written out, fills thousands of characters on its own."""
    parts = [f"{0.001 / k:.18f}*c*q**{k % 5}*sin({k}.000000000000001*q)" for k in range(1, 165)]
    long = " + ".join(parts)
    model = parse_model(CART.replace("u - c*v", f"{long} - c*v"))
    assert 7_500 < len(model.equations["v"]) < 10_000
    scale = {s: np.linspace(-2.0, 2.0, 21) for s in "qv"}
    candidates = force_candidates(model, scale)
    super_model = SuperModel.build(model, candidates)
    assert len(super_model.model.equations["v"]) > 10_000
    assert len(super_model.model.equation_terms["v"].variables) > len(candidates)
