"""Chains of masses of any length and rate, and their model without the dry friction."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

_FRICTION, _SMOOTH = 0.4, 0.02  # N; m/s over which it turns round
_NOISE = 1e-3  # of a signal's spread
_DAMPING = 0.3  # N*s/m
_FINE = 400  # steps a second of the solution that is sampled


def springs(masses: int) -> np.ndarray:
    """Return the stiffness before each mass and behind the last, N/m (masses + 1,)."""
    return 20.0 + 5.0 * (np.arange(masses + 1) % 3)


def force(t: np.ndarray | float) -> np.ndarray:
    """Return what drives the first mass, N."""
    return np.asarray(5.0 * np.sin(2.0 * np.asarray(t)) + 3.0 * np.sin(3.7 * np.asarray(t)))


def recorded(masses: int, samples: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Return time, force, positions and speeds: 20 s and more, 200 s at most.

    Parameters
    ----------
    masses, samples : int
    seed : int

    Returns
    -------
    dict of str to ndarray, (samples,)
        t, u, q1, ..., v1, ...
    """
    rng = np.random.default_rng(seed)
    k = springs(masses)
    last = np.arange(masses) == masses - 1

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        q, v = x[:masses], x[masses:]
        pull = np.diff(np.concatenate([[0.0], q, [0.0]])) * k
        dry = _FRICTION * last * np.tanh(v / _SMOOTH)
        push = np.where(np.arange(masses) == 0, force(t), 0.0)
        return np.concatenate([v, np.diff(pull) - _DAMPING * v - dry + push])

    span = float(np.clip(20.0 * samples / 1000.0, 20.0, 200.0))
    fine = np.linspace(0.0, span, int(_FINE * span) + 1)
    start = np.concatenate([rng.normal(0.0, 0.3, masses), np.zeros(masses)])
    path = solve_ivp(rates, (0.0, span), start, "LSODA", fine, rtol=1e-8, atol=1e-9).y
    t = np.linspace(0.0, span, samples)
    found = CubicSpline(fine, path, axis=1)(t)
    found += _NOISE * np.std(found, axis=1, keepdims=True) * rng.normal(size=found.shape)
    names = [f"{kind}{n + 1}" for kind in "qv" for n in range(masses)]
    return {"t": t, "u": force(t), **dict(zip(names, found, strict=True))}


def model(masses: int) -> str:
    """Return the model file of a chain whose last mass has no dry friction."""
    k = springs(masses)
    q = [f"q{n + 1}" for n in range(masses)]
    v = [f"v{n + 1}" for n in range(masses)]
    equations = {q[n]: v[n] for n in range(masses)}
    for n in range(masses):
        before = q[n] if n == 0 else f"({q[n]} - {q[n - 1]})"
        behind = q[n] if n == masses - 1 else f"({q[n]} - {q[n + 1]})"
        pull = f"-k{n}*{before} - k{n + 1}*{behind} - c{n + 1}*{v[n]}"
        equations[v[n]] = f"u {pull.replace('-', '- ', 1)}" if n == 0 else pull
    values = {f"k{n}": (k[n], "N/m") for n in range(masses + 1)}
    values |= {f"c{n + 1}": (_DAMPING, "N*s/m") for n in range(masses)}
    lines = ["[model]", 'name = "chain"', 'time = "t"', f"states = {_list([*q, *v])}"]
    lines += ['inputs = ["u"]', f"outputs = {_list([f'y{n + 1}' for n in range(masses)])}"]
    lines += ["", "[equations]", *(f'{s} = "{text}"' for s, text in equations.items())]
    lines += ["", "[inertia]", *(f'{s} = {{ {s} = "1.0" }}' for s in v)]
    lines += ["", "[readings]", *(f'y{n + 1} = "{s}"' for n, s in enumerate(q))]
    lines += ["", "[parameters]"]
    for name, (value, unit) in values.items():
        bounds = f"[0.0, {4.0 * value}]"
        lines.append(f'{name} = {{ value = {1.02 * value}, unit = "{unit}", bounds = {bounds} }}')
    lines += ["", "[columns]", *(f'y{n + 1} = "{s}"' for n, s in enumerate(q))]
    return "\n".join(lines) + "\n"


def _list(names: list[str]) -> str:
    return "[" + ", ".join(f'"{name}"' for name in names) + "]"


def write_case(
    folder: Path, masses: int, samples: int, recordings: int = 1
) -> tuple[Path, list[Path]]:
    """Write the model and recordings of a chain, of so many samples each; return their paths."""
    model_file, data = folder / "chain.toml", []
    model_file.write_text(model(masses), encoding="utf-8")
    for seed in range(recordings):
        data.append(folder / (f"chain{seed}.npz" if seed else "chain.npz"))
        table: dict[str, Any] = recorded(masses, samples, seed)
        np.savez(data[-1], **table)
    return model_file, data
