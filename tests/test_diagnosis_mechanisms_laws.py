"""Force laws of the mechanisms against their closed forms, and their weak columns."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from diagnosis_systems import ARM as ARM_FILE
from diagnosis_systems import SPRUNG, STIFF
from weak_singles import best_of

from benchmarks.concealed.weak_columns import WeakColumns, with_candidates
from jaxsr.diagnosis.likelihood.posterior import posterior
from jaxsr.diagnosis.mechanisms import (
    FAMILIES,
    Threshold,
    force_candidates,
    register_mechanism,
    sensor_candidates,
)
from jaxsr.diagnosis.mechanisms.actuator import actuator
from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import Seen, prepare, seen_by
from jaxsr.diagnosis.weak.weak_grid import WeakGrid
from jaxsr.diagnosis.weak.weak_system import weak_system
from jaxsr.models import Model, Simulator, apply_edit, model_text, parse_model, read_model
from jaxsr.recordings import Recording

MASS = parse_model(STIFF)
SCALE = {"q": np.linspace(-2.0, 2.0, 21), "v": np.linspace(-2.0, 2.0, 21)}
TIME = np.arange(0.0, 20.0, 0.01)
NOW = 0.7


def states(count: int = 100) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return rng.uniform(-2, 2, count), rng.uniform(-2, 2, count), rng.uniform(-5, 5, count)


def force(model: Model) -> np.ndarray:
    q, v, u = states()
    simulator = Simulator(model)
    with jax.enable_x64(True):
        return np.asarray(simulator.forces(NOW, (q, v), (u,), simulator.values())[1])


def clip(x, a):
    return np.clip(x, -a, a)


LAWS = [
    ("power_law_drag", {"kd": 0.7, "p": 1.3}, lambda q, v, u: -0.7 * np.sign(v) * abs(v) ** 1.3),
    (
        "position_dependent_friction",
        {"Fc": 0.5, "g2": 0.3},
        lambda q, v, u: -(0.5 + 0.3 * q**2) * np.sign(v),
    ),
    (
        "position_dependent_friction",
        {"Fc": 0.5, "g1": 0.3},
        lambda q, v, u: -(0.5 + 0.3 * q) * np.sign(v),
    ),
    (
        "backlash",
        {"kb": 3.0, "b": 0.4},
        lambda q, v, u: -3.0 * (np.maximum(q - 0.4, 0) + np.minimum(q + 0.4, 0)),
    ),
    ("end_stop", {"ks": 90.0, "qs": 1.5}, lambda q, v, u: -90.0 * np.maximum(q - 1.5, 0)),
    (
        "end_stop",
        {"ks": 90.0, "cs": 5.0, "qs": 1.5},
        lambda q, v, u: -(90.0 + 5.0 * v) * np.maximum(q - 1.5, 0),
    ),
    (
        "harmonic_force",
        {"A": 2.0, "w": 3.0, "phi": 0.4},
        lambda q, v, u: 2.0 * np.sin(3.0 * NOW + 0.4) + 0 * q,
    ),
    (
        "position_ripple",
        {"A": 2.0, "n": 3.0, "phi": 0.4},
        lambda q, v, u: 2.0 * np.sin(3.0 * q + 0.4),
    ),
    (
        "parametric_excitation",
        {"kp": 2.0, "w": 3.0, "phi": 0.4},
        lambda q, v, u: -2.0 * q * np.cos(3.0 * NOW + 0.4),
    ),
    (
        "transient_force",
        {"J": 2.0, "t0": 0.5, "dt": 0.3},
        lambda q, v, u: 2.0 / 0.3 / np.sqrt(np.pi) * np.exp(-((0.2 / 0.3) ** 2)) + 0 * q,
    ),
    ("input_gain", {"g": 1.2}, lambda q, v, u: 0.2 * u),
    ("input_saturation", {"us": 2.0}, lambda q, v, u: clip(u, 2.0) - u),
    ("input_deadzone", {"ud": 2.0}, lambda q, v, u: -clip(u, 2.0)),
]


@pytest.mark.parametrize(("mechanism", "values", "law"), LAWS)
def test_a_written_and_reread_edit_adds_the_closed_form(mechanism, values, law):
    candidate = next(
        c
        for c in force_candidates(MASS, SCALE)
        if c.mechanism == mechanism and {p.name for p in c.parameters} == values.keys()
    )
    names = candidate.names({*MASS.symbols, *MASS.definitions})
    edited = apply_edit(MASS, candidate.edit(MASS, names, values))
    added = force(parse_model(model_text(edited))) - force(MASS)
    np.testing.assert_allclose(added, law(*states()), rtol=1e-8, atol=1e-8)


def test_a_compressive_curve_is_a_saturation_too():
    found = [c for c in force_candidates(MASS, SCALE) if c.mechanism == "input_saturation"]
    curve = next(c for c in found if "tanh" in c.terms[0][1])
    edited = apply_edit(MASS, curve.edit(MASS, {"us": "us"}, {"us": 2.0}))
    u = states()[2]
    np.testing.assert_allclose(
        force(edited) - force(MASS), 2 * np.tanh(u / 2) - u, rtol=1e-9, atol=1e-12
    )


def test_a_limit_is_looked_for_among_the_largest_commands():
    """Commands of 20 to 40: the mildest limit cuts off about one in fifty, wherever they lie."""
    u = np.linspace(20.0, 40.0, 501)
    limits = [c for c in actuator(MASS, {"u": u}) if c.mechanism == "input_saturation"]
    seeds = [c.parameters[0].seed for c in limits if "tanh" not in c.terms[0][1]]
    assert np.mean(u > max(seeds)) == pytest.approx(0.02, abs=0.005)


def test_an_input_acts_through_its_column_in_every_equation():
    """u enters as (2 + q)*u: a gain adds (g - 1)*(2 + q)*u."""
    bare = model_text(MASS).partition("[units]")[0]
    model = parse_model(bare.replace("u - k*q", "u*(2 + q) - k*q"))
    candidate = next(c for c in force_candidates(model, SCALE) if c.mechanism == "input_gain")
    edited = apply_edit(model, candidate.edit(model, {"g": "g"}, {"g": 1.5}))
    q, _, u = states()
    np.testing.assert_allclose(force(edited) - force(model), 0.5 * (2 + q) * u, rtol=1e-9)


def test_inputs_that_act_nonlinearly_get_no_actuator_mechanism():
    text = model_text(parse_model(STIFF)).replace("u - k*q", "u**3 - k*q").partition("[units]")[0]
    found = {c.family for c in force_candidates(parse_model(text), SCALE)}
    assert "actuator" not in found


def test_the_place_of_an_input_is_read_off_without_computer_algebra(monkeypatch):
    """An arm's definitions, simplified by SymPy, took a third of a diagnosis."""
    import sympy

    monkeypatch.setattr(sympy, "simplify", None)
    monkeypatch.setattr(sympy, "diff", None)
    found = list(actuator(read_model(ARM_FILE)))
    assert {c.site for c in found} == {f"input:{u}" for u in read_model(ARM_FILE).inputs}


@pytest.mark.parametrize(("side", "lever"), [(1.0, "Max"), (-1.0, "Min")])
def test_an_end_stop_with_loss_never_gives_back_more_than_its_spring(side, lever):
    candidate = next(
        c
        for c in force_candidates(MASS, SCALE)
        if c.mechanism == "end_stop" and "{cs}" in c.terms[0][1] and lever in c.terms[0][1]
    )
    values = {"ks": 0.0, "cs": 3.0, "qs": side * 1.0}
    edited = apply_edit(MASS, candidate.edit(MASS, {n: n for n in values}, values))
    v = states()[1]
    power = (force(edited) - force(MASS)) * v
    assert (power <= 1e-12).all() and power.min() < -1e-3


# Weak columns and conditions, on a simulated arm and a mass.


def recording(added=lambda q, v, t: 0.0, frequency: float = 0.0, seed: int = 1) -> Recording:
    """A driven mass on a spring (SPRUNG at its given values) with an added force."""
    from scipy.integrate import solve_ivp

    rng = np.random.default_rng(seed)
    tones = rng.uniform(0.3, 6.0, 8), rng.uniform(0, 6.28, 8)

    def u(t) -> np.ndarray:
        if frequency:
            return 6.0 * np.sin(frequency * np.asarray(t))
        return 3.0 * np.sin(np.multiply.outer(t, tones[0]) + tones[1]).sum(-1)

    def field(t, s):
        return [s[1], (u(t) - 30 * s[0] - 2 * s[1] + added(s[0], s[1], t)) / 2.0]

    span = (0.0, TIME[-1])
    x = solve_ivp(field, span, [0.0, 0.0], t_eval=TIME, rtol=1e-8, atol=1e-9, max_step=0.02).y
    noise = 1e-4 * rng.standard_normal(TIME.size)
    return Recording("one.csv", TIME, {"u": u(TIME), "y": x[0] + noise})


def seen(item: Recording) -> Seen:
    model = parse_model(SPRUNG)
    found = seen_by(Simulator(model), prepare(model, [item]))
    assert found is not None
    return found


def offered(item: Recording) -> list[Candidate]:
    return list(seen(item).candidates)


def best_single(item: Recording) -> tuple[str, dict[str, float]]:
    return best_of(parse_model(SPRUNG), seen(item))


def test_columns_evaluated_alone_are_those_of_the_differentiated_model():
    model = read_model(ARM_FILE)
    folder = ARM_FILE.parent
    prepared = prepare(model, [folder / "set1_train.csv"])
    scale = {s: np.linspace(-1.5, 1.5, 21) for s in model.states}
    smooth = {
        "viscous_damping linear_stiffness cubic_stiffness added_mass gravity coupling_damping "
        "centrifugal_coupling position_ripple input_gain quadratic_drag backlash".split()[k]
        for k in range(11)
    }
    chosen = [c for c in force_candidates(model, scale) if c.mechanism in smooth]
    built = SuperModel.build(model, chosen)
    theta = np.array([p.value for p in model.parameters.values()])
    width = 0.2
    grid = WeakGrid.build(model, prepared, width)
    given = weak_system(Simulator(model), grid, theta)
    quick = with_candidates(WeakColumns(grid), given, built)
    full = np.array([p.value for p in built.model.parameters.values()])
    exact = weak_system(Simulator(built.model), grid, full)
    size = np.abs(exact.jacobian).max(axis=0)
    assert (size > 0).sum() > 30
    np.testing.assert_allclose(quick.jacobian, exact.jacobian, rtol=0, atol=1e-9 * size.max())
    np.testing.assert_allclose(quick.residual, exact.residual)


def test_a_thresholds_column_is_the_secant_to_its_seed():
    model = parse_model(SPRUNG)
    prepared = prepare(model, [recording()])
    found = [c for c in force_candidates(model, SCALE) if c.family == "actuator"]
    built = SuperModel.build(model, found)
    theta = np.array([p.value for p in model.parameters.values()])
    grid = WeakGrid.build(model, prepared, 0.2)
    given = weak_system(Simulator(model), grid, theta)
    quick = with_candidates(WeakColumns(grid), given, built)
    order = list(built.model.parameters)
    for candidate, names in zip(found, built.names, strict=True):
        spec = candidate.parameters[0]
        if not isinstance(spec, Threshold):
            continue
        values = quick.theta.copy()
        values[order.index(names[spec.name])] = spec.seed
        edited = apply_edit(model, candidate.edit(model, names, {spec.name: spec.seed}))
        at = np.array([p.value for p in edited.parameters.values()])
        exact = weak_system(Simulator(edited), grid, at)
        np.testing.assert_allclose(quick.at(values), exact.residual, atol=1e-3)


def mechanisms(item: Recording) -> set[str]:
    return {c.mechanism for c in offered(item)}


def believed(item: Recording) -> set[str]:
    """The mechanisms of the most probable set."""
    model = parse_model(SPRUNG)
    found = posterior(model, prepare(model, [item]))
    assert found is not None
    return {found.candidates[i].mechanism for i in found.leader.members}


@pytest.mark.long
def test_a_push_in_time_is_believed_where_there_is_one():
    assert believed(recording()) == set()
    label, values = best_single(recording(lambda q, v, t: 1.0 * np.sin(9.0 * t + 0.8)))
    assert label == "harmonic_force@equation:v"
    assert values["w"] == pytest.approx(9.0, rel=0.01)
    assert abs(values["A"]) == pytest.approx(1.0, rel=0.15)


@pytest.mark.slow
def test_harmonics_of_a_periodic_input_are_no_push():
    """Dry friction under a sine has lines at odd multiples of the input's frequency."""
    item = recording(lambda q, v, t: -2.0 * np.tanh(v / 1e-3), frequency=4.0)
    assert believed(item) == {"coulomb_friction"}


@pytest.mark.long
def test_an_end_stop_needs_a_sharp_turn_at_one_place():
    assert "end_stop" not in mechanisms(recording())
    assert "end_stop" not in mechanisms(recording(frequency=4.0))
    item = recording(lambda q, v, t: -3e4 * max(q - 0.15, 0.0))
    stops = [c for c in offered(item) if c.mechanism == "end_stop"]
    assert stops and all("Max" in c.terms[0][1] for c in stops)


def test_friction_along_the_path_needs_both_ways_everywhere():
    assert "position_dependent_friction" in mechanisms(recording())
    time = TIME
    creep = Recording("creep.csv", time, {"u": 40.0 * time, "y": 40.0 / 30.0 * time})
    assert "position_dependent_friction" not in mechanisms(creep)


def test_a_cubic_spring_needs_its_rest_position_inside_the_path():
    away = {"q": np.linspace(1.0, 2.0, 21), "v": SCALE["v"]}
    names = {c.mechanism for c in force_candidates(MASS, away)}
    assert not names & {"cubic_stiffness", "backlash"} and "linear_stiffness" in names


def test_a_ripple_needs_a_turning_coordinate_or_a_drive():
    text = model_text(parse_model(STIFF)).replace("u - k*q", "-k*q")
    found = {c.mechanism for c in force_candidates(parse_model(text), SCALE)}
    assert "position_ripple" not in found
    label, values = best_single(recording(lambda q, v, t: 1.0 * np.sin(14.0 * q + 0.5)))
    assert label == "position_ripple@equation:v"
    assert values["n"] == pytest.approx(14.0, rel=0.03)


def test_a_swinging_stiffness_is_found_at_its_frequency():
    label, values = best_single(recording(lambda q, v, t: -4.0 * q * np.cos(3.0 * t + 0.5)))
    assert label == "parametric_excitation@equation:v"
    assert values["w"] == pytest.approx(3.0, rel=0.02)


def test_a_push_needs_a_residual_concentrated_in_time():
    assert "transient_force" not in mechanisms(recording(lambda q, v, t: -40.0 * q**3))
    item = recording(lambda q, v, t: 8.0 * np.exp(-(((t - 12.0) / 0.4) ** 2)))
    label, values = best_single(item)
    assert label == "transient_force@external:v"
    assert values["t0"] == pytest.approx(12.0, abs=0.2)


@pytest.mark.long
@pytest.mark.parametrize(
    ("mechanism", "change"),
    [
        ("input_saturation", lambda u: np.clip(u, -5.0, 5.0) - u),
        ("input_deadzone", lambda u: -np.clip(u, -1.5, 1.5)),
    ],
)
def test_a_nonlinear_actuator_is_believed_where_there_is_one(mechanism, change):
    plain = recording()
    u = plain.channel("u")
    item = recording(lambda q, v, t: float(change(np.interp(t, TIME, u))))
    assert believed(item) == {mechanism}


def test_clipping_needs_readings_that_stand_still_at_the_limit():
    model = parse_model(SPRUNG)
    y = recording().channel("y")

    def names(values: np.ndarray) -> set[str]:
        return {c.mechanism for c in sensor_candidates(model, {"y": values})}

    assert "clipping" not in names(y)
    clipped = np.clip(y, -0.6 * y.max(), 0.6 * y.max())
    assert "clipping" in names(clipped)
    # A limit before the noise, and a limit that is reached but once.
    noise = 1e-3 * y.max() * np.random.default_rng(4).normal(size=y.size)
    assert "clipping" in names(clipped + noise) and "clipping" not in names(y + noise)
    once = y + noise
    top = int(np.argmax(np.abs(once)))
    once[top - 2 : top + 3] = 1.1 * once[top]
    assert "clipping" in names(once)
    # The same through a converter that repeats a reading here and there.
    step = float(np.quantile(np.abs(np.diff(y)), 0.2))
    coarse = step * np.round(y / step)
    assert np.mean(np.diff(coarse) == 0.0) > 0.02 and "clipping" not in names(coarse)
    top = int(np.argmax(np.abs(coarse)))
    coarse[top - 15 : top + 16] = 1.1 * coarse[top]
    assert "clipping" in names(coarse)


def test_a_registered_mechanism_is_found_by_its_own_name():
    """A friction that fades with speed, in ten lines of a user's own."""

    @register_mechanism
    def fading(site):
        v = site.state
        yield Candidate(
            "fading_friction",
            "dissipative",
            site.name,
            (ParameterSpec("Fz", site.per(v), low=0.0),),
            "A friction that fades with speed acts along {site}.",
            terms=((v, f"- {{Fz}}*{v}*exp(-({v}/0.2)**2)"),),
        )

    try:
        assert register_mechanism(fading) is fading and FAMILIES.count(fading) == 1
        item = recording(lambda q, v, t: -9.0 * v * np.exp(-((v / 0.2) ** 2)))
        label, values = best_single(item)
    finally:
        FAMILIES.remove(fading)
    assert label == "fading_friction@equation:v"
    assert values["Fz"] == pytest.approx(9.0, rel=0.1)
