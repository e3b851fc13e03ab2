"""What a system is: a model file as a user would write it, and its motion written anew in NumPy."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Array = np.ndarray
Values = Mapping[str, Any]
Rates = Callable[[Array, Array, Values, Array], Any]


@dataclass(frozen=True)
class Constant:
    """A parameter of the model file: range it is drawn from (log-uniform), and whether it is free.

    Attributes
    ----------
    low, high : float
    free : bool
        Whether the file gives it bounds.
    unit : str
    """

    low: float
    high: float
    free: bool = False
    unit: str = ""


@dataclass(frozen=True)
class Axis:
    """An equation along which a force may act.

    Attributes
    ----------
    state : str
        The state whose equation it is: the site is ``equation:state``.
    position : str
        The coordinate whose rate the state is; empty where no state is.
    turning : bool
        Whether the coordinate is an angle.
    without : tuple of str
        Mechanisms that are no force of their own here, such as viscous damping where the model
        has some already.
    """

    state: str
    position: str = ""
    turning: bool = False
    without: tuple[str, ...] = ()


@dataclass(frozen=True)
class Drive:
    """A recorded input: sines of random phase, or steps at random times, about an offset.

    Attributes
    ----------
    amplitude : float
        Rms about the offset.
    band : (float, float)
        Frequencies in rad/s; steps last about a period of their middle.
    actuator : bool
        Whether something commanded acts here; a road or a weather has no dead zone.
    """

    amplitude: float
    band: tuple[float, float]
    offset: float = 0.0
    steps: bool = False
    actuator: bool = True


@dataclass(frozen=True)
class Gauge:
    """A place for a sensor: a state, or the rate of one.

    Attributes
    ----------
    state : str
    kind : {"position", "speed", "acceleration", "other"}
        An acceleration is the rate of the state; encoders read positions.
    gain : float
        Reading over quantity.
    """

    state: str
    kind: str
    gain: float = 1.0

    @property
    def expression(self) -> str:
        """The reading in the grammar of the model file."""
        text = f"d({self.state})" if self.kind == "acceleration" else self.state
        return text if self.gain == 1.0 else f"{self.gain!r}*{text}"


@dataclass(frozen=True)
class System:
    """A system.

    Attributes
    ----------
    name, group : str
    states : tuple of str
    tables : str
        [definitions], [equations] and [inertia] of the model file.
    motion : callable
        (x, u, p, f) -> dx/dt, arrays (states, lanes), (inputs, lanes), (axes, lanes); f are forces
        along the axes in the unit that CONTRACT.md, section 4, gives them.
    constants : dict of str to Constant
    drives : dict of str to Drive
    axes : tuple of Axis
    gauges : tuple of Gauge
        Sensors of the usual case.
    inertial : tuple of Gauge
        Sensors where accelerometers and gyros are used; empty where there are none.
    dt : float
        Seconds between samples.
    start : dict of str to float
        States at the start that are not zero.
    pairs : tuple of (int, int)
        Axes between which a spring or damper may act.
    springs : bool
        Whether every position is held by a spring or a weight.
    hold : str
        `input_hold` of the model file.
    without : tuple of str
        Mechanisms that cannot be told from others here.
    """

    name: str
    group: str
    states: tuple[str, ...]
    tables: str
    motion: Rates
    constants: Mapping[str, Constant]
    drives: Mapping[str, Drive]
    axes: tuple[Axis, ...]
    gauges: tuple[Gauge, ...]
    dt: float
    inertial: tuple[Gauge, ...] = ()
    start: Mapping[str, float] = field(default_factory=dict)
    pairs: tuple[tuple[int, int], ...] = ()
    springs: bool = True
    hold: str = "linear"
    without: tuple[str, ...] = ()

    def drawn(self, rng: np.random.Generator) -> dict[str, float]:
        """Return values of the constants."""
        return {
            name: float(f"{np.exp(rng.uniform(np.log(c.low), np.log(c.high))):.4g}")
            for name, c in self.constants.items()
        }

    def at_start(self) -> Array:
        """Return the start, shape (states,)."""
        return np.array([self.start.get(s, 0.0) for s in self.states])

    def index(self, state: str) -> int:
        """Return the place of a state."""
        return self.states.index(state)

    def model_text(
        self,
        given: Mapping[str, float],
        bounds: Mapping[str, tuple[float, float]],
        readings: Mapping[str, str],
    ) -> str:
        """Return the model file with given values and readings."""

        def names(items: Sequence[str]) -> str:
            return "[" + ", ".join(f'"{i}"' for i in items) + "]"

        lines = [
            "[model]",
            f'name = "{self.name.replace("_", " ")}"',
            f"states = {names(self.states)}",
            f"inputs = {names(list(self.drives))}",
            f"outputs = {names(list(readings))}",
            f'input_hold = "{self.hold}"',
            "",
            self.tables.strip(),
            "",
            "[readings]",
            *(f'{y} = "{text}"' for y, text in readings.items()),
            "",
            "[parameters]",
        ]
        for name, constant in self.constants.items():
            entry = f"value = {given[name]!r}"
            entry += f', unit = "{constant.unit}"' if constant.unit else ""
            if name in bounds:
                entry += f", bounds = [{bounds[name][0]!r}, {bounds[name][1]!r}]"
            lines.append(f"{name} = {{ {entry} }}")
        return "\n".join(lines) + "\n"


def solved(mass: Sequence[Sequence[Any]], force: Array) -> Array:
    """Solve M a = f in every lane; entries of M are numbers or arrays over the lanes."""
    zero = np.zeros(force.shape[1])
    matrix = np.array([[entry + zero for entry in row] for row in mass])
    return np.linalg.solve(np.moveaxis(matrix, 2, 0), force.T[:, :, None])[:, :, 0].T
