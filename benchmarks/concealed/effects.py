"""What an effect is: where it acts, with which constants, and how strong it is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.concealed.systems import System
from benchmarks.concealed.units import NONE, Dims

Array = np.ndarray
E = Mapping[str, Any]

FAMILIES = {
    "parameter": ("wrong_value",),
    "dissipative": (
        "viscous_damping",
        "coulomb_friction",
        "asymmetric_friction",
        "stribeck_friction",
        "position_dependent_friction",
        "quadratic_drag",
        "power_law_drag",
    ),
    "elastic": (
        "linear_stiffness",
        "quadratic_stiffness",
        "cubic_stiffness",
        "piecewise_stiffness",
        "end_stop",
        "backlash",
    ),
    "inertial": ("added_mass", "gravity", "constant_force", "centrifugal_coupling"),
    "coupling": ("coupling_stiffness", "coupling_damping"),
    "periodic": ("harmonic_force", "position_ripple", "parametric_excitation"),
    "memory": ("hysteresis", "actuator_lag", "hidden_mode", "drift", "overflow"),
    "actuator": ("input_saturation", "input_deadzone", "input_gain", "input_delay"),
    "measurement": (
        "sensor_gain",
        "sensor_bias",
        "sensor_delay",
        "clipping",
        "quantisation",
        "clock_skew",
    ),
    "external": ("transient_force",),
    "unnamed": ("unnamed",),
}
FAMILY = {m: family for family, members in FAMILIES.items() for m in members}
VERDICTS = {
    "parameter": "parameter",
    "measurement": "measurement",
    "external": "external_input",
}


def verdict_of(mechanism: str) -> str:
    """Return the verdict that a mechanism stands for (docs/mechanisms.md)."""
    own = {"input_gain": "parameter", "input_delay": "measurement"}
    return own.get(mechanism) or VERDICTS.get(FAMILY[mechanism], "structure")


@dataclass(frozen=True, eq=False)
class Look:
    """What a law may look at: time, motion, inputs and its own states, for runs side by side."""

    t: Any
    q: Array
    v: Array
    u: Array
    z: Array
    p: Mapping[str, Any]
    run: Any  # number of the experiment


@dataclass(frozen=True, eq=False)
class Effect:
    """An effect that the given model leaves out.

    Attributes
    ----------
    mechanism : str
    kind : {"equation", "input", "output", "parameter", "external"}
        Of its site.
    index : int
        Row, drive or sensor.
    values, dims : mappings
        Its constants in SI and their dimensions. A constant of a sensor is in the sensor's
        reading in SI, one of an input in the input's own dimension.
    masters : tuple of str
        Constants that set its size together; see `rising`.
    linear : bool
        Whether its size is proportional to the masters.
    rising : bool
        Whether its size grows with the masters.
    about : float
        Value of the masters at which the effect vanishes, where it grows with them.
    force : callable, optional
        (look, constants) -> generalised forces (n, B) added to the plant's.
    drive : callable, optional
        (look, u, constants) -> the drive's value in place of u.
    inertia : str, optional
        Name of the constant that adds to the row's own inertia.
    delay : str, optional
        Name of the constant that delays the drive or the sensor.
    clock : str, optional
        Name of the constant by which the sensor's clock runs fast.
    reading : callable, optional
        (reading, constants) -> reading.
    extra : int
        States of its own; `rates` gives their derivatives.
    replaces : str, optional
        The plant's constant whose true value the model file does not have.
    rows : tuple of int
        Rows at which it may rightly be reported, where it acts on several.
    shape : tuple of str
        Constants known only up to convention; no interval is checked.
    """

    mechanism: str
    kind: str
    index: int
    values: Mapping[str, float]
    dims: Mapping[str, Dims] = field(default_factory=dict)
    masters: tuple[str, ...] = ()
    linear: bool = True
    rising: bool = True
    about: float = 0.0
    force: Callable[[Look, E], Array] | None = None
    drive: Callable[[Look, Array, E], Array] | None = None
    inertia: str | None = None
    delay: str | None = None
    clock: str | None = None
    reading: Callable[[Array, E], Array] | None = None
    extra: int = 0
    rates: Callable[[Look, E], Array] | None = None
    replaces: str | None = None
    rows: tuple[int, ...] = ()
    shape: tuple[str, ...] = ()

    @property
    def family(self) -> str:
        """Family in docs/mechanisms.md."""
        return FAMILY[self.mechanism]

    @property
    def verdict(self) -> str:
        """Verdict that reporting it implies."""
        return verdict_of(self.mechanism)

    @property
    def sensing(self) -> bool:
        """Whether it acts on a sensor only."""
        return self.kind == "output"

    def with_values(self, values: Mapping[str, float]) -> Effect:
        """Return the effect with other constants."""
        return replace(self, values=dict(values))

    def scaled(self, factor: float) -> Effect:
        """Return the effect with its masters multiplied."""
        c = self.about
        new = {n: c + (x - c) * factor if n in self.masters else x for n, x in self.values.items()}
        return replace(self, values=new)

    def dimension(self, name: str) -> Dims:
        """Dimensions of a constant."""
        return self.dims.get(name, NONE)


@dataclass(frozen=True, eq=False)
class Scene:
    """The undisturbed motion on which an effect is scaled; arrays (rows, samples)."""

    system: System
    p: Mapping[str, float]
    t: Array
    q: Array
    v: Array
    a: Array
    u: Array
    net: Array  # mass times acceleration, (n, samples)
    q0: Array
    length: float  # of a recording, seconds
    count: int  # of experiments to learn from
    omega: float  # rad/s, of the fastest motion of interest

    def rms(self, values: Array) -> float:
        """Root of the mean square."""
        return float(np.sqrt(np.mean(values**2)))

    def q_rms(self, row: int) -> float:
        """Rms of a coordinate about its rest."""
        return self.rms(self.q[row] - self.q0[row])

    def v_rms(self, row: int) -> float:
        """Rms of a velocity."""
        return self.rms(self.v[row])

    def q_max(self, row: int) -> float:
        """Largest deviation of a coordinate from its rest."""
        return float(np.max(np.abs(self.q[row] - self.q0[row])))

    def f_rms(self, row: int) -> float:
        """Rms of the generalised force that accelerates a row."""
        return self.rms(self.net[row])


def on(look: Look, row: int, force: Any) -> Array:
    """Return generalised forces with `force` in one row."""
    out = np.zeros_like(look.q)
    out[row] = force
    return out
