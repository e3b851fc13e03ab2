"""The truth: a plant with its effects, integrated tightly, and replayed quickly for fits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from scipy.integrate import DOP853

from benchmarks.concealed.effects import Effect, Look
from benchmarks.concealed.systems import Array, System, solve

RTOL = 1e-9
FIRST_STEPS, STEPS = 5000, 100
"""Steps from which a truth is too stiff to be had: in all, and for every sample beside."""


class Plant(Protocol):
    """Another way to the accelerations of a system, such as MuJoCo."""

    def accelerations(self, q: Array, v: Array, force: Array, added: Sequence[Any]) -> Array:
        """Return a for generalised forces besides inertia's own and gravity."""
        ...


@dataclass(frozen=True, eq=False)
class World:
    """A system with constants and effects.

    Attributes
    ----------
    p : mapping
        True constants; numbers, or arrays over runs.
    values : sequence of mappings
        Constants of every effect.
    """

    system: System
    p: Mapping[str, Any]
    effects: Sequence[Effect] = ()
    values: Sequence[Mapping[str, Any]] = field(default_factory=tuple)
    plant: Plant | None = None

    @staticmethod
    def of(
        system: System,
        p: Mapping[str, Any],
        effects: Sequence[Effect] = (),
        plant: Plant | None = None,
    ) -> World:
        """Return a world whose effects have their own constants."""
        return World(system, p, tuple(effects), tuple(e.values for e in effects), plant)

    @property
    def motions(self) -> int:
        """How many states the plant itself has."""
        return self.system.size * self.system.order

    @property
    def states(self) -> int:
        """How many states there are, those of the effects last."""
        return self.motions + sum(e.extra for e in self.effects)

    def split(self, x: Array) -> tuple[Array, Array, Array]:
        """Return coordinates, velocities and the effects' states."""
        n = self.system.size
        q = x[:n]
        v = x[n : 2 * n] if self.system.order == 2 else np.zeros_like(q)
        return q, v, x[self.motions :]

    def rates(self, t: Any, x: Array, tape: Tape, at: Any, run: Any) -> Array:
        """Return dx/dt; `at` is the time in samples, for reading the inputs off the tape."""
        q, v, z = self.split(x)
        u = tape.inputs(at, self._delays())
        out = np.empty_like(x)
        force = np.zeros_like(q)
        added: list[Any] = [0.0] * self.system.size
        first = 0
        recorded = u
        for effect, e in zip(self.effects, self.values, strict=True):
            own = z[first : first + effect.extra]
            look = Look(t, q, v, recorded, own, self.p, run)
            if effect.drive is not None:
                u = u.copy()
                u[effect.index] = effect.drive(look, u[effect.index], e)
            if effect.rates is not None:
                begin = self.motions + first
                out[begin : begin + effect.extra] = effect.rates(look, e)
            if effect.force is not None:
                force = force + effect.force(look, e)
            if effect.inertia is not None:
                added[effect.index] = e[effect.inertia]
            first += effect.extra
        force = force + self.system.applied(q, v, u, self.p)
        a = self._accelerations(q, v, force, added)
        n = self.system.size
        if self.system.order == 2:
            out[:n], out[n : 2 * n] = v, a
        else:
            out[:n] = a
        return out

    def _delays(self) -> list[tuple[int, Any]]:
        found = []
        for effect, e in zip(self.effects, self.values, strict=True):
            if effect.kind == "input" and effect.delay is not None:
                found.append((effect.index, e[effect.delay]))
        return found

    def _accelerations(self, q: Array, v: Array, force: Array, added: list[Any]) -> Array:
        if self.plant is not None:
            return self.plant.accelerations(q, v, force, added)
        mass = self.system.mass(q, self.p)
        for i, more in enumerate(added):
            mass[i][i] = mass[i][i] + more
        if self.system.bias is not None:
            force = force + self.system.bias(q, v, self.p)
        return solve(mass, force)


@dataclass(eq=False)
class Tape:
    """Recorded inputs of the runs, held between samples as the model file says.

    Attributes
    ----------
    u : ndarray, shape (inputs, samples, experiments)
    dt : float
    hold : {"linear", "zero"}
    run, start : ndarray of int, shape (runs,)
        Experiment and first sample of every run.
    """

    u: Array
    dt: float
    hold: str
    run: Array
    start: Array

    def inputs(self, at: Any, delays: Sequence[tuple[int, Any]]) -> Array:
        """Return the inputs at `at` samples after the runs' starts."""
        out = self._read(at + self.start)
        for index, tau in delays:
            out = out.copy()
            out[index] = self._read(at + self.start - tau / self.dt)[index]
        return out

    def _read(self, position: Array) -> Array:
        last = self.u.shape[1] - 1
        # a time that rounding puts just below a sample belongs to the sample
        whole = np.floor(position + 1e-9).astype(int)
        k = np.clip(whole, 0, last)
        here = self.u[:, k, self.run]
        if self.hold == "zero":
            return here
        share = np.clip(position - whole, 0.0, 1.0) * (whole >= 0)
        return here + share * (self.u[:, np.minimum(k + 1, last), self.run] - here)


class Exact:
    """Runs side by side, integrated by DOP853 from sample to sample."""

    def __init__(self, world: World, tape: Tape, x0: Array) -> None:
        self.world, self.tape = world, tape
        self.x = np.array(x0)
        self.k = 0
        self.step = tape.dt
        self.steps = 0
        self.scale = np.abs(self.x) + 1e-12

    def rates(self) -> Array:
        """Return dx/dt at the present sample."""
        t = self.k * self.tape.dt
        return self.world.rates(t, self.x, self.tape, float(self.k), self.tape.run)

    def advance(self) -> None:
        """Integrate to the next sample."""
        dt, shape, k = self.tape.dt, self.x.shape, self.k
        self.scale = np.maximum(self.scale, np.abs(self.x))
        inner = np.nextafter(1.0, 0.0)  # a value held to the next sample ends before it

        def f(s: float, y: Array) -> Array:
            at = k + min(s, 1.0 - 1e-8) if self.tape.hold == "zero" else k + min(s, inner)
            x = y.reshape(shape)
            return dt * self.world.rates((k + s) * dt, x, self.tape, at, self.tape.run).ravel()

        tolerance: Any = (1e-10 * self.scale).ravel()
        solver = DOP853(
            f,
            0.0,
            self.x.ravel(),
            1.0,
            rtol=RTOL,
            atol=tolerance,
            first_step=min(max(self.step, 1e-4), 1.0),
        )
        while solver.status == "running":
            solver.step()
            self.steps += 1
            if solver.status == "running":
                self.step = solver.h_abs
            if self.steps > FIRST_STEPS + STEPS * k:
                raise FloatingPointError(f"the truth is too stiff at sample {k}")
        if solver.status == "failed" or not np.isfinite(solver.y).all():
            raise FloatingPointError(f"the truth could not be integrated past sample {k}")
        self.step = max(self.step, float(solver.h_abs))
        self.x = solver.y.reshape(shape)
        self.k += 1


def replay(world: World, tape: Tape, x0: Array, samples: int, substeps: int) -> tuple[Array, Array]:
    """Integrate by classical Runge-Kutta steps of dt/substeps.

    Parameters
    ----------
    x0 : ndarray, shape (states, runs)

    Returns
    -------
    x, dx : ndarray, shape (states, samples, runs)
        States and their derivatives at the samples.
    """
    x = np.array(x0)
    h = 1.0 / substeps
    dt = tape.dt
    states = np.empty((x.shape[0], samples, x.shape[1]))
    slopes = np.empty_like(states)
    edge = 1.0 - 1e-8 if tape.hold == "zero" else 1.0
    with np.errstate(all="ignore"):
        for k in range(samples):
            for j in range(substeps):
                s, end = j * h, min((j + 1) * h, edge)
                t0 = (tape.start + k + s) * dt
                f = world.rates
                k1 = f(t0, x, tape, k + s, tape.run)
                if j == 0:
                    states[:, k], slopes[:, k] = x, k1
                    if k == samples - 1:
                        return states, slopes
                mid = t0 + 0.5 * h * dt
                k2 = f(mid, x + 0.5 * h * dt * k1, tape, k + s + 0.5 * h, tape.run)
                k3 = f(mid, x + 0.5 * h * dt * k2, tape, k + s + 0.5 * h, tape.run)
                k4 = f(t0 + h * dt, x + h * dt * k3, tape, k + end, tape.run)
                x = x + (h * dt / 6.0) * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return states, slopes
