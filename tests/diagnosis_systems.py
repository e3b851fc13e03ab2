"""Masses that move along an axis: the given models of the tests of diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import numpy as np

from jaxsr.models import Simulator
from jaxsr.recordings import Recording

DEMO = Path(__file__).resolve().parents[1] / "jaxsr" / "datasets" / "demo"
ARM = DEMO / "arm.toml"

# One simulator a model: another one would be compiled again.
simulator_of = cache(Simulator)


def on_an_axis(
    force: str,
    parameters: Mapping[str, str],
    reading: str = "q",
    units: Mapping[str, str] | None = None,
    drive: str = "u",
    mass: str = "M",
) -> str:
    """Return the model file of `mass` * q'' = `force` with the input `drive` and one sensor y."""
    lines = [
        "[model]",
        'states = ["q", "v"]',
        f'inputs = ["{drive}"]',
        'outputs = ["y"]',
        "[equations]",
        'q = "v"',
        f'v = "{force}"',
        f'[inertia]\nv = {{ v = "{mass}" }}',
        f'[readings]\ny = "{reading}"',
        "[parameters]",
        *(f"{name} = {{ {value} }}" for name, value in parameters.items()),
        *(["[units]"] if units else []),
        *(f'{name} = "{unit}"' for name, unit in (units or {}).items()),
    ]
    return "\n".join(lines) + "\n"


# On a rail with viscous friction, pushed by a force.
RAIL = on_an_axis(
    "force - Fv*v",
    {
        "M": 'value = 2.0, unit = "kg", bounds = [0.5, 10.0]',
        "Fv": 'value = 3.0, unit = "N*s/m", bounds = [0.0, 30.0]',
    },
    units={"q": "m", "v": "m/s", "force": "N", "y": "m"},
    drive="force",
)
# Between a spring and a damper, all of whose values are free.
SPRUNG = on_an_axis(
    "u - k*q - Fv*v",
    {
        "M": 'value = 2.0, unit = "kg", bounds = [0.5, 8.0]',
        "k": 'value = 30.0, unit = "N/m", bounds = [0.0, 200.0]',
        "Fv": 'value = 2.0, unit = "N*s/m", bounds = [0.0, 20.0]',
    },
    units={"q": "m", "v": "m/s", "u": "N", "y": "m"},
)
# The same with fixed values as well, so that wrong_value has something to say.
STIFF = on_an_axis(
    "u - k*q - Fv*v",
    {
        "M": 'value = 2.0, unit = "kg"',
        "k": 'value = 50.0, unit = "N/m", bounds = [10.0, 200.0]',
        "Fv": 'value = 1.0, unit = "N*s/m"',
        "c": 'value = 3.0, unit = "V/m"',
    },
    reading="c*q",
    units={"q": "m", "v": "m/s", "u": "N", "y": "V"},
)
# A cart on a spring, without units.
CART = on_an_axis(
    "u - c*v - k*q",
    {
        "m": "value = 2.0, bounds = [0.5, 10.0]",
        "c": "value = 3.0, bounds = [0.0, 50.0]",
        "k": "value = 8.0, bounds = [0.0, 500.0]",
    },
    mass="m",
)
# Two tanks of which the upper one is not measured.
TANKS = """
[model]
name = "two tanks"
states = ["h1", "h2"]
inputs = ["u"]
outputs = ["y"]
input_hold = "zero"
[equations]
h1 = "k4*u - k1*sqrt(Max(h1, 0))"
h2 = "k2*sqrt(Max(h1, 0)) - k3*sqrt(Max(h2, 0))"
[readings]
y = "h2"
[parameters]
k1 = { value = 0.06 }
k2 = { value = 0.05, bounds = [0.001, 0.5] }
k3 = { value = 0.08, bounds = [0.001, 0.5] }
k4 = { value = 0.06, bounds = [0.001, 0.5] }
[initial]
h1 = "free"
h2 = "free"
"""
TWO_MASSES = """
[model]
name = "two masses"
states = ["a", "b", "va", "vb"]
inputs = ["u"]
outputs = ["y", "z"]
[equations]
a = "va"
b = "vb"
va = "u - ka*a - 0.4*va + 6*(b - a)"
vb = "-kb*b - 0.3*vb + 6*(a - b)"
[readings]
y = "a"
z = "b"
[parameters]
ka = { value = 9.0, bounds = [1.0, 50.0] }
kb = { value = 4.0, bounds = [1.0, 50.0] }
"""


def sprung_recording(
    force: Callable[[float, float, float], float],
    rng: np.random.Generator,
    noise: float,
    count: int = 1200,
    step: float = 0.02,
) -> Recording:
    """Record 2 q'' = force(q, v, u) under four random sines, by RK4 in steps of a tenth."""
    time, fine = np.arange(count) * step, 10
    lines, phases = rng.uniform(1.0, 7.0, 4), rng.uniform(0.0, 6.28, 4)
    u = 4.0 * np.sin(np.multiply.outer(time, lines) + phases).sum(-1)

    def rate(x: np.ndarray, u: float) -> np.ndarray:
        return np.array([x[1], force(x[0], x[1], u) / 2.0])

    x, path, h = np.zeros(2), [0.0], step / fine
    for k in range(count - 1):
        for j in range(fine):
            a, m, b = (u[k] + (u[k + 1] - u[k]) * (j + c) / fine for c in (0.0, 0.5, 1.0))
            k1 = rate(x, a)
            k2 = rate(x + h / 2 * k1, m)
            k3 = rate(x + h / 2 * k2, m)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3, b))
        path.append(x[0])
    y = np.array(path) + noise * rng.standard_normal(count)
    return Recording("a.csv", time, {"u": u, "y": y})
