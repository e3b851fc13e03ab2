"""Recordings of machines that strike something: tight integration, impacts located by scipy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from jaxsr.recordings import Recording

Array = np.ndarray
BALL = """
[model]
name = "ball"
states = ["q", "v"]
inputs = []
outputs = ["h"]
[equations]
q = "v"
v = "-g"
[readings]
h = "q"
[parameters]
g = 9.81
e = { value = 0.7, bounds = [0.3, 1.0] }
[[events]]
when = "q"
direction = -1
reset = { v = "-e*v" }
"""
HAMMER = """
[model]
name = "hammer"
states = ["q", "v"]
inputs = ["u"]
outputs = ["y", "w"]
[equations]
q = "v"
v = "(u - k*q - c*v)/m"
[readings]
y = "q"
w = "v"
[parameters]
m = 1.0
k = { value = 35.0, bounds = [20.0, 60.0] }
c = { value = 0.5, bounds = [0.05, 2.0] }
e = { value = 0.7, bounds = [0.3, 1.0] }
[[events]]
when = "0.12 - q"
direction = -1
reset = { v = "-e*v" }
"""
PENDULUM = """
[model]
name = "pendulum"
states = ["a", "w"]
inputs = []
outputs = ["angle"]
[equations]
a = "w"
w = "-(g/l)*sin(a) - b*w"
[readings]
angle = "a"
[parameters]
g = 9.81
l = { value = 0.8, bounds = [0.5, 1.2] }
b = { value = 0.08, bounds = [0.0, 0.5] }
e = { value = 0.85, bounds = [0.3, 1.0] }
[[events]]
when = "0.1 - a"
direction = -1
reset = { w = "-e*w" }
"""
CART = """
[model]
name = "cart"
states = ["x", "v"]
inputs = ["F"]
outputs = ["p"]
[equations]
x = "v"
v = "(F - c*v)/m"
[readings]
p = "x"
[parameters]
m = { value = 2.2, bounds = [1.0, 4.0] }
c = { value = 1.0, bounds = [0.1, 4.0] }
e = { value = 0.6, bounds = [0.1, 1.0] }
[[events]]
when = "1 - x"
direction = -1
reset = { v = "-e*v" }
[[events]]
when = "x + 1"
direction = -1
reset = { v = "-e*v" }
"""


def motion(
    rate: Callable[[float, Array], list[float]],
    gap: Callable[[Array], float],
    restitution: float,
    begin: tuple[float, float],
    time: Array,
) -> Array:
    """Position and speed, shape (samples, 2); the speed turns over where the gap closes.

    Of what is pressed to rest against the wall it finds no end.
    """

    def closes(t: float, x: Array) -> float:
        return gap(x)

    vars(closes).update(terminal=True, direction=-1.0)  # as scipy asks for it
    found, state, t = np.zeros((time.size, 2)), np.array(begin), float(time[0])
    while True:
        done = solve_ivp(
            rate, (t, time[-1]), state, events=closes, rtol=1e-9, atol=1e-11,
            max_step=0.02, dense_output=True,
        )  # fmt: skip
        here = (time >= t) & (time <= done.t[-1])
        if here.any():
            found[here] = done.sol(time[here]).T
        if done.status != 1:
            return found
        state = np.array([done.y[0, -1], -restitution * done.y[1, -1]])
        t = float(done.t[-1])
        state = state + 1e-10 * np.array(rate(t, state))  # off the surface


def dropped(rng: np.random.Generator, drag: float = 0.0, e: float = 0.75) -> list[Recording]:
    """Heights of a ball from three drops, with noise of 1 mm; `drag` by the square of the speed."""
    time, found = np.arange(0.0, 3.0, 0.005), []
    for k, height in enumerate((2.0, 1.2, 3.0)):
        x = motion(
            lambda t, x: [x[1], -9.81 - drag * x[1] * abs(x[1])],
            lambda x: float(x[0]),
            e,
            (height, 0.0),
            time,
        )
        found.append(Recording(f"r{k}", time, {"h": x[:, 0] + 1e-3 * rng.normal(size=time.size)}))
    return found


def struck(rng: np.random.Generator, friction: float = 0.0, cubic: float = 0.0) -> list[Recording]:
    """Three runs of a mass on a spring that strikes a wall, driven; position and speed are read."""
    time, found = np.arange(0.0, 8.0, 0.01), []
    for k in range(3):
        phase, tones = rng.uniform(0.0, 6.0, 3), np.array([0.5, 0.9, 1.4]) * (1.0 + 0.2 * k)
        force = 3.0 * np.sin(2.0 * np.pi * np.outer(time, tones) + phase).sum(axis=1)

        def rate(t: float, x: Array, force: Array = force) -> list[float]:
            pushed = float(np.interp(t, time, force)) - 40.0 * x[0] - 0.3 * x[1]
            return [x[1], pushed - friction * np.tanh(x[1] / 1e-3) - cubic * x[0] ** 3]

        x = motion(rate, lambda x: 0.12 - float(x[0]), 0.6, (0.0, 0.0), time)
        x = x + np.array([2e-4, 5e-3]) * rng.normal(size=x.shape)
        found.append(Recording(f"r{k}", time, {"u": force, "y": x[:, 0], "w": x[:, 1]}))
    return found


def swung(rng: np.random.Generator, friction: float = 0.0, drag: float = 0.0) -> list[Recording]:
    """Three swings of a pendulum against a wall, its angle in steps of an encoder."""
    time, step, found = np.arange(0.0, 6.0, 0.005), 2.0 * np.pi / 4096.0, []

    def rate(t: float, x: Array) -> list[float]:
        lost = 0.05 * x[1] + friction * np.tanh(x[1] / 1e-3) + drag * x[1] * abs(x[1])
        return [x[1], -12.0 * np.sin(x[0]) - lost]

    for k in range(3):
        begin = float(-rng.uniform(0.8, 1.4)), 0.0
        x = motion(rate, lambda x: 0.1 - float(x[0]), 0.8, begin, time)
        found.append(Recording(f"r{k}", time, {"angle": step * np.round(x[:, 0] / step)}))
    return found


def pushed(rng: np.random.Generator, friction: float = 0.0, drag: float = 0.0) -> list[Recording]:
    """Two runs of a cart between two walls, pushed; only its place is read."""
    time, tones, found = np.arange(0.0, 10.0, 0.01), np.array([0.2, 0.35, 0.6]), []
    for k in range(2):
        phase = rng.uniform(0.0, 6.0, 3)
        force = 4.0 * np.sin(2.0 * np.pi * np.outer(time, tones) + phase).sum(axis=1)

        def rate(t: float, x: Array, force: Array = force) -> list[float]:
            lost = 0.8 * x[1] + friction * np.tanh(x[1] / 1e-3) + drag * x[1] * abs(x[1])
            return [x[1], (float(np.interp(t, time, force)) - lost) / 2.0]

        x = motion(rate, lambda x: 1.0 - abs(float(x[0])), 0.5, (0.0, 0.0), time)
        place = x[:, 0] + 5e-4 * rng.normal(size=time.size)
        found.append(Recording(f"r{k}", time, {"F": force, "p": place}))
    return found
