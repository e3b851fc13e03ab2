"""The generality benchmark's truth: closed forms, energy, and the model files that describe it."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.generality.law import Motion, Scene
from benchmarks.generality.laws import LAWS
from benchmarks.generality.plant import LEAD, Effect, Plant, Signal, excited, instants_of, readings
from benchmarks.generality.sensing import SENSING, Channel, sampled
from benchmarks.generality.system import System
from benchmarks.generality.systems import GROUPS, SYSTEMS
from jaxsr.models import Simulator, parse_model
from jaxsr.models.simulation import simulate_to_csv
from jaxsr.recordings import Recording

FIRST = [module.SYSTEMS[0].name for module in GROUPS]
OTHERS = [name for name in SYSTEMS if name not in FIRST]


def silent(system: System, samples: int, dt: float) -> Signal:
    time = dt * np.arange(-LEAD, samples)
    return Signal(time, np.zeros((len(system.drives), time.size)), "linear", 0)


def values_of(name: str, seed: int = 3) -> dict[str, float]:
    return SYSTEMS[name].drawn(np.random.default_rng(seed))


def simulator_of(system: System, values: dict[str, float], more: str = "") -> Simulator:
    outputs = {f"y{k + 1}": g.expression for k, g in enumerate(system.gauges)}
    return Simulator(parse_model(system.model_text(values, {}, outputs) + more, "given.toml"))


def rates_of(name: str, values: dict[str, float], x: np.ndarray) -> np.ndarray:
    system = SYSTEMS[name]
    u = np.zeros((len(system.drives), x.shape[1]))
    return np.array(system.motion(x, u, values, np.zeros((len(system.axes), x.shape[1]))))


# -- two writings of one motion --------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("name", SYSTEMS)
def test_model_file_and_motion_have_the_same_rates(name: str) -> None:
    system, rng = SYSTEMS[name], np.random.default_rng(1)
    values = system.drawn(rng)
    simulator = simulator_of(system, values)
    size = 0.03 if system.group == "tanks" else 0.3
    x = system.at_start()[:, None] + size * rng.normal(size=(len(system.states), 7))
    u = np.array([d.offset + d.amplitude * rng.normal(size=7) for d in system.drives.values()])
    mine = np.array(system.motion(x, u, values, np.zeros((len(system.axes), 7))))
    with jax.enable_x64(True):
        p = tuple(simulator.model.parameters[n].value for n in simulator.model.parameters)
        theirs = np.array([r + np.zeros(7) for r in simulator.rates(0.0, tuple(x), tuple(u), p)])
    np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())


def agree_in_free_run(name: str) -> None:
    system = SYSTEMS[name]
    values, rng = values_of(name), np.random.default_rng(5)
    time = sampled(rng, "white", system.dt, 60, LEAD)
    signal = excited(rng, system.drives, time, system.hold, 0)
    track, y = readings(Plant(system, values), signal, system.gauges, time[LEAD:])
    start = "\n[initial]\n" + "".join(
        f"{s} = {float(v)!r}\n" for s, v in zip(system.states, track.x[:, 0], strict=True)
    )
    columns = {u: row[LEAD:] for u, row in zip(system.drives, signal.values, strict=True)}
    columns |= {f"y{k + 1}": row for k, row in enumerate(y)}
    recording = Recording("truth.csv", time[LEAD:], columns)
    table = simulate_to_csv(simulator_of(system, values, start), recording)
    for k, row in enumerate(y):
        assert np.abs(table[f"y{k + 1}"].to_numpy() - row).max() < 1e-6 * np.ptp(row), name


@pytest.mark.parametrize("name", ["dc_motor", "crank_slider"])
def test_given_model_runs_freely_along_the_truth(name: str) -> None:
    agree_in_free_run(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", SYSTEMS)
def test_every_given_model_runs_freely_along_the_truth(name: str) -> None:
    agree_in_free_run(name)


# -- closed forms and energy -----------------------------------------------------------------------


def test_modes_of_a_chain_are_those_of_its_closed_form() -> None:
    system, count = SYSTEMS["five_masses"], 5
    values = {"k": 500.0, "d": 0.0, "m": 0.8}
    mode = 2
    shape = np.sin(mode * np.pi * np.arange(1, count + 1) / (count + 1))
    frequency = 2.0 * np.sqrt(500.0 / 0.8) * np.sin(mode * np.pi / (2 * (count + 1)))
    start = {f"x{i + 1}": float(s) for i, s in enumerate(shape)}
    signal = silent(system, 100, 0.01)
    track = Plant(replace(system, start=start), values).moved(signal, signal.time)
    wanted = np.outer(shape, np.cos(frequency * (signal.time - signal.time[0])))
    assert np.abs(track.x[:count] - wanted).max() < 1e-6


def test_motor_settles_as_its_closed_form_says() -> None:
    values = {"K": 0.05, "b": 1e-4, "J": 2e-4, "R": 1.2, "L": 5e-3}
    system = SYSTEMS["dc_motor"]
    time = 0.005 * np.arange(-LEAD, 400)
    signal = Signal(time, np.full((1, time.size), 6.0), "linear", 0)
    x = Plant(system, values).moved(signal, time).x[:, -1]
    speed = 0.05 * 6.0 / (1.2 * 1e-4 + 0.05**2)
    np.testing.assert_allclose(x, [speed, 1e-4 * speed / 0.05], rtol=1e-6)


def kinetic_of_crank(p: dict[str, float], x: np.ndarray) -> np.ndarray:
    def slider(angle: np.ndarray) -> np.ndarray:
        return p["r"] * np.cos(angle) + np.sqrt(p["l"] ** 2 - (p["r"] * np.sin(angle)) ** 2)

    slope = (slider(x[0] + 1e-5) - slider(x[0] - 1e-5)) / 2e-5
    return 0.5 * (p["J"] + p["m"] * slope**2) * x[1] ** 2


def kinetic_of_four_bar(p: dict[str, float], x: np.ndarray) -> np.ndarray:
    def rocker(angle: np.ndarray) -> np.ndarray:
        pin = p["a"] * np.exp(1j * angle)
        # law of cosines at the rocker's pivot, the rocker above the ground
        far = np.abs(pin - p["g"])
        inner = np.arccos((far**2 + p["c"] ** 2 - p["b"] ** 2) / (2.0 * far * p["c"]))
        return np.angle((pin - p["g"]) * np.exp(-1j * inner))

    slope = (rocker(x[0] + 1e-5) - rocker(x[0] - 1e-5)) / 2e-5
    return 0.5 * (p["J"] + p["Jr"] * slope**2) * x[1] ** 2


def energy_of_arm(lengths: tuple[str, ...], gravity: float) -> Any:
    def energy(p: dict[str, float], x: np.ndarray) -> np.ndarray:
        n = len(x) // 2
        angle, rate = np.cumsum(x[:n], axis=0), np.cumsum(x[n:], axis=0)
        total = 0.0
        for link in range(n):
            steps = [*(p[k] for k in lengths[:link]), p[f"c{link + 1}"]]
            turned = [s * np.exp(1j * angle[k]) for k, s in enumerate(steps)]
            speed = sum(1j * rate[k] * t for k, t in enumerate(turned))
            total = total + 0.5 * p[f"m{link + 1}"] * np.abs(speed) ** 2
            total = total + 0.5 * p[f"I{link + 1}"] * rate[link] ** 2
            total = total + p[f"m{link + 1}"] * gravity * np.imag(sum(turned))
        spring = p.get("ks", 0.0)
        return total + 0.5 * spring * np.sum(x[:n] ** 2, axis=0)

    return energy


def energy_of_double_pendulum(p: dict[str, float], x: np.ndarray) -> np.ndarray:
    upper, lower = p["l1"] * np.exp(1j * x[0]), p["l2"] * np.exp(1j * x[1])
    first, second = 1j * x[2] * upper, 1j * x[2] * upper + 1j * x[3] * lower
    kinetic = 0.5 * p["m1"] * np.abs(first) ** 2 + 0.5 * p["m2"] * np.abs(second) ** 2
    height = -p["m1"] * upper.real - p["m2"] * (upper + lower).real
    return kinetic + 9.81 * height


def energy_of_cart(p: dict[str, float], x: np.ndarray) -> np.ndarray:
    load = x[2] + p["l"] * x[3] * np.exp(1j * x[1])
    kinetic = 0.5 * p["M"] * x[2] ** 2 + 0.5 * p["m"] * np.abs(load) ** 2
    return kinetic - p["m"] * 9.81 * p["l"] * np.cos(x[1]) + 0.5 * p["kc"] * x[0] ** 2


def energy_of_furuta(p: dict[str, float], x: np.ndarray) -> np.ndarray:
    turn, tilt, turning, tilting = x
    away = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn])
    along = np.stack([-np.sin(turn), np.cos(turn), 0.0 * turn])
    up = np.stack([0.0 * turn, 0.0 * turn, 1.0 + 0.0 * turn])
    speed = turning * p["r"] * along + p["lp"] * (
        np.cos(tilt) * tilting * along - np.sin(tilt) * turning * away + np.sin(tilt) * tilting * up
    )
    kinetic = 0.5 * p["Ja"] * turning**2 + 0.5 * p["Jp"] * tilting**2
    kinetic = kinetic + 0.5 * p["mp"] * np.sum(speed**2, axis=0)
    return kinetic - p["mp"] * 9.81 * p["lp"] * np.cos(tilt)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "lossless", "start", "energy"),
    [
        ("crank_slider", ("b",), [0.3, 4.0], kinetic_of_crank),
        ("four_bar", ("d",), [1.0, 5.0], kinetic_of_four_bar),
        ("two_joints", ("d1", "d2"), [-1.0, 0.5, 0.0, 0.0], energy_of_arm(("l1",), 9.81)),
        (
            "scara_springs",
            ("d1", "d2", "d3"),
            [0.5, -0.4, 0.8, 1.0, -1.0, 2.0],
            energy_of_arm(("l1", "l2"), 0.0),
        ),
        ("driven_double_pendulum", ("b1", "b2"), [1.2, -0.7, 0.0, 1.0], energy_of_double_pendulum),
        ("cart_pendulum", ("c", "b"), [0.1, 0.9, 0.0, 0.0], energy_of_cart),
        ("rotary_pendulum", ("ba", "bp"), [0.0, 1.1, 2.0, 0.0], energy_of_furuta),
    ],
)
def test_energy_is_kept_without_losses(
    name: str, lossless: tuple[str, ...], start: list[float], energy: Any
) -> None:
    system = SYSTEMS[name]
    values = values_of(name) | dict.fromkeys(lossless, 0.0)
    begun = replace(system, start=dict(zip(system.states, start, strict=True)))
    signal = silent(system, 60, 0.01)
    x = Plant(begun, values).moved(signal, signal.time).x
    found = energy(values, x)
    moving = np.abs(found).max() + 1e-12
    # the motion exchanges energy, so that keeping it is no triviality
    assert np.ptp(x[len(start) // 2 :]) > 0.1
    assert np.ptp(found) < 1e-6 * moving


# -- laws at their places --------------------------------------------------------------------------


def test_added_mass_is_a_larger_mass() -> None:
    system, values = SYSTEMS["dc_motor"], values_of("dc_motor")
    signal = excited(np.random.default_rng(0), system.drives, 0.005 * np.arange(-LEAD, 60),
                     "linear", 0)  # fmt: skip
    effect = Effect(LAWS["added_mass"], (0,), {"ma": 5e-5})
    one = Plant(system, values, effect).moved(signal, signal.time)
    other = Plant(system, values | {"J": values["J"] + 5e-5}).moved(signal, signal.time)
    np.testing.assert_allclose(one.x, other.x, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(one.dx, other.dx, rtol=1e-6, atol=1e-6)


def test_late_inputs_and_sensors_are_those_of_an_earlier_time() -> None:
    system, values = SYSTEMS["dc_motor"], values_of("dc_motor")
    time = 0.005 * np.arange(-LEAD, 60)
    signal = excited(np.random.default_rng(0), system.drives, time, "linear", 0)
    late = Effect(LAWS["sensor_delay"], (0,), {"tau": 0.01})
    _, read = readings(Plant(system, values, late), signal, system.gauges, time[LEAD:])
    _, exact = readings(Plant(system, values), signal, system.gauges, time[LEAD:])
    np.testing.assert_allclose(read[0, 2:], exact[0, :-2], rtol=1e-7)
    np.testing.assert_allclose(read[1], exact[1], rtol=1e-7)
    moved = Plant(system, values, Effect(LAWS["input_delay"], (0,), {"tau": 0.01}))
    held = replace(signal, values=np.concatenate(
        [signal.values[:, :1], signal.values[:, :1], signal.values[:, :-2]], axis=1))  # fmt: skip
    track = moved.moved(signal, time)
    np.testing.assert_allclose(track.x, Plant(system, values).moved(held, time).x, atol=1e-6)
    skewed = Effect(LAWS["clock_skew"], (1,), {"s": 0.01})
    np.testing.assert_allclose(instants_of(skewed, time, 1), 1.01 * time)
    np.testing.assert_allclose(instants_of(skewed, time, 0), time)


def test_a_lag_follows_a_step_exponentially() -> None:
    system, values = SYSTEMS["dc_motor"], values_of("dc_motor")
    time = 0.005 * np.arange(-LEAD, 60)
    u = np.where(time < -1e-9, 0.0, 1.0)[None]
    plant = Plant(system, values, Effect(LAWS["actuator_lag"], (0,), {"tau": 0.02}))
    lagged = plant.moved(Signal(time, u, "zero", 0), time).x[-1]
    inside = time >= 0.0
    np.testing.assert_allclose(lagged[inside], 1.0 - np.exp(-time[inside] / 0.02), atol=1e-7)


def test_a_pair_acts_with_equal_and_opposite_forces() -> None:
    system, values = SYSTEMS["five_masses"], {"k": 500.0, "d": 0.0, "m": 0.8}
    plant = Plant(system, values, Effect(LAWS["coupling_stiffness"], (0, 4), {"kc": 40.0}))
    x = np.random.default_rng(2).normal(size=(10, 3))
    change = plant.rates(0.0, x, np.zeros((1, 3))) - Plant(system, values).rates(
        0.0, x, np.zeros((1, 3))
    )
    np.testing.assert_allclose(change[5], -40.0 * (x[0] - x[4]) / 0.8)
    np.testing.assert_allclose(change[9], -change[5])


def scene_for(rng: np.random.Generator) -> Scene:
    """Two sines in each of two recordings: coordinate, speed, input and reading."""
    one = 0.01 * np.arange(300)
    t, run = np.tile(one, 2), np.repeat([0, 1], 300)
    a, b = rng.uniform(3.0, 9.0, 2)
    q = 0.8 * np.sin(a * t + run) + 0.3 * np.sin(b * t)
    v = 0.8 * a * np.cos(a * t + run) + 0.3 * b * np.cos(b * t)
    return Scene(t, run, q=q, v=v, u=2.0 * q, y=q, net=3.0, dt=0.01, duration=2.99)


@pytest.mark.long
@pytest.mark.parametrize("mechanism", LAWS)
def test_laws_are_drawn_to_a_size(mechanism: str) -> None:
    law, rng = LAWS[mechanism], np.random.default_rng(8)
    scene = scene_for(rng)
    constants = law.sized(scene, law.draw(rng, scene), 0.1)
    assert law.size(scene, constants) == pytest.approx(0.1, rel=0.02)


@pytest.mark.parametrize(
    "mechanism",
    ["coulomb_friction", "stribeck_friction", "viscous_damping", "quadratic_drag",
     "power_law_drag", "hysteresis"],
)  # fmt: skip
def test_losses_take_energy_out(mechanism: str) -> None:
    law, rng = LAWS[mechanism], np.random.default_rng(9)
    scene = scene_for(rng)
    constants = law.sized(scene, law.draw(rng, scene), 0.2)
    motion = replace(scene.motion(), z=law.followed(scene, constants))
    power = law.act(motion, constants) * scene.v
    assert power.mean() < 0.0
    if mechanism != "hysteresis":  # which stores some
        assert power.max() <= 1e-12


def test_a_push_acts_in_one_recording() -> None:
    constants = {"A": 2.0, "begin": 1.0, "length": 0.5, "run": 1.0}
    t = 0.01 * np.arange(300)
    act = LAWS["transient_force"].act
    assert not np.any(act(Motion(t, 0.0, 0.0, run=0), constants))
    push = act(Motion(t, 0.0, 0.0, run=1), constants)
    assert push.max() == pytest.approx(2.0)
    assert t[push > 0.0].min() > 1.0 and t[push > 0.0].max() < 1.5


# -- sensing ---------------------------------------------------------------------------------------


def test_noise_has_its_deviation_and_correlation() -> None:
    rng = np.random.default_rng(0)
    read = Channel(0.5, rho=0.7).read(rng, np.zeros(40_000))
    assert read.std() == pytest.approx(0.5, rel=0.03)
    assert np.corrcoef(read[1:], read[:-1])[0, 1] == pytest.approx(0.7, abs=0.03)


def test_sensors_lose_skip_and_step() -> None:
    rng = np.random.default_rng(0)
    y = np.linspace(0.0, 1.0, 4000)
    lost = Channel(0.0, lost=0.2).read(rng, y)
    assert np.isnan(lost).mean() == pytest.approx(0.2, abs=0.03)
    slow = Channel(0.0, every=4).read(rng, y)
    assert np.array_equal(np.isfinite(slow), np.arange(4000) % 4 == 0)
    stepped = Channel(0.0, step=0.01).read(rng, y)
    assert np.abs(stepped - y).max() <= 0.005 + 1e-12
    gap = np.isnan(Channel(0.0, pause=25).read(rng, y))
    assert gap.sum() == 25 and np.ptp(np.flatnonzero(gap)) == 24


@pytest.mark.parametrize("kind", SENSING)
def test_instants_rise(kind: str) -> None:
    time = sampled(np.random.default_rng(4), kind, 0.01, 200, LEAD)
    assert np.all(np.diff(time) > 0.0) and time[LEAD] == 0.0
    assert np.ptp(np.diff(time)) < 1e-8 or kind == "jitter"
