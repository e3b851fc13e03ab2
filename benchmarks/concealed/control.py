"""Controllers that make the input from the measured output."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.concealed.excitation import Design
from benchmarks.concealed.systems import Array, System


@dataclass(frozen=True)
class Gains:
    """Gains of a PID controller on one coordinate, in SI.

        u = u0 + kp (r - y) + ki * integral(r - y) + kd * d(r - y)/dt behind a first-order filter

    with time constant `tau`, computed at every sample from the measured y and held to the next.
    """

    drive: int
    coordinate: int
    u0: float
    kp: float
    ki: float
    kd: float
    tau: float


def tuned(
    rng: np.random.Generator, system: System, p: Mapping[str, float], design: Design
) -> tuple[Gains, ...]:
    """Tune a controller for every loop from the plant's own inertia."""
    found = []
    x0 = design.q0[:, None]
    for drive, c in system.loops:
        unit = system.drives[drive]
        inertia = float(np.ravel(system.mass(x0, p)[unit.row][unit.row])[0])
        if "n1" in system.constants:
            inertia += p["j2"] / p["n1"] ** 2
        scale = p[unit.scale] if unit.scale else 1.0
        speed = design.omega * rng.uniform(0.5, 0.9) * (0.4 if "n1" in system.constants else 1.0)
        if system.order == 1:
            kp, kd = inertia * speed / scale, 0.0
        else:
            kp, kd = inertia * speed**2 / scale, 2 * 0.7 * inertia * speed / scale
        ki = (
            kp * speed * rng.uniform(0.05, 0.2) if rng.uniform() < 0.6 or system.order == 1 else 0.0
        )
        found.append(Gains(drive, c, float(design.u0[drive]), kp, ki, kd, 3.0 * design.dt))
    return tuple(found)


class Controller:
    """The controllers of a case at work in all experiments."""

    def __init__(self, gains: tuple[Gains, ...], design: Design, inputs: int) -> None:
        self.gains, self.design, self.inputs = gains, design, inputs
        shape = (len(gains), design.experiments)
        self.integral, self.slope = np.zeros(shape), np.zeros(shape)
        self.last: Array | None = None

    def step(self, k: int, measured: Array) -> Array:
        """Return the inputs of sample k from the measured coordinates (loops, experiments)."""
        dt = self.design.dt
        error = self.design.signal[:, k] - measured
        last = error if self.last is None else self.last
        self.integral = self.integral + dt * error
        u = np.repeat(self.design.u0[:, None], error.shape[1], axis=1)
        for i, g in enumerate(self.gains):
            share = dt / (g.tau + dt)
            self.slope[i] += share * ((error[i] - last[i]) / dt - self.slope[i])
            u[g.drive] = g.u0 + g.kp * error[i] + g.ki * self.integral[i] + g.kd * self.slope[i]
        self.last = error
        return u
