"""Machines that a monitor watches: a model file each, and a simulation with or without an effect.

Simulations are Runge-Kutta steps, many between samples where a law is steep: an error of theirs
would be a machine that does not follow its model. The models are what an explained model would be.
Sensors have white noise, noise that is correlated from sample to sample, or the steps of an
encoder; one machine is driven by a force that no model knows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from jaxsr.models import Model, parse_model
from jaxsr.recordings import Recording

HOLD = 12
"""Samples for which an input is led to its next level."""

Rates = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Rates of states from states (states, machines) and inputs (inputs, machines)."""


@dataclass(frozen=True)
class Sensor:
    """How a state is read.

    Attributes
    ----------
    state : int
    deviation : float
        Of the noise.
    correlation : float
        Of it, from sample to sample.
    step : float
        Of an encoder; 0 for none.
    """

    state: int
    deviation: float
    correlation: float = 0.0
    step: float = 0.0


@dataclass(frozen=True)
class Plant:
    """A machine.

    Attributes
    ----------
    name : str
    text : str
        Its model file.
    interval : float
        Between samples, in s.
    rates : dict of str to Rates
        By effect; ``""`` is normal running.
    size, middle : tuple of float
        Deviation and mean of the inputs.
    start : tuple of float
    sensors : tuple of Sensor
    unknown : tuple of (state, deviation, correlation)
        Changes of a state at every sample that no model knows.
    drift : float
        Of the first sensor, for the effect ``drift``, per s.
    steps : int
        Between two samples: as many as leave errors far below the noise.
    """

    name: str
    text: str
    interval: float
    rates: dict[str, Rates]
    size: tuple[float, ...]
    middle: tuple[float, ...]
    start: tuple[float, ...]
    sensors: tuple[Sensor, ...]
    unknown: tuple[int, float, float] | None = None
    drift: float = 0.0
    steps: int = 4

    @property
    def model(self) -> Model:
        """The model that the machine follows."""
        return parse_model(self.text, self.name)

    def runs(
        self,
        rng: np.random.Generator,
        machines: int,
        samples: int,
        effect: str = "",
        begins: int = 0,
    ) -> list[Recording]:
        """Simulate machines side by side, with an effect from a sample on.

        Parameters
        ----------
        rng : Generator
        machines, samples : int
        effect : str
            Of `rates`, or ``drift``.
        begins : int
        """
        inputs = self._inputs(rng, machines, samples + 1)
        states = self._states(rng, inputs, effect, begins)
        time, model = self.interval * np.arange(samples), self.model
        found = []
        for k in range(machines):
            columns = dict(zip(model.inputs, inputs[:, :samples, k], strict=True))
            for j, (name, sensor) in enumerate(zip(model.outputs, self.sensors, strict=True)):
                noise = sensor.deviation * correlated(rng, (samples,), sensor.correlation)
                values = states[sensor.state, :, k] + noise
                if effect == "drift" and j == 0:
                    values = values + self.drift * np.maximum(time - time[begins], 0.0)
                if sensor.step:
                    values = sensor.step * np.round(values / sensor.step)
                columns[name] = values
            found.append(Recording(f"{self.name} {k}", time, columns))
        return found

    def _states(
        self, rng: np.random.Generator, inputs: np.ndarray, effect: str, begins: int
    ) -> np.ndarray:
        """Return the motion, shape (states, samples, machines)."""
        samples, machines = inputs.shape[1] - 1, inputs.shape[2]
        push = self._push(rng, samples, machines)
        states = np.zeros((len(self.start), samples, machines))
        x = np.repeat(np.array(self.start, dtype=float)[:, None], machines, axis=1)
        normal, changed = self.rates[""], self.rates.get(effect, self.rates[""])
        h = self.interval / self.steps
        for i in range(samples):
            states[:, i] = x
            f = changed if i >= begins else normal
            here, rise = inputs[:, i], inputs[:, i + 1] - inputs[:, i]
            for s in range(self.steps):
                u0, u1, u2 = (here + (s + part) / self.steps * rise for part in (0.0, 0.5, 1.0))
                a = f(x, u0)
                b = f(x + 0.5 * h * a, u1)
                c = f(x + 0.5 * h * b, u1)
                x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + f(x + h * c, u2))
            if self.unknown is not None:
                x[self.unknown[0]] += push[i]
        return states

    def _push(self, rng: np.random.Generator, samples: int, machines: int) -> np.ndarray:
        if self.unknown is None:
            return np.zeros((samples, machines))
        _, deviation, correlation = self.unknown
        return deviation * correlated(rng, (samples, machines), correlation)

    def _inputs(self, rng: np.random.Generator, machines: int, samples: int) -> np.ndarray:
        """Return levels that are led to one another by straight lines."""
        at = np.arange(samples) / HOLD
        left, share = at.astype(int), (at % 1.0)[:, None]
        shape = (int(left[-1]) + 2, machines)
        parts = []
        for size, middle in zip(self.size, self.middle, strict=True):
            levels = middle + size * np.clip(rng.normal(size=shape), -2.5, 2.5)
            parts.append(levels[left] * (1.0 - share) + levels[left + 1] * share)
        return np.stack(parts)


def correlated(rng: np.random.Generator, shape: tuple[int, ...], rho: float) -> np.ndarray:
    """Return noise of unit variance, correlated along the first axis from sample to sample."""
    white = rng.normal(size=shape)
    white[1:] *= np.sqrt(1.0 - rho**2)
    return np.asarray(lfilter([1.0], [1.0, -rho], white, axis=0))


def _mount(k: float) -> Rates:
    return lambda x, u: np.stack([x[1], (u[0] - 0.6 * x[1] - k * x[0]) / 1.2])


MOUNT = Plant(
    "mount",
    """
[model]
name = "machine mount"
states = ["q", "v"]
inputs = ["force"]
outputs = ["y"]
[equations]
q = "v"
v = "(force - c*v - k*q)/m"
[readings]
y = "q"
[parameters]
m = { value = 1.2, unit = "kg" }
c = { value = 0.6, unit = "N*s/m" }
k = { value = 4.0, unit = "N/m" }
[units]
q = "m"
v = "m/s"
force = "N"
y = "m"
""",
    0.1,
    {"": _mount(4.0), "softer": _mount(3.6)},
    (2.0,),
    (0.0,),
    (0.0, 0.0),
    (Sensor(0, 0.02),),
)


def _drive(gain: float, friction: float) -> Rates:
    return lambda x, u: np.stack(
        [x[1], (gain * u[0] - 0.05 * x[1] - friction * np.tanh(x[1] / 0.2)) / 0.08]
    )


DRIVE = Plant(
    "drive",
    """
[model]
name = "drive with gear"
states = ["q", "w"]
inputs = ["current"]
outputs = ["angle", "speed"]
[equations]
q = "w"
w = "(K*current - b*w - Fc*tanh(w/0.2))/J"
[readings]
angle = "q"
speed = "w"
[parameters]
J = { value = 0.08, unit = "kg*m^2" }
K = { value = 0.5, unit = "N*m/A" }
b = { value = 0.05, unit = "N*m*s" }
Fc = { value = 0.2, unit = "N*m" }
[units]
q = "rad"
w = "rad/s"
current = "A"
angle = "rad"
speed = "rad/s"
""",
    0.1,
    {"": _drive(0.5, 0.2), "friction": _drive(0.5, 0.25), "weaker": _drive(0.46, 0.2)},
    (1.5,),
    (0.0,),
    (0.0, 0.0),
    (Sensor(0, 0.0, step=2.0 * np.pi / 4096), Sensor(1, 0.1, 0.9)),
    steps=24,
)


def _pendulum(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    return np.stack([x[1], -9.81 * np.sin(x[0]) - 0.4 * x[1] + u[0]])


PENDULUM = Plant(
    "pendulum",
    """
[model]
name = "pendulum in the wind"
states = ["q", "w"]
inputs = ["torque"]
outputs = ["angle"]
[equations]
q = "w"
w = "torque - g*sin(q) - c*w"
[readings]
angle = "q"
[parameters]
g = { value = 9.81, unit = "1/s^2" }
c = { value = 0.4, unit = "1/s" }
[units]
q = "rad"
w = "rad/s"
torque = "1/s^2"
angle = "rad"
""",
    0.1,
    {"": _pendulum},
    (4.0,),
    (0.0,),
    (0.0, 0.0),
    (Sensor(0, 0.01, 0.8),),
    unknown=(1, 0.02, 0.8),
    drift=0.004,
)


def _tanks(leak: float) -> Rates:
    def rates(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        upper, lower = 0.25 * np.sqrt(np.maximum(x, 0.0))
        return np.stack([0.5 * u[0] - upper, upper - lower - leak]) / 4.0

    return rates


TANKS = Plant(
    "tanks",
    """
[model]
name = "two tanks"
states = ["h1", "h2"]
inputs = ["pump"]
outputs = ["upper", "lower"]
[equations]
h1 = "(G*pump - a*sqrt(Max(h1, 0)))/A"
h2 = "(a*sqrt(Max(h1, 0)) - a*sqrt(Max(h2, 0)))/A"
[readings]
upper = "h1"
lower = "h2"
[parameters]
G = { value = 0.5 }
a = { value = 0.25 }
A = { value = 4.0 }
""",
    1.0,
    {"": _tanks(0.0), "leak": _tanks(0.02)},
    (0.4,),
    (1.5,),
    (9.0, 9.0),
    (Sensor(0, 0.05), Sensor(1, 0.05, 0.6)),
)

PLANTS = (MOUNT, PENDULUM, DRIVE, TANKS)
EFFECTS = (
    (MOUNT, "softer", "a spring 10 % softer"),
    (DRIVE, "friction", "dry friction up by a quarter"),
    (DRIVE, "weaker", "a motor 8 % weaker"),
    (PENDULUM, "drift", "a sensor that drifts by 4 mrad/s"),
    (TANKS, "leak", "a leak of 2 % of the flow"),
)
"""Plant, effect, and what it is."""
