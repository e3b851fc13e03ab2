"""Machines of which one sensor reads no further than its limits, whatever else is left out.

How such readings are weighed was settled on `SEEN`; `HELD_OUT` were made afterwards, and were run
before the last two rules.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.machine_models import free, model_text
from benchmarks.unread_machines import Machine
from jaxsr.recordings import Recording

REACHED = 0.08
"""Share of the samples that lie beyond a limit."""


@dataclass(frozen=True)
class Saturated:
    """A machine and the sensor that is limited.

    Attributes
    ----------
    machine : Machine
    output : str
    ends : str
        Of its range, that are reached: top, bottom or both.
    """

    machine: Machine
    output: str
    ends: str

    def recordings(self, rng: np.random.Generator, lacking: bool) -> list[Recording]:
        """Return recordings in which what is beyond the limits, noise included, is cut off."""
        whole = self.machine.recordings(rng, lacking)
        every = np.concatenate([r.channel(self.output) for r in whole])
        low = np.quantile(every, REACHED) if self.ends != "top" else -np.inf
        high = np.quantile(every, 1.0 - REACHED) if self.ends != "bottom" else np.inf
        return [self._cut(recording, float(low), float(high)) for recording in whole]

    def _cut(self, recording: Recording, low: float, high: float) -> Recording:
        cut = np.clip(recording.channel(self.output), low, high)
        return replace(recording, channels={**recording.channels, self.output: cut})


_MASS = Machine(
    model_text(
        {"x": "v", "v": "(F - k*x - c*v)/2"},
        '"F"',
        {"y": "x"},
        {"k": free(20.0, 5.0, 60.0), "c": free(0.8, 0.0, 5.0)},
    ),
    *("v", "- 0.5*v*Abs(v)", "quadratic_drag", 0.02, 9.0, (0.3, 0.0)),
)
_OVEN = Machine(
    model_text(
        {"T": "(260 + P - g*(T - C))/50", "C": "(g*(T - C) - h*(C - 20))/300"},
        '"P"',
        {"inside": "C"},
        {"g": free(5.0, 2.0, 20.0), "h": free(2.0, 0.5, 10.0)},
    ),
    *("C", "- 0.0001*(C - 20)*Abs(C - 20)", "quadratic_drag", 4.0, 200.0, (180.0, 140.0)),
)
_TANKS = Machine(
    model_text(
        {
            "h1": "(0.75 + q - a*sqrt(Max(h1, 0)))/4",
            "h2": "(a*sqrt(Max(h1, 0)) - b*sqrt(Max(h2, 0)))/3",
        },
        '"q"',
        {"level": "h2"},
        {"a": free(0.5, 0.1, 2.0), "b": free(0.4, 0.1, 2.0)},
    ),
    *("h2", "- 0.06*h2", "linear_stiffness", 0.5, 0.4, (2.0, 2.0)),
)
_PENDULUM = Machine(
    model_text(
        {"q": "w", "w": "(M - 9.81*m*sin(q) - c*w)/m"},
        '"M"',
        {"angle": "q", "gyro": "w"},
        {"m": free(1.0, 0.2, 3.0), "c": free(0.15, 0.0, 2.0)},
    ),
    *("w", "- 0.8*sign(w)", "coulomb_friction", 0.01, 4.0, (0.5, 0.0)),
)
_MOTOR = Machine(
    model_text(
        {"i": "(U - r*i - 0.08*w)/0.004", "w": "(0.08*i - b*w)/0.0006"},
        '"U"',
        {"current": "i", "speed": "w"},
        {"r": free(1.2, 0.3, 5.0), "b": free(0.0006, 0.0, 0.01)},
    ),
    *("w", "- 40*sign(w)", "coulomb_friction", 0.002, 8.0, (0.0, 0.0)),
)
_CAR = Machine(
    model_text(
        {
            "z": "v",
            "y": "w",
            "v": "(-k*(z - y) - d*(v - w))/250",
            "w": "(k*(z - y) + d*(v - w) - 160000*(y - road))/40",
        },
        '"road"',
        {"body": "z - y", "a": "(-k*(z - y) - d*(v - w))/250"},
        {"k": free(16000.0, 5000.0, 50000.0), "d": free(1000.0, 200.0, 4000.0)},
    ),
    *("v", "- 0.4*(v - w)*Abs(v - w)", "quadratic_drag", 0.005, 0.02, (0.0, 0.0, 0.0, 0.0)),
)
_FILTER = Machine(
    model_text(
        {"a": "(1.6 + u - a)/r - (a - b)", "b": "(a - b)/1.5 - g*b"},
        '"u"',
        {"adc": "b"},
        {"r": free(0.8, 0.2, 3.0), "g": free(0.2, 0.0, 2.0)},
    ),
    *("b", "- 0.08*b**3", "cubic_stiffness", 0.05, 1.2, (1.0, 1.0)),
)
_CHAIN = Machine(
    model_text(
        {
            "x1": "v1",
            "x2": "v2",
            "v1": "(F - k*(x1 - x2) - 0.4*(v1 - v2) - 30*x1)/1.5",
            "v2": "k*(x1 - x2) + 0.4*(v1 - v2) - c*v2 - 10*x2",
        },
        '"F"',
        {"y1": "x1", "y2": "x2"},
        {"k": free(80.0, 20.0, 300.0), "c": free(0.5, 0.0, 5.0)},
    ),
    *("v2", "- 600*x2**3", "cubic_stiffness", 0.01, 12.0, (0.0, 0.0, 0.0, 0.0)),
)
_BEAM = Machine(
    model_text(
        {"q": "w", "w": "u - k*q - d*w"},
        '"u"',
        {"gauge": "q"},
        {"k": free(400.0, 100.0, 1000.0), "d": free(1.5, 0.0, 10.0)},
    ),
    *("w", "- 1.2*sign(w)", "coulomb_friction", 0.005, 12.0, (0.02, 0.0)),
)
_CART = Machine(
    model_text(
        {"x": "v", "v": "(9*u - f*v)/3"},
        '"u"',
        {"way": "x", "speed": "v"},
        {"f": free(2.0, 0.2, 8.0)},
    ),
    *("v", "- 0.7*v*Abs(v)", "quadratic_drag", 0.02, 1.2, (0.0, 0.0)),
)

SEEN = {
    "mass on a spring": Saturated(_MASS, "y", "top"),
    "oven": Saturated(_OVEN, "inside", "bottom"),
    "tanks": Saturated(_TANKS, "level", "both"),
    "pendulum": Saturated(_PENDULUM, "angle", "bottom"),
}
HELD_OUT = {
    "motor": Saturated(_MOTOR, "current", "both"),
    "quarter car": Saturated(_CAR, "a", "both"),
    "filter and converter": Saturated(_FILTER, "adc", "bottom"),
    "two masses": Saturated(_CHAIN, "y2", "top"),
    "strain gauge": Saturated(_BEAM, "gauge", "top"),
    "cart": Saturated(_CART, "speed", "both"),
}
MACHINES = {**SEEN, **HELD_OUT}
