"""The planted cases' truth: closed forms, energy, MuJoCo, and the model files that describe it."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from scipy.integrate import trapezoid

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.concealed.casefile import Disguise, model_text
from benchmarks.concealed.effects import FAMILIES, FAMILY, Look
from benchmarks.concealed.excitation import design
from benchmarks.concealed.fitting import Whitener
from benchmarks.concealed.plan import SYSTEMS, rows_for
from benchmarks.concealed.planting import BUILDERS, _undisturbed, scene_of
from benchmarks.concealed.recording import perform
from benchmarks.concealed.sensing import Sensor, at, noise
from benchmarks.concealed.sensing_effects import sensing
from benchmarks.concealed.sizes import sized, strength
from benchmarks.concealed.systems import solve, total_force
from benchmarks.concealed.truth import Exact, Tape, World, replay
from jaxsr.models import Simulator, read_model

ONE, NO = np.zeros(1, int), np.zeros(1, int)


def silent(system: str, dt: float = 0.01, samples: int = 400) -> Tape:
    u = np.zeros((len(SYSTEMS[system].drives), samples, 1))
    return Tape(u, dt, "linear", ONE, NO)


def run(world: World, tape: Tape, x0: np.ndarray, samples: int) -> np.ndarray:
    exact = Exact(world, tape, x0)
    out = [exact.x]
    for _ in range(samples - 1):
        exact.advance()
        out.append(exact.x)
    return np.stack(out, axis=1)


def test_oscillator_follows_its_closed_form() -> None:
    m, c, k, dt = 1.3, 0.9, 70.0, 0.01
    world = World.of(SYSTEMS["oscillator"], {"m1": m, "c1": c, "k1": k})
    x = run(world, silent("oscillator"), np.array([[0.1], [0.0]]), 300)[0, :, 0]
    t, decay = dt * np.arange(300), c / (2 * m)
    w = np.sqrt(k / m - decay**2)
    wanted = 0.1 * np.exp(-decay * t) * (np.cos(w * t) + decay / w * np.sin(w * t))
    assert np.abs(x - wanted).max() < 1e-9


@pytest.mark.slow
def test_a_truth_that_is_too_stiff_is_given_up() -> None:
    world = World.of(SYSTEMS["oscillator"], {"m1": 1.0, "c1": 1e9, "k1": 70.0})
    with pytest.raises(FloatingPointError, match="too stiff at sample 0"):
        run(world, silent("oscillator"), np.array([[0.1], [0.0]]), 3)


@pytest.mark.parametrize("hold", ["zero", "linear"])
def test_cart_follows_its_closed_form_under_a_held_ramp(hold: str) -> None:
    m, c, dt, n = 3.0, 7.0, 0.02, 50
    t = dt * np.arange(n)
    u = np.repeat(t[None, :, None], 1, axis=0)
    world = World.of(SYSTEMS["rail_cart"], {"m1": m, "c1": c})
    v = run(world, Tape(u, dt, hold, ONE, NO), np.zeros((2, 1)), n)[1, :, 0]
    if hold == "linear":
        wanted = t / c - m / c**2 * (1 - np.exp(-c * t / m))
    else:
        wanted, decay = np.zeros(n), np.exp(-c * dt / m)
        for k in range(n - 1):
            wanted[k + 1] = decay * wanted[k] + (1 - decay) * u[0, k, 0] / c
    assert np.abs(v - wanted).max() < 1e-9


def test_double_pendulum_keeps_its_energy() -> None:
    system = SYSTEMS["double_pendulum"]
    p = system.draw(np.random.default_rng(0)) | {"c1": 0.0, "c2": 0.0}
    x = run(World.of(system, p), silent(system.name), np.array([[1.0], [-0.5], [0.0], [0.3]]), 300)
    q, v = x[:2, :, 0], x[2:, :, 0]
    kinetic = 0.5 * p["j1"] * v[0] ** 2 + 0.5 * p["j2"] * v[1] ** 2
    kinetic += p["b1"] * np.cos(q[0] - q[1]) * v[0] * v[1]
    energy = kinetic - p["g1"] * np.cos(q[0]) - p["g2"] * np.cos(q[1])
    assert np.ptp(energy) < 1e-7 * np.abs(energy).max()


def test_friction_takes_the_energy_that_is_lost() -> None:
    system, p = SYSTEMS["pendulum"], {"j1": 0.1, "c1": 0.05, "g1": 2.0}
    scene, _ = a_scene("pendulum")
    friction = BUILDERS["dissipative"](
        np.random.default_rng(0), scene, "coulomb_friction", 0
    ).with_values({"Fc": 0.08})
    dt = 0.002
    x = run(
        World.of(system, p, (friction,)), silent(system.name, dt, 900), np.array([[1.2], [0]]), 900
    )
    q, v = x[:, :, 0]
    energy = 0.5 * p["j1"] * v**2 - p["g1"] * np.cos(q)
    width = 0.01 * scene.v_rms(0)
    power = 0.08 * np.tanh(v / width) * v + p["c1"] * v**2
    assert energy[0] - energy[-1] == pytest.approx(trapezoid(power, dx=dt), rel=1e-4)


def test_replay_converges_to_the_truth_with_fourth_order() -> None:
    system = SYSTEMS["two_mass"]
    p = system.draw(np.random.default_rng(1))
    u = np.random.default_rng(2).normal(size=(1, 60, 1))
    tape = Tape(u, 0.05, "linear", ONE, NO)
    x0 = np.array([[0.1], [0.0], [0.0], [0.2]])
    exact = run(World.of(system, p), tape, x0, 60)
    errors = [
        np.abs(replay(World.of(system, p), tape, x0, 60, n)[0] - exact).max() for n in (1, 2, 4)
    ]
    assert 12 < errors[0] / errors[1] < 22 and 12 < errors[1] / errors[2] < 22


@pytest.mark.parametrize("name", ["crane", "arm"])
def test_mujoco_and_the_closed_form_agree(name: str) -> None:
    pytest.importorskip("mujoco")
    from benchmarks.concealed.bodies import MuJoCoPlant

    system, rng = SYSTEMS[name], np.random.default_rng(3)
    for _ in range(5):
        p = system.draw(rng)
        q, v, force = (rng.normal(size=(2, 4)) for _ in range(3))
        mass = system.mass(q, p)
        mass[1][1] = mass[1][1] + 0.2
        assert system.bias is not None
        wanted = solve(mass, force + system.bias(q, v, p))
        found = MuJoCoPlant(name, p).accelerations(q, v, force, [0.0, 0.2])
        assert np.abs(found - wanted).max() < 1e-6 * np.abs(wanted).max()


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_model_file_says_what_the_truth_does(name: str, tmp_path: Path) -> None:
    system, rng = SYSTEMS[name], np.random.default_rng(4)
    p = system.draw(rng)
    sensors = tuple(
        Sensor(c, rate, system.rate_dims(c) if rate else system.coordinates[c], gain)
        for c, rate, gain in ((0, False, -3.0), (system.size - 1, system.order == 2, 0.2))
    )
    disguise = replace(Disguise.draw(rng, system, len(sensors)), told=True)
    path = tmp_path / "model.toml"
    path.write_text(model_text(system, disguise, sensors, p, {}, "linear", "case"))
    simulator = Simulator(read_model(path))
    n, units = system.size, disguise.units
    x = rng.uniform(0.1, 0.5, (n * system.order, 1))
    u = rng.normal(size=(len(system.drives), 1))
    dims = [*system.coordinates, *(system.rate_dims(i) for i in range(n))][: x.shape[0]]
    tape = Tape(u[:, None], 1.0, "zero", ONE, NO)
    wanted = World.of(system, p).rates(0.0, x, tape, np.zeros(1), ONE)[:, 0]
    with jax.enable_x64(True):
        states = tuple(units.number(a, d) for a, d in zip(x[:, 0], dims, strict=True))
        inputs = tuple(a * s for a, s in zip(u[:, 0], disguise.scales, strict=True))
        found = simulator.rates(0.0, states, inputs, simulator.values())
        read = simulator.readings(0.0, states, inputs, simulator.values())
    numbers = [units.number(a, d) for a, d in zip(wanted, dims, strict=True)]
    assert np.allclose(np.array(found, float), numbers, rtol=1e-9)
    truth = [s.gain * x[s.row(system), 0] for s in sensors]
    assert np.allclose(np.array(read, float), truth, rtol=1e-9)


@pytest.mark.parametrize("name", SYSTEMS)
def test_mass_matrices_are_positive(name: str) -> None:
    system, rng = SYSTEMS[name], np.random.default_rng(5)
    for _ in range(20):
        p, q = system.draw(rng), rng.normal(size=(system.size, 6))
        zero = np.zeros(6)
        mass = np.array([[m + zero for m in row] for row in system.mass(q, p)])
        assert np.allclose(mass, np.swapaxes(mass, 0, 1))
        assert np.linalg.eigvalsh(np.moveaxis(mass, 2, 0)).min() > 0


def test_rest_is_rest() -> None:
    for system in SYSTEMS.values():
        p = system.draw(np.random.default_rng(6))
        q, u = system.at_rest(p)
        force = total_force(system, q[:, None], 0 * q[:, None], u[:, None], p)
        assert np.abs(force).max() < 1e-12


_SCENES: dict = {}


def a_scene(name: str) -> tuple:
    if name not in _SCENES:
        system, rng = SYSTEMS[name], np.random.default_rng(7)
        p = system.draw(rng)
        made = design(rng, system, p, False, tiny=True)
        nominal = _undisturbed(system, p, made, (), made.start(rng, system))
        _SCENES[name] = scene_of(system, p, made, nominal)
    return _SCENES[name]


PLANTABLE = [m for m in FAMILY if FAMILY[m] != "measurement"]


@pytest.mark.long
@pytest.mark.parametrize("mechanism", PLANTABLE)
def test_an_effect_gets_the_size_it_is_given(mechanism: str) -> None:
    names = ("two_mass", "three_mass", "pendulum", "tanks")
    name = next(n for n in names if rows_for(SYSTEMS[n], mechanism))
    scene, shape = a_scene(name)
    row = rows_for(SYSTEMS[name], mechanism)[0]
    build = BUILDERS[FAMILY[mechanism]]
    for target in (0.01, 0.1):
        effect = sized(
            build(np.random.default_rng(8), scene, mechanism, row), scene, target, None, shape
        )
        assert strength(effect, scene, None, shape) == pytest.approx(target, rel=0.02)


@pytest.mark.parametrize("mechanism", FAMILIES["measurement"])
def test_a_sensor_gets_the_error_it_is_given(mechanism: str) -> None:
    scene, shape = a_scene("two_mass")
    clean = scene.q[1].reshape(shape)
    for seed, target in ((0, 0.02), (1, 0.09)):
        rng = np.random.default_rng(seed)
        effect = sensing(rng, mechanism, 0, (0, 1, 0), clean, scene.omega)
        effect = sized(effect, scene, target, clean, shape)
        assert strength(effect, scene, clean, shape) == pytest.approx(target, rel=0.03)
        if mechanism == "sensor_gain":
            assert abs(effect.values["g"] - 1.0) == pytest.approx(target, rel=0.2)


@pytest.mark.parametrize(
    "mechanism", [m for m in FAMILIES["dissipative"] if m != "asymmetric_friction"]
)
def test_friction_never_pushes(mechanism: str) -> None:
    scene, _ = a_scene("two_mass")
    effect = BUILDERS["dissipative"](np.random.default_rng(9), scene, mechanism, 1)
    assert effect.force is not None
    look = Look(scene.t, scene.q, scene.v, scene.u, np.zeros((0, 1)), scene.p, 0)
    power = (effect.force(look, effect.values) * scene.v).sum(0)
    assert power.max() <= 0 and power.min() < 0


def test_hysteresis_loses_energy_over_a_cycle_and_stays_bounded() -> None:
    scene, _ = a_scene("oscillator")
    effect = BUILDERS["memory"](np.random.default_rng(10), scene, "hysteresis", 0)
    e, dt = effect.values, 1e-3
    t = np.arange(0, 20, dt)
    q, v = np.sin(t) * scene.q_max(0), np.cos(t) * scene.q_max(0)
    z, seen = 0.0, []
    assert effect.rates is not None
    for k in range(t.size):
        look = Look(t[k], q[k : k + 1, None], v[k : k + 1, None], 0, np.array([[z]]), scene.p, 0)
        z += dt * float(effect.rates(look, e)[0, 0])
        seen.append(z)
    cycle = slice(-round(2 * np.pi / dt), None)
    assert trapezoid(np.array(seen)[cycle] * v[cycle], dx=dt) > 0
    assert np.abs(seen).max() <= 1.02 * e["a"] / (e["b"] + e["g"])


def test_a_delayed_input_is_read_late() -> None:
    t = 0.1 * np.arange(100)
    tape = Tape(np.sin(t)[None, :, None], 0.1, "linear", ONE, NO)
    late = tape.inputs(np.array([50.5]), [(0, 0.25)])
    assert late[0, 0] == pytest.approx(np.interp(5.05 - 0.25, t, np.sin(t)), abs=1e-9)


def test_readings_between_samples() -> None:
    t = 0.1 * np.arange(50)
    place = np.array([[10.3], [20.7]])
    found = at(np.sin(t)[:, None], np.cos(t)[:, None], place, 0.1)
    assert np.abs(found - np.sin(0.1 * place)).max() < 1e-6


@pytest.mark.parametrize(("rho", "step"), [(0.0, 0.0), (0.8, 0.0), (0.8, 2.0), (0.0, 3.0)])
def test_whitened_noise_is_white_and_of_unit_variance(rho: float, step: float) -> None:
    rng = np.random.default_rng(11)
    sensor = Sensor(0, False, (0, 0, 0), 1.0, 1.0, rho, step, 0.0)
    y = noise(rng, sensor, (40000, 1))
    assert y.std() == pytest.approx(1.0, rel=0.05)
    y = y + rng.uniform(-step / 2, step / 2, y.shape)
    e = Whitener.of(sensor, 0.0)(y)[100:, 0]
    assert e.var() == pytest.approx(1.0, rel=0.04)
    for lag in (1, 2, 5):
        assert abs(np.mean(e[lag:] * e[:-lag])) < 0.03


def test_a_closed_loop_follows_its_reference_and_feeds_noise_back() -> None:
    from benchmarks.concealed.control import tuned

    system, rng = SYSTEMS["rail_cart"], np.random.default_rng(12)
    p = system.draw(rng)
    made = design(rng, system, p, True, tiny=True)
    gains, x0 = tuned(rng, system, p, made), made.start(rng, system)
    quiet = (Sensor(0, False, (0, 1, 0), 1.0),)
    loud = (replace(quiet[0], sigma=0.01),)
    world = World.of(system, p)
    calm = perform(np.random.default_rng(0), world, made, quiet, gains, x0)
    rough = perform(np.random.default_rng(0), world, made, loud, gains, x0)
    follows = np.corrcoef(calm.y[0].ravel(), made.signal[0].ravel())[0, 1]
    assert follows > 0.5
    assert np.diff(rough.u[0], axis=0).std() > 2 * np.diff(calm.u[0], axis=0).std()
