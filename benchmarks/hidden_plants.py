"""Small plants with states that no sensor reads, memories, and faults of sensors.

A plant says its motion twice: as a model file, which the search reads, and as a function that SciPy
integrates with what the model leaves out. Every state starts from rest at zero.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from jaxsr.recordings import Recording

Values = Mapping[str, float]
FREE = 3.0
"""Bounds of a free parameter: its value divided and multiplied by this."""


@dataclass(frozen=True)
class Missing:
    """What the model leaves out of a motion, by names of its constants; nothing by default.

    Attributes
    ----------
    force : mapping
        Of `coulomb` (Fc), `drag` (kd), `cubic` (k3), `hysteresis_kz`, `_b`, `_g`, and of a
        resonator `mode_mh`, `_wh`, `_zh`: along the plant's own axis.
    lag : float
        Time constant of the actuator in s.
    wrong : mapping
        Factors on parameters.
    level : float
        At which the first tank overflows.
    fault : mapping
        Of the first sensor: `gain`, `bias`, `drift` and `clip` (in its deviations), `delay` (s),
        `skew`.
    """

    force: Mapping[str, float] | None = None
    lag: float = 0.0
    wrong: Mapping[str, float] | None = None
    level: float = np.inf
    fault: Mapping[str, float] | None = None


@dataclass(frozen=True, eq=False)
class Plant:
    """A system.

    Attributes
    ----------
    states : tuple of str
    equations, inertia : mapping of str to str
    readings : mapping of str to str
        Of all sensors that it could have.
    values : mapping
        Parameters, all free and right as given.
    rates : callable
        (x, u, values, force along its axis, `Missing`) to dx/dt.
    axis : (int or None, int)
        Positions in `states` of the displacement and speed of its axis.
    read : callable
        (sensor, x, dx/dt) to a reading.
    step, amplitude : float
    band : (low, high)
        Frequencies of the input in rad/s.
    """

    name: str
    states: tuple[str, ...]
    equations: Mapping[str, str]
    inertia: Mapping[str, str]
    readings: Mapping[str, str]
    values: Values
    rates: Callable[..., list[float] | np.ndarray]
    axis: tuple[int | None, int]
    read: Callable[[str, np.ndarray, np.ndarray], np.ndarray]
    step: float
    amplitude: float
    band: tuple[float, float]

    def model(self, sensors: tuple[str, ...]) -> str:
        """Return the model file with some sensors."""
        tables = {
            "equations": self.equations,
            "readings": {s: self.readings[s] for s in sensors},
        }
        text = f'[model]\nname = "{self.name}"\nstates = {list(self.states)}\ninputs = ["u"]\n'
        text += f"outputs = {list(sensors)}\n"
        for title, table in tables.items():
            text += f"[{title}]\n" + "".join(f'{k} = "{v}"\n' for k, v in table.items())
        if self.inertia:
            rows = (f'{k} = {{ {k} = "{v}" }}\n' for k, v in self.inertia.items())
            text += "[inertia]\n" + "".join(rows)
        bounds = (
            f"{k} = {{ value = {v}, bounds = [{v / FREE}, {v * FREE}] }}\n"
            for k, v in self.values.items()
        )
        return text + "[parameters]\n" + "".join(bounds)

    def records(
        self,
        rng: np.random.Generator,
        sensors: tuple[str, ...],
        missing: Missing | None = None,
        samples: int = 400,
        noise: float = 1e-3,
    ) -> list[Recording]:
        """Return two recordings; `noise` is in deviations of a reading."""
        missing = missing or Missing()
        runs = [self._run(rng, sensors, missing, samples) for _ in range(2)]
        size = np.concatenate([y for _, _, y in runs], axis=1).std(axis=1)
        found = []
        for number, (time, u, exact) in enumerate(runs):
            rows = {}
            for k, sensor in enumerate(sensors):
                fault = (missing.fault or {}) if k == 0 else {}
                y = _faulty(time, exact[k], size[k], fault) + noise * size[k] * rng.normal(
                    size=time.size
                )
                most = fault.get("clip", np.inf) * size[k]
                rows[sensor] = np.clip(y, -most, most)
            found.append(Recording(f"run_{number}", time, {"u": u, **rows}))
        return found

    def _run(
        self, rng: np.random.Generator, sensors: tuple[str, ...], missing: Missing, samples: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return times, input and exact readings (sensors, samples)."""
        time = np.arange(samples) * self.step
        slow, fast = np.log(self.band)
        paces = np.exp(rng.uniform(slow, fast, 5))
        sizes, phases = rng.uniform(0.4, 1.0, 5), rng.uniform(0.0, 6.28, 5)
        drive = self.amplitude * (sizes * np.sin(np.outer(time, paces) + phases)).sum(axis=1)
        n, force = len(self.states), missing.force or {}
        values = {k: v * (missing.wrong or {}).get(k, 1.0) for k, v in self.values.items()}
        place, speed = self.axis

        def rate(t: float, x: np.ndarray) -> np.ndarray:
            u, out = float(np.interp(t, time, drive)), np.zeros(n + 3)
            if missing.lag:
                out[n] = (u - x[n]) / missing.lag
                u = x[n]
            q = 0.0 if place is None else x[place]
            push, out[n + 1 :] = _along(force, q, x[speed], x[n + 1 :])
            out[:n] = self.rates(x[:n], u, values, push, missing)
            return out

        span = (0.0, float(time[-1]))
        options = {"rtol": 1e-8, "atol": 1e-9, "method": "LSODA", "max_step": self.step}
        run = solve_ivp(rate, span, np.zeros(n + 3), t_eval=time, **options)
        slopes = np.stack([rate(t, x) for t, x in zip(time, run.y.T, strict=True)], axis=1)
        read = [self.read(s, run.y[:n], slopes[:n]) for s in sensors]
        return time, drive, np.array(read)


def _along(force: Values, q: float, v: float, z: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the force left out along an axis, and the rates of its memory."""
    push = -force.get("coulomb", 0.0) * np.tanh(v / force.get("width", 1e-2))
    push -= force.get("viscous", 0.0) * v + force.get("drag", 0.0) * v * abs(v)
    push -= force.get("cubic", 0.0) * q**3
    rates = np.zeros(2)
    if "hysteresis_kz" in force:
        b, g = force["hysteresis_b"], force["hysteresis_g"]
        rates[0] = v - b * abs(v) * z[0] - g * v * abs(z[0])
        push -= force["hysteresis_kz"] * z[0]
    if "mode_mh" in force:
        pace, damping = force["mode_wh"], force["mode_zh"]
        pull = pace**2 * (q - z[0]) + 2.0 * damping * pace * (v - z[1])
        rates[:] = z[1], pull
        push -= force["mode_mh"] * pull
    return float(push), rates


def _faulty(time: np.ndarray, y: np.ndarray, size: float, fault: Values) -> np.ndarray:
    """Return what a faulty sensor makes of a signal."""
    late = time * (1.0 + fault.get("skew", 0.0)) - fault.get("delay", 0.0)
    y = fault.get("gain", 1.0) * np.interp(late, time, y)
    return y + size * (fault.get("bias", 0.0) + fault.get("drift", 0.0) * time / time[-1])


def _cart(x: np.ndarray, u: float, p: Values, push: float, _: Missing) -> list[float]:
    return [x[1], (u - p["k"] * x[0] - p["d"] * x[1] + push) / p["m"]]


CART = Plant(
    "cart",
    ("q", "v"),
    {"q": "v", "v": "u - k*q - d*v"},
    {"v": "m"},
    {"y": "q", "s": "v", "a": "d(v)"},
    {"m": 1.3, "k": 20.0, "d": 1.0},
    _cart,
    (0, 1),
    lambda s, x, dx: {"y": x[0], "s": x[1], "a": dx[1]}[s],
    0.02,
    6.0,
    (0.5, 9.0),
)


def _motor(x: np.ndarray, u: float, p: Values, push: float, _: Missing) -> list[float]:
    w, i = x
    return [
        (p["K"] * i - p["b"] * w + push) / p["J"],
        (u - p["R"] * i - p["K"] * w) / p["L"],
    ]


MOTOR = Plant(
    "DC motor",
    ("w", "i"),
    {"w": "(K*i - b*w)/J", "i": "(u - R*i - K*w)/L"},
    {},
    {"current": "i", "speed": "w"},
    {"J": 0.02, "b": 0.05, "K": 0.3, "R": 1.2, "L": 0.05},
    _motor,
    (None, 0),
    lambda s, x, dx: {"current": x[1], "speed": x[0]}[s],
    0.01,
    3.0,
    (1.0, 12.0),
)


def _quarter(x: np.ndarray, u: float, p: Values, push: float, _: Missing) -> list[float]:
    zs, zu, vs, vu = x
    strut = -p["ks"] * (zs - zu) - p["cs"] * (vs - vu)
    return [vs, vu, (strut + push) / p["ms"], (-strut - p["kt"] * (zu - u)) / p["mu"]]


QUARTER_CAR = Plant(
    "quarter car",
    ("zs", "zu", "vs", "vu"),
    {
        "zs": "vs",
        "zu": "vu",
        "vs": "-ks*(zs - zu) - cs*(vs - vu)",
        "vu": "ks*(zs - zu) + cs*(vs - vu) - kt*(zu - u)",
    },
    {"vs": "ms", "vu": "mu"},
    {"body": "zs", "travel": "zs - zu", "acceleration": "d(vs)"},
    {"ms": 2.5, "mu": 0.4, "ks": 90.0, "cs": 4.0, "kt": 900.0},
    _quarter,
    (0, 2),
    lambda s, x, dx: {"body": x[0], "travel": x[0] - x[1], "acceleration": dx[2]}[s],
    0.01,
    0.05,
    (1.0, 25.0),
)


def _tanks(x: np.ndarray, u: float, p: Values, push: float, missing: Missing) -> list[float]:
    lost = 2.0 * max(x[0] - missing.level, 0.0)
    return [1.0 + u - p["a"] * x[0] - lost, p["a"] * x[0] - p["b"] * x[1] + push]


TANKS = Plant(
    "two tanks",
    ("h1", "h2"),
    {"h1": "1 + u - a*h1", "h2": "a*h1 - b*h2"},
    {},
    {"first": "h1", "second": "h2"},
    {"a": 0.5, "b": 0.6},
    _tanks,
    (None, 1),
    lambda s, x, dx: {"first": x[0], "second": x[1]}[s],
    0.5,
    0.35,
    (0.05, 0.5),
)


def chain(count: int, axis: int, grounded: bool = False) -> Plant:
    """Return masses on springs in a row from a wall, the last one driven.

    Dampers lie beside the springs, or between every mass and the ground.
    """
    equations = {f"q{i}": f"v{i}" for i in range(count)}
    for i in range(count):
        before, slow = (f"q{i} - q{i - 1}", f"v{i} - v{i - 1}") if i else ("q0", "v0")
        force = f"-k*({before}) - c*" + (f"v{i}" if grounded else f"({slow})")
        if i + 1 < count:
            force += f" + k*(q{i + 1} - q{i})"
            force += "" if grounded else f" + c*(v{i + 1} - v{i})"
        equations[f"v{i}"] = force + (" + u" if i + 1 == count else "")

    def rates(x: np.ndarray, u: float, p: Values, push: float, _: Missing) -> np.ndarray:
        q, v = x[:count], x[count:]
        pull = p["k"] * np.diff(q, prepend=0.0)
        pull += 0.0 if grounded else p["c"] * np.diff(v, prepend=0.0)
        force = np.append(pull[1:], u) - pull - (p["c"] * v if grounded else 0.0)
        force[axis] += push
        return np.concatenate([v, force / p["m"]])

    return Plant(
        f"chain of {count}",
        (*(f"q{i}" for i in range(count)), *(f"v{i}" for i in range(count))),
        equations,
        {f"v{i}": "m" for i in range(count)},
        {f"y{i}": f"q{i}" for i in range(count)},
        {"m": 1.0, "k": 100.0, "c": 1.5},
        rates,
        (axis, count + axis),
        lambda s, x, dx: x[int(s[1:])],
        0.02,
        12.0,
        (0.5, 12.0),
    )
