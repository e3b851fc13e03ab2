"""Planting an effect in a system: which law, where, how strong, in which experiments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.concealed import forces, memory
from benchmarks.concealed.control import Gains, tuned
from benchmarks.concealed.effects import FAMILY, Effect, Scene
from benchmarks.concealed.excitation import Design, design
from benchmarks.concealed.plan import MENU, SYSTEMS, Ticket, rows_for
from benchmarks.concealed.recording import Recorded, perform
from benchmarks.concealed.sensing import Sensor, choose, fitted_out
from benchmarks.concealed.sensing_effects import sensing
from benchmarks.concealed.sizes import sized, strength
from benchmarks.concealed.systems import Array, System
from benchmarks.concealed.truth import Plant, World

BUILDERS = {
    "parameter": memory.wrong_value,
    "dissipative": forces.dissipative,
    "elastic": forces.elastic,
    "inertial": forces.inertial,
    "coupling": forces.coupling,
    "periodic": forces.periodic,
    "memory": memory.memory,
    "actuator": memory.actuator,
    "external": memory.external,
    "unnamed": forces.unnamed,
}
ATTEMPTS = 8
LEAST_LAG = 0.3
"""Shortest time constant of an actuator, in samples; a shorter one no recording resolves."""


@dataclass(frozen=True, eq=False)
class Planted:
    """A case before it is disguised."""

    ticket: Ticket
    system: System
    p: dict[str, float]
    design: Design
    gains: tuple[Gains, ...]
    sensors: tuple[Sensor, ...]
    effects: tuple[Effect, ...]
    sizes: tuple[float, ...]
    recorded: Recorded
    x0: Array


def plant(rng: np.random.Generator, ticket: Ticket, tiny: bool = False) -> Planted:
    """Draw constants, experiments and sensors, plant the effect and run the experiments.

    Raises
    ------
    FloatingPointError
        No attempt gave a motion that stays finite.
    """
    for attempt in range(ATTEMPTS):
        try:
            with np.errstate(all="ignore"):
                return _attempt(rng, ticket, tiny, 0.7**attempt)
        except FloatingPointError as error:
            last = error
    raise FloatingPointError(f"{ticket.name}: {last}")


def _attempt(rng: np.random.Generator, ticket: Ticket, tiny: bool, caution: float) -> Planted:
    system = SYSTEMS[ticket.system]
    p = system.draw(rng)
    made = design(rng, system, p, ticket.closed, ticket.kind == "collinear", tiny)
    gains = tuned(rng, system, p, made) if ticket.closed else ()
    x0 = made.start(rng, system)
    nominal = _undisturbed(system, p, made, gains, x0)
    scene, shape = scene_of(system, p, made, nominal)
    level = (3e-4, 3e-2) if ticket.kind != "below_noise" else (2e-2, 1e-1)
    complete = ticket.kind in ("sensor", "timing", "nothing")
    which = choose(rng, system, ticket.closed, complete)
    x, dx = nominal.x, nominal.dx
    sensors = fitted_out(rng, system, which, x, dx, made.dt, level)
    planned = _effects(rng, ticket, scene, sensors, x, shape)
    effects, sizes = [], []
    for effect, target in planned:
        clean = None
        if effect.kind == "output":
            clean = x[sensors[effect.index].row(system), :, : made.learning]
        done = sized(effect, scene, target * caution, clean, shape)
        if effect.mechanism == "actuator_lag" and done.values["tau"] < LEAST_LAG * made.dt:
            done = done.with_values({"tau": LEAST_LAG * made.dt})
        effects.append(done)
        sizes.append(strength(done, scene, clean, shape))
    body = _plant(system, p)
    true = World.of(system, p, tuple(effects), body)
    recorded = perform(rng, true, made, sensors, gains, x0)
    return Planted(
        ticket, system, p, made, gains, sensors, tuple(effects), tuple(sizes), recorded, x0
    )


def _plant(system: System, p: Mapping[str, float]) -> Plant | None:
    """Return MuJoCo's plant where it is the truth; imported only then."""
    if system.simulator != "mujoco":
        return None
    from benchmarks.concealed.bodies import MuJoCoPlant

    return MuJoCoPlant(system.name, p)


def _undisturbed(
    system: System, p: dict[str, float], made: Design, gains: tuple[Gains, ...], x0: Array
) -> Recorded:
    """Return the motion without any effect or noise."""
    ideal = tuple(Sensor(c, False, system.coordinates[c], 1.0) for c in range(system.size))
    rng = np.random.default_rng(0)
    return perform(rng, World.of(system, p), made, ideal, gains, x0)


def scene_of(
    system: System, p: dict[str, float], made: Design, nominal: Recorded
) -> tuple[Scene, tuple[int, int]]:
    """Return the undisturbed motion of the experiments to learn from, samples in a row."""
    n, e = system.size, made.learning
    shape = (made.samples, e)

    def flat(a: Array) -> Array:
        return a[:, :, :e].reshape(a.shape[0], -1)

    q = flat(nominal.x[:n])
    second = system.order == 2
    v = flat(nominal.x[n:]) if second else flat(nominal.dx[:n])
    a = flat(nominal.dx[n:]) if second else flat(nominal.dx[:n])
    mass = system.mass(q, p)
    net = np.stack([sum(m * a[j] for j, m in enumerate(row)) + 0.0 * a[0] for row in mass])
    t = np.repeat(made.dt * np.arange(made.samples)[:, None], e, axis=1).ravel()
    u = flat(nominal.u)
    scene = Scene(system, p, t, q, v, a, u, net, made.q0, made.length, e, made.omega)
    return scene, shape


def _effects(
    rng: np.random.Generator,
    ticket: Ticket,
    scene: Scene,
    sensors: tuple[Sensor, ...],
    x: Array,
    shape: tuple[int, int],
) -> list[tuple[Effect, float]]:
    if not ticket.mechanism:
        return []
    if FAMILY[ticket.mechanism] == "measurement":
        number = int(rng.integers(len(sensors)))
        sensor = sensors[number]
        clean = x[sensor.row(scene.system), :, : shape[1]]
        top = 0.1 if ticket.mechanism == "quantisation" else 0.4
        effect = sensing(rng, ticket.mechanism, number, sensor.dims, clean, scene.omega)
        # a coarse step stands out of the sensor's own
        least = (
            3.0 * sensor.sigma / float(clean.std()) if ticket.mechanism == "quantisation" else 0.0
        )
        return [(effect, min(max(ticket.size, least), top))]
    first = BUILDERS[FAMILY[ticket.mechanism]](rng, scene, ticket.mechanism, ticket.row)
    planned = [(first, ticket.size)]
    if ticket.kind == "several":
        others = [
            (m, r)
            for m in MENU["several"]
            if m != ticket.mechanism
            for r in rows_for(scene.system, m)
            if r != ticket.row
        ]
        mechanism, row = others[int(rng.integers(len(others)))]
        second = BUILDERS[FAMILY[mechanism]](rng, scene, mechanism, row)
        size = float(np.exp(rng.uniform(np.log(0.005), np.log(0.4))))
        planned.append((second, size))
    return planned


def fainter(rng: np.random.Generator, planted: Planted, factor: float) -> Planted:
    """Return the case with its effects made smaller, its experiments run again."""
    effects = tuple(f.scaled(factor) for f in planted.effects)
    true = World.of(planted.system, planted.p, effects, _plant(planted.system, planted.p))
    recorded = perform(rng, true, planted.design, planted.sensors, planted.gains, planted.x0)
    sizes = tuple(s * factor for s in planted.sizes)
    return replace(planted, effects=effects, sizes=sizes, recorded=recorded)
