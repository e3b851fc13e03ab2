"""Plants with a memory or a delay, simulated by SciPy: what the tests of those have to find."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from diagnosis_systems import on_an_axis
from scipy.integrate import solve_ivp

from jaxsr.diagnosis.judging.criteria import independent_residuals
from jaxsr.diagnosis.judging.detection import detect_in_noise
from jaxsr.diagnosis.judging.plausible import plausible
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.dissipative import dissipative
from jaxsr.diagnosis.mechanisms.memory import memory_candidates
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.mechanisms.timing import timing_candidates
from jaxsr.diagnosis.setup import state_scale
from jaxsr.diagnosis.shooting.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.integration import choose_stepping
from jaxsr.models import Simulator, parse_model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

STEP, SAMPLES, NOISE = 0.01, 1500, 0.01
MASS, SPRING, DAMPER = 2.0, 30.0, 2.0
# A mass between a spring, both to be calibrated, and a damper that is known.
GIVEN = parse_model(
    on_an_axis(
        "u - k*q - c*v",
        {
            "M": 'value = 2.2, unit = "kg", bounds = [0.5, 8.0]',
            "k": 'value = 27.0, unit = "N/m", bounds = [0.0, 200.0]',
            "c": f'value = {DAMPER}, unit = "N*s/m"',
        },
        units={"q": "m", "v": "m/s", "u": "N", "y": "m"},
    )
)


@dataclass(frozen=True)
class Plant:
    """What acts beside mass, spring and damper; force and rate see (v, z)."""

    lag: float = 0.0
    delay: float = 0.0
    force: Callable[[float, float], float] = lambda v, z: 0.0
    rate: Callable[[float, float], float] = lambda v, z: 0.0
    before: float = 0.0  # seconds in motion before the recording begins

    def record(self, seed: int, noise: float = NOISE) -> Recording:
        """Drive the plant by a multisine and read its position; noise relative to the rms."""
        rng = np.random.default_rng(seed)
        time = np.arange(SAMPLES) * STEP
        rates = np.array([1.7, 2.9, 4.3, 6.1, 9.2, 13.7])
        phases = rng.uniform(0, 2 * np.pi, rates.size)
        past = np.arange(round(-self.before / STEP), 0) * STEP
        grid = np.concatenate([past, time])
        wave = (6.0 * np.sin(rates * grid[:, None] + phases)).sum(1)
        u = wave[past.size :]

        def field(t: float, x: np.ndarray) -> list[float]:
            q, v, z, uf = x
            drive = np.interp(t, grid, wave)
            acting = uf if self.lag else drive
            follow = (drive - uf) / self.lag if self.lag else 0.0
            push = acting - SPRING * q - DAMPER * v + self.force(v, z)
            return [v, push / MASS, self.rate(v, z), follow]

        run = solve_ivp(
            field,
            (grid[0], grid[-1]),
            [0.0, 0.0, 0.0, wave[0]],
            rtol=1e-7,
            atol=1e-9,
            max_step=STEP,
            dense_output=True,
        )
        assert run.sol is not None
        y = run.sol(np.maximum(time - self.delay, grid[0]))[0]
        y = y + noise * np.std(y) * rng.standard_normal(SAMPLES)
        return Recording("plant.csv", time, {"u": u, "y": y})


PLANTS = {
    "nothing": Plant(),
    "actuator_lag": Plant(lag=0.06),
    "sensor_delay": Plant(delay=0.043),
    "viscous_damping": Plant(force=lambda v, z: -0.8 * v),
    "coulomb_friction": Plant(force=lambda v, z: -1.5 * np.tanh(v / 1e-3)),
    "hysteresis": Plant(
        force=lambda v, z: -20.0 * z, rate=lambda v, z: v - 6.0 * abs(v) * z - 3.0 * v * abs(z)
    ),
}


def candidates_of(prepared: Prepared, names: tuple[str, ...]) -> list[Candidate]:
    """Candidates of the given mechanisms."""
    scale = state_scale(GIVEN, [prepared])
    duration = float(prepared.time[-1])
    found = [*(c for site in sites_of(GIVEN, scale) for c in dissipative(site))]
    found += memory_candidates(GIVEN, scale, STEP) + timing_candidates(GIVEN, STEP, duration)
    return [c for c in found if c.mechanism in names]


def arena_of(recording: Recording, names: tuple[str, ...], horizon: float = 1.5) -> Arena:
    """Lay out the arena of some mechanisms."""
    prepared = (Prepared.build(GIVEN, recording),)
    super_model = SuperModel.build(GIVEN, candidates_of(prepared[0], names))
    simulator = Simulator(super_model.model)
    stepping = choose_stepping(simulator, prepared, neutral_values(super_model))
    scale = np.array([0.01 * np.std(recording.channels["y"])])
    return build_arena(super_model, prepared, stepping, horizon, scale, simulator)


def alone(arena: Arena) -> dict[str, Entry]:
    """Enter re-calibration and every candidate alone."""
    start = neutral_values(arena.super_model)
    null = enter(arena, (), start)
    found = {"nothing": null}
    for i, candidate in enumerate(arena.super_model.candidates):
        entry = enter(arena, (i,), null.fit.theta)
        if plausible(arena, entry):
            best = found.get(candidate.mechanism)
            if best is None or entry.fit.cost < best.fit.cost:
                found[candidate.mechanism] = entry
    return found


def winner(arena: Arena, entries: dict[str, Entry]) -> str:
    """Return what has the least Schwarz criterion, where it stands out from noise."""
    n = independent_residuals(min(entries.values(), key=lambda e: e.fit.cost))
    name = min(
        entries, key=lambda k: n * np.log(entries[k].fit.cost) + entries[k].constants * np.log(n)
    )
    count = len(arena.super_model.candidates)
    told = detect_in_noise(entries["nothing"], entries[name], count).detected
    return name if told else "nothing"
