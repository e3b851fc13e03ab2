"""The owners' ladder of friction laws, fitted to the runs of the XL330 servo: what to compare with.

    python -m benchmarks.bam_laws

Laws are fitted by least squares of free runs over the runs at gains 100, 400 and 800, and judged
on those at 200. The load that a gear carries is taken as the owners take it: that of the motor and
that of the pendulum.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from benchmarks.recording_case import ROOT
from jaxsr._result import InputError
from jaxsr.datasets import fetch

GAINS, HELD_OUT = (100, 400, 800), 200
RUNS = ("sin_sin", "lift_and_drop", "up_and_down", "sin_time_square")
STEP = 0.0025  # s, about half a sample
STILL = 0.02
"""Speed in rad/s within which dry friction turns over."""
KT, MASS, LENGTH, GRAVITY = 0.3232, 0.49, 0.1, 9.81  # the owners', in SI units
START = {"R": 4.764, "J": 0.001643, "Fv": 0.0105, "Fc": 0.00697}
BOUNDS = {"R": (2.0, 10.0), "J": (1e-4, 0.01), "Fv": (0.0, 0.1), "Fc": (0.0, 0.3)}
SIZES = {"R": 0.5, "J": 3e-4, "Fv": 3e-3, "Fc": 0.01}
LAWS: Mapping[str, tuple[str, ...]] = {
    "M1, Coulomb": (),
    "M3, load of the gear": ("mu",),
    "M5, loads of motor and pendulum": ("mu_motor", "mu_pendulum"),
}
"""Coefficients of load-dependent friction beside viscous and Coulomb friction."""


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs side by side on one grid of half steps; angles on whole steps.

    Attributes
    ----------
    drive, on : ndarray, shape (runs, 2 * steps + 1)
        Voltage at the motor in V, and whether it is switched on.
    angle : ndarray, shape (runs, steps + 1)
        In rad.
    """

    drive: np.ndarray
    on: np.ndarray
    angle: np.ndarray

    @classmethod
    def read(cls, files: Sequence[Path]) -> Runs:
        """Read recordings and cut them to the shortest."""
        tables = [pd.read_csv(file) for file in files]
        steps = int(min(table["time_s"].iloc[-1] for table in tables) / STEP)
        time = 0.5 * STEP * np.arange(2 * steps + 1)

        def column(values: str) -> np.ndarray:
            return np.array([np.interp(time, t["time_s"], t[values]) for t in tables])

        drive = column("duty") * column("supply_V")
        return cls(drive, column("torque_on"), column("position_rad")[:, ::2])


def simulate(runs: Runs, values: Mapping[str, float]) -> np.ndarray:
    """Return angles of free runs from rest at the recorded start, by Runge-Kutta's method."""
    hanging = MASS * GRAVITY * LENGTH
    inertia = values["J"] + MASS * LENGTH**2

    def rate(q: np.ndarray, w: np.ndarray, half: int) -> tuple[np.ndarray, np.ndarray]:
        emf = KT * w
        motor = runs.on[:, half] * KT / values["R"] * (runs.drive[:, half] - emf)
        pendulum = hanging * np.sin(q)
        friction = values["Fc"] + values.get("mu", 0.0) * np.abs(motor + pendulum)
        friction = friction + values.get("mu_motor", 0.0) * np.abs(motor)
        friction = friction + values.get("mu_pendulum", 0.0) * np.abs(pendulum)
        passive = values["Fv"] * w + friction * np.tanh(w / STILL)
        return w, (motor - pendulum - passive) / inertia

    q, w = runs.angle[:, 0].copy(), np.zeros(len(runs.angle))
    path = [q]
    for step in range(runs.angle.shape[1] - 1):
        a = rate(q, w, 2 * step)
        b = rate(q + 0.5 * STEP * a[0], w + 0.5 * STEP * a[1], 2 * step + 1)
        c = rate(q + 0.5 * STEP * b[0], w + 0.5 * STEP * b[1], 2 * step + 1)
        d = rate(q + STEP * c[0], w + STEP * c[1], 2 * step + 2)
        q = q + STEP / 6.0 * (a[0] + 2.0 * b[0] + 2.0 * c[0] + d[0])
        w = w + STEP / 6.0 * (a[1] + 2.0 * b[1] + 2.0 * c[1] + d[1])
        path.append(q)
    return np.array(path).T


def fit(runs: Runs, extra: Sequence[str]) -> dict[str, float]:
    """Return the constants of a law by least squares of free runs."""
    start = START | dict.fromkeys(extra, 0.1)
    bounds = BOUNDS | dict.fromkeys(extra, (0.0, 1.0))
    sizes = SIZES | dict.fromkeys(extra, 0.05)

    def misses(values: np.ndarray) -> np.ndarray:
        found = simulate(runs, dict(zip(start, values, strict=True)))
        return np.clip(found - runs.angle, -2.0, 2.0)[:, ::4].ravel()

    found = least_squares(
        misses,
        [*start.values()],
        x_scale=[sizes[name] for name in start],
        bounds=tuple(np.transpose([bounds[name] for name in start])),
        diff_step=1e-3,
        max_nfev=30,
    )
    return dict(zip(start, map(float, found.x), strict=True))


def errors(runs: Runs, values: Mapping[str, float]) -> list[float]:
    """Return the RMSE of every run in rad."""
    missed = simulate(runs, values) - runs.angle
    return [float(e) for e in np.sqrt(np.mean(missed**2, axis=1))]


def files(folder: Path, gains: Sequence[int]) -> list[Path]:
    """Return the recordings at some gains."""
    return [folder / f"bam_kp{gain}_{run}.csv" for gain in gains for run in RUNS]


def main() -> int:
    """Fit and print; return the exit status."""
    local = ROOT.parent / "shared" / "recordings"
    if local.is_dir():
        os.environ.setdefault("JAXSR_DATA_DIR", str(local))
    with tempfile.TemporaryDirectory() as scratch:
        try:
            fetch("bam_xl330", scratch)
        except InputError as error:
            print(f"not run, the recordings are not to be had: {error}")
            return 0
        train = Runs.read(files(Path(scratch), GAINS))
        held = Runs.read(files(Path(scratch), (HELD_OUT,)))
    for name, extra in LAWS.items():
        values = fit(train, extra)
        row = [1e3 * e for e in errors(held, values)]
        constants = ", ".join(f"{k} {v:.4g}" for k, v in values.items())
        each = ", ".join(f"{e:.0f}" for e in row)
        print(f"{name}: {constants}; held out {np.mean(row):.1f} mrad ({each})", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
