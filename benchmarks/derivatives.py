"""Errors of smoothers and derivatives over signals, noises and grids.

    python -m benchmarks.derivatives [--quick] [--seeds N]

Every method of `jaxsr.views.smooth` and of `jaxsr.views.derivative` on 512 samples over 10 s, for
seven signals with known derivatives and a relay; errors are root mean squares over the samples
inside (a fiftieth of the record at each end is left out), next to the noise for values and next to
the derivative's own root mean square for derivatives. "auto" is compared with the best single
method of each case.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import scipy
from scipy.integrate import solve_ivp

from jaxsr.views import (
    DERIVATIVES,
    SMOOTHERS,
    choose_smoother,
    derivative,
    noise_by_sample,
    smooth,
)

RESULT = Path(__file__).parent / "results" / "derivatives.json"
SAMPLES, SECONDS = 512, 10.0
GRIDS = ("uniform", "irregular", "missing")
LEVELS = (1e-3, 1e-2, 5e-2)
NOISES = (
    ("none", 0.0),
    *[(kind, level) for kind in ("additive", "multiplicative") for level in LEVELS],
)


def sine(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two turns and a half."""
    w = np.pi / 2.0
    return np.sin(w * t), w * np.cos(w * t)


def chirp(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """From 0.1 Hz to 2.1 Hz."""
    phase, rate = 2.0 * np.pi * (0.1 * t + 0.1 * t**2), 2.0 * np.pi * (0.1 + 0.2 * t)
    return np.sin(phase), rate * np.cos(phase)


def decay(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A damped oscillation."""
    e = np.exp(-0.3 * t)
    return e * np.cos(4.0 * t), -e * (0.3 * np.cos(4.0 * t) + 4.0 * np.sin(4.0 * t))


def logistic(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Growth from 1 % to saturation."""
    x = 1.0 / (1.0 + 99.0 * np.exp(-1.5 * t))
    return x, 1.5 * x * (1.0 - x)


def stick_slip(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Velocity: rest, a half sine, rest, ...: a jump in the acceleration at every start."""
    phase = np.mod(t / 2.5, 1.0)
    moving = phase > 0.5
    angle = 2.0 * np.pi * (phase - 0.5)
    w = 2.0 * np.pi / 2.5
    return np.where(moving, np.sin(angle), 0.0), np.where(moving, w * np.cos(angle), 0.0)


def relay(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A square wave: its values only, since it has no derivative to compare with."""
    return np.sign(np.sin(1.7 * t + 0.1)), np.zeros(t.size)


def _solved(rates: Callable, start: list[float], rate: float) -> Callable:
    def signal(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        run = solve_ivp(
            rates,
            (0.0, SECONDS * rate),
            start,
            method="DOP853",
            rtol=1e-10,
            atol=1e-10,
            dense_output=True,
        )
        z = run.sol(t * rate)
        return z[0], rate * np.asarray(rates(0.0, z))[0]

    return signal


def _van_der_pol(_t: float, z: np.ndarray) -> list:
    return [z[1], 5.0 * (1.0 - z[0] ** 2) * z[1] - z[0]]


def _lorenz(_t: float, z: np.ndarray) -> list:
    return [10.0 * (z[1] - z[0]), z[0] * (28.0 - z[2]) - z[1], z[0] * z[1] - 8.0 / 3.0 * z[2]]


SIGNALS: dict[str, Callable] = {
    "sine": sine,
    "chirp": chirp,
    "decay": decay,
    "logistic": logistic,
    "van_der_pol": _solved(_van_der_pol, [2.0, 0.0], 3.0),
    "stick_slip": stick_slip,
    "lorenz": _solved(_lorenz, [1.0, 1.0, 1.0], 1.0),
    "relay": relay,
}


def case(
    signal: str, kind: str, level: float, grid: str, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
    """Times, noisy samples, true values, true derivatives and the noise's root mean square."""
    rng = np.random.default_rng([seed, 7])
    t = np.linspace(0.0, SECONDS, SAMPLES)
    if grid == "irregular":
        t = np.sort(rng.uniform(0.0, SECONDS, SAMPLES))
    x, slope = SIGNALS[signal](t)
    size = level * (np.std(x) if kind == "additive" else np.abs(x))
    y = x + size * rng.normal(size=t.size)
    if grid == "missing":
        y[rng.random(t.size) < 0.05] = np.nan
    return t, y, x, slope, float(np.sqrt(np.mean(np.broadcast_to(size, t.shape) ** 2)))


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(np.square(x))))


def _pooled(errors: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def measure(signal: str, kind: str, level: float, grid: str, seeds: int) -> dict:
    """Errors of every method in one case, root mean square over the seeds."""
    values: dict[str, list[float]] = {}
    slopes: dict[str, list[float]] = {}
    seconds: dict[str, float] = {}
    picks: list[str] = []
    for seed in range(seeds):
        t, y, x, slope, noise = case(signal, kind, level, grid, seed)
        inside = slice(SAMPLES // 50, -(SAMPLES // 50))
        unit = noise or float(np.std(x))
        size = _rms(slope) or np.nan
        sigma = noise_by_sample(t, y) if level else None
        for method in SMOOTHERS if level else ("auto",):
            start = time.process_time()
            smoothed = smooth(t, y, method, sigma)
            seconds[method] = seconds.get(method, 0.0) + (time.process_time() - start) / seeds
            values.setdefault(method, []).append(_rms((smoothed - x)[inside]) / unit)
        # what smooth(t, y, noise=sigma) does, without a second fit
        pick = choose_smoother(t, y, sigma) if level else "unchanged"
        if level:
            values.setdefault("auto", []).append(values[pick][-1])
        picks.append(pick)
        for method in ("auto", *DERIVATIVES) if np.isfinite(size) else ():
            estimate = derivative(t, y, method)
            slopes.setdefault(method, []).append(_rms((estimate - slope)[inside]) / size)
    return {
        "signal": signal,
        "noise": kind,
        "level": level,
        "grid": grid,
        "value": {m: _pooled(e) for m, e in values.items()},
        "derivative": {m: _pooled(e) for m, e in slopes.items()},
        "seconds": seconds,
        "picks": picks,
    }


def near_best(cases: list[dict], quantity: str, method: str, within: float = 1.3) -> float:
    """Share of the cases in which a method is within a factor of the best single method."""
    near = []
    for one in cases:
        errors = one[quantity]
        if errors:
            best = min(e for name, e in errors.items() if name != "auto")
            near.append(errors[method] <= within * best + 1e-9)
    return float(np.mean(near))


def _table(cases: list[dict], quantity: str) -> list[str]:
    methods = list(cases[0][quantity])
    lines = ["case".ljust(42) + "".join(m[:16].rjust(18) for m in methods)]
    for one in cases:
        name = f"{one['signal']} {one['noise']} {one['level']:g} {one['grid']}"
        errors = (f"{one[quantity][m]:18.4g}" for m in methods if m in one[quantity])
        lines.append(name.ljust(42) + "".join(errors))
    shares = (f"{near_best(cases, quantity, m):18.0%}" for m in methods)
    return [*lines, "within 1.3 of the best".ljust(42) + "".join(shares)]


def main() -> None:
    """Print the tables; write the result of a full run."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="one seed, uniform grid, no file")
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    seeds, grids = (1, GRIDS[:1]) if options.quick else (options.seeds, GRIDS)
    cases = []
    for kind, level in NOISES:
        for grid in grids:
            cases += [measure(signal, kind, level, grid, seeds) for signal in SIGNALS]
    noisy = [one for one in cases if one["level"] > 0.0]
    print("Values, next to the noise\n" + "\n".join(_table(noisy, "value")))
    print("\nDerivatives, next to their size\n" + "\n".join(_table(cases, "derivative")))
    if not options.quick:
        RESULT.parent.mkdir(exist_ok=True)
        RESULT.write_text(json.dumps(_summary(cases, noisy, seeds), indent=1) + "\n")


def _summary(cases: list[dict], noisy: list[dict], seeds: int) -> dict:
    return {
        "samples": SAMPLES,
        "seconds": SECONDS,
        "seeds": seeds,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "value_within_1.3_of_best": {m: near_best(noisy, "value", m) for m in noisy[0]["value"]},
        "derivative_within_1.3_of_best": {
            m: near_best(noisy, "derivative", m) for m in noisy[0]["derivative"]
        },
        "cases": cases,
    }


if __name__ == "__main__":
    main()
