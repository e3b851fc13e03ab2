"""The systems of the paper whose laws are known: recordings without noise, and with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy
from scipy.integrate import solve_ivp

from jaxsr import Recording
from jaxsr.expressions import parse, to_numpy, to_sympy

TIGHT = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12}

# Section 7.1, in the form that Eq. 22 shows; u1 of Eq. 23 is the force on mass 2
TWO_MASS = {
    "z1": "z3",
    "z2": "z4",
    "z3": "30*z2 - 50*z1 + 20*sin(2*t)",
    "z4": "60*z1 - 100*z2 + 20*sin(5*t + pi/3)",
}
FORCE = "100*sin(5*t + pi/3)"
TWO_MASS_DRIVEN = TWO_MASS | {"z4": "60*z1 - 100*z2 + u1/5"}
STARTS = ((0.0, 0.0, 0.0, 0.0), (1.0, -0.2, 0.0, 0.0))
UNSEEN = (0.5, 0.3, -1.0, 0.5)  # start of the validation recording, outside the training ones


@dataclass(frozen=True)
class System:
    """Laws as text, one for each state, in the states and t."""

    laws: Mapping[str, str]

    @property
    def states(self) -> tuple[str, ...]:
        """Return the states in order."""
        return tuple(self.laws)

    @property
    def derivatives(self) -> list[str]:
        """Return the columns of the derivatives."""
        return [f"d{s}" for s in self.laws]

    def record(self, start: Sequence[float], t: np.ndarray, name: str) -> Recording:
        """Return states and derivatives at times ``t`` of the motion from ``start`` at 0."""
        symbols = [sympy.Symbol(name, real=True) for name in ("t", *self.states)]
        laws = [to_sympy(parse(law)) for law in self.laws.values()]
        function = sympy.lambdify(symbols, laws, "numpy", cse=True)

        def rates(time: float | np.ndarray, z: np.ndarray) -> np.ndarray:
            return np.array(function(time, *z))

        end = float(t[-1])
        solution = solve_ivp(rates, (0.0, end), np.asarray(start, float), t_eval=t, **TIGHT)
        derivatives = rates(t, solution.y)
        channels = dict(zip(self.states, solution.y, strict=True))
        channels |= dict(zip(self.derivatives, derivatives, strict=True))
        return Recording(name, t, channels)


def two_mass(samples: int = 1000, seconds: float = 10.0) -> list[Recording]:
    """Return the two training experiments, half of the samples each."""
    t = np.linspace(0.0, seconds, samples // 2)
    system = System(TWO_MASS)
    return [system.record(start, t, f"start {k}") for k, start in enumerate(STARTS)]


def two_mass_unseen(samples: int = 1000, seconds: float = 15.0) -> Recording:
    """Return a clean experiment from another start, over a longer time."""
    return System(TWO_MASS).record(UNSEEN, np.linspace(0.0, seconds, samples), "unseen")


def with_force(recording: Recording) -> Recording:
    """Return the recording with the force on mass 2 as a channel u1."""
    force = to_numpy(parse(FORCE))({"t": recording.time})
    return Recording(recording.name, recording.time, {**recording.channels, "u1": force})


def variables(recording: Recording) -> dict[str, np.ndarray]:
    """Return time and channels by name."""
    return {"t": recording.time, **recording.channels}


def noisy(rng: np.random.Generator, recording: Recording, decibels: float) -> Recording:
    """Add Gaussian noise of sigma = rms * 10^(-dB/20) to every channel."""
    channels = {}
    for name, x in recording.channels.items():
        sigma = np.sqrt(np.mean(x**2)) * 10.0 ** (-decibels / 20.0)
        channels[name] = x + rng.normal(0.0, sigma, len(x))
    return Recording(recording.name, recording.time, channels)


def chain(masses: int = 25, stiffness: float = 40.0) -> System:
    """Return masses of 1 kg between walls, springs between neighbours, a harmonic force on each.

    Stiffnesses rise along the chain and every force has its own frequency and phase, so that no
    two equations hold the same constants.
    """
    springs = [stiffness + 2.0 * k for k in range(masses + 1)]
    laws = {f"x{k}": f"v{k}" for k in range(1, masses + 1)}
    for k in range(1, masses + 1):
        left, right = springs[k - 1], springs[k]
        parts = [f"-{left + right}*x{k}"]
        parts += [f"+ {left}*x{k - 1}"] if k > 1 else []
        parts += [f"+ {right}*x{k + 1}"] if k < masses else []
        parts += [f"+ {10.0 + 0.5 * k}*sin({1.5 + 0.35 * k}*t + {0.2 * k % 3.0:.1f})"]
        laws[f"v{k}"] = " ".join(parts)
    return System(laws)


@dataclass(frozen=True)
class CrankSlider:
    """Slider position z1 and its rate; crank L1, rod L2 (m), turning at w rad/s (section 7.2)."""

    crank: float = 1.0
    rod: float = 1.5
    w: float = 20.0

    @property
    def law(self) -> str:
        """Return the rate of the slider as text."""
        a, b, w = self.crank, self.rod, self.w
        root = f"sqrt({b**2} - {a**2}*sin({w}*t)**2)"
        return f"-{w * a}*sin({w}*t) - {w * a**2}*sin({w}*t)*cos({w}*t)/{root}"

    def record(self, t: np.ndarray) -> Recording:
        """Return z1 and dz1 at times ``t``; at t = 0, z1 = L1 + L2."""
        angle = self.w * t
        z1 = self.crank * np.cos(angle)
        z1 = z1 + np.sqrt(self.rod**2 - (self.crank * np.sin(angle)) ** 2)
        rate = to_numpy(parse(self.law))({"t": t})
        return Recording("crank-slider", t, {"z1": z1, "dz1": rate})
