"""Masses that move along an axis: the given models of the tests of diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

from jaxsr.models import Simulator

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
