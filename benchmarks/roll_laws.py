"""What the laws of the roll decays can do at all: least squares of free runs, as a yardstick.

    python -m benchmarks.roll_laws

The run that is held out (21338) goes on to swings of 1.1 degrees, the one to learn from (21337)
ends at 3.8: what the law says of small swings is an extrapolation. So the error stands beside that
of the held-out run's first minute, in which its swings are as large as those learned from, and
beside that of the same law fitted to the held-out run itself.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from benchmarks.recording_case import ROOT
from jaxsr._result import InputError
from jaxsr.datasets import fetch

TRAIN, HELD_OUT = 21337, 21338
STEPS = 2
"""Of Runge-Kutta's method between two samples, 20 ms apart."""
NAMES = ("w0", "b1", "kd", "k3", "F0")
START = (2.46, 0.005, 0.1, 4.0, 0.0)
FIRST = 0.05
"""Share of a run from which its start is estimated, as the contract says."""


def acceleration(law: Sequence[float], q: float, w: float) -> float:
    """Return the angular acceleration by frequency, damping, drag, hardening and offset."""
    w0, b1, kd, k3, offset = law
    return -w0 * w0 * q - b1 * w - kd * w * abs(w) - k3 * q * q * q + offset


def simulate(law: Sequence[float], start: Sequence[float], time: np.ndarray) -> np.ndarray:
    """Return the angle of a free run at evenly spaced times, shape (samples,)."""
    q, w = start
    h = float(time[1] - time[0]) / STEPS
    path = np.empty(time.size)
    for k in range(time.size):
        path[k] = q
        for _ in range(STEPS):
            a1 = acceleration(law, q, w)
            a2 = acceleration(law, q + 0.5 * h * w, w + 0.5 * h * a1)
            a3 = acceleration(law, q + 0.5 * h * w + 0.25 * h * h * a1, w + 0.5 * h * a2)
            a4 = acceleration(law, q + h * w + 0.5 * h * h * a2, w + h * a3)
            q += h * w + h * h * (a1 + a2 + a3) / 6.0
            w += h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0
    return path


def fit(time: np.ndarray, angle: np.ndarray) -> tuple[list[float], float]:
    """Return the law of a run by least squares, and the RMSE in rad."""

    def misses(values: np.ndarray) -> np.ndarray:
        return simulate(values[:5], values[5:], time) - angle

    found = least_squares(misses, [*START, angle[0], 0.0], x_scale="jac")
    return [float(v) for v in found.x[:5]], float(np.sqrt(np.mean(found.fun**2)))


def errors(law: Sequence[float], time: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return the errors of a run in rad, its start estimated on its first twentieth."""
    few = round(FIRST * time.size)

    def misses(start: np.ndarray) -> np.ndarray:
        return simulate(law, start, time[:few]) - angle[:few]

    start = least_squares(misses, [angle[0], 0.0], x_scale=(0.1, 0.2)).x
    return simulate(law, start, time) - angle


def compared(folder: Path) -> dict[str, Any]:
    """Return laws, and RMSE in mrad of runs."""
    runs = {}
    for run in (TRAIN, HELD_OUT):
        table = pd.read_csv(folder / f"kvlcc2_{run}.csv")
        runs[run] = table["time_s"].to_numpy(), table["roll_rad"].to_numpy()
    law, train = fit(*runs[TRAIN])
    own, best = fit(*runs[HELD_OUT])
    missed = 1e3 * errors(law, *runs[HELD_OUT])
    time, angle = runs[TRAIN]
    least = np.abs(angle[-round(0.05 * time.size) :]).max()
    swings = np.abs(runs[HELD_OUT][1])
    alike = int(np.flatnonzero(swings >= least)[-1]) + 1
    return {
        "law": dict(zip(NAMES, law, strict=True)),
        "law of the held-out run": dict(zip(NAMES, own, strict=True)),
        "samples as large": alike,
        "mrad": {
            "learned from": 1e3 * train,
            "held out": float(np.sqrt(np.mean(missed**2))),
            "held out, swings as large as those learned from": float(
                np.sqrt(np.mean(missed[:alike] ** 2))
            ),
            "held-out run fitted itself": 1e3 * best,
        },
    }


def main() -> int:
    """Fit and print; return the exit status."""
    local = ROOT.parent / "shared" / "recordings"
    if local.is_dir():
        os.environ.setdefault("JAXSR_DATA_DIR", str(local))
    with tempfile.TemporaryDirectory() as scratch:
        try:
            fetch("kvlcc2", scratch)
        except InputError as error:
            print(f"not run, the recordings are not to be had: {error}")
            return 0
        for name, value in compared(Path(scratch)).items():
            print(f"{name}: {value}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
