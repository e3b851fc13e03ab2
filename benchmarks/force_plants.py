"""Plants whose equation of motion is written in four ways, for ``benchmarks.force_units``.

Each lacks one force of known size. A force law is text in the model grammar; what is recorded is
solved from it by LSODA at rtol 1e-9, inputs linear between samples, sign(v) as tanh(v/w) with w a
10,000th of the speed's scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from jaxsr.expressions import parse, to_numpy
from jaxsr.models import Model, parse_model
from jaxsr.recordings import Recording

WAYS = ("divided", "inertia", "definitions", "normalised")
SAMPLES, STEP = 300, 0.02
NOISE = 2e-4
"""Noise of a sensor over the standard deviation of what it reads."""
WIDTH = 1e-4


@dataclass(frozen=True)
class Plant:
    """An axis: inertia times acceleration is a known force and a missing one.

    Attributes
    ----------
    known : tuple of str
        Signed summands of the known force, in q, v, u and the parameters.
    inertia : str
        In the parameters.
    parameters : mapping
        Name to value and unit; those of the inertia are free, the others as well.
    missing : str
        Signed summand that the model lacks.
    mechanism, constant : str
        What it is called, and its constant.
    value, unit : float, str
        Of that constant.
    drive : float
        Size of the input; its unit is `input_unit`.
    """

    name: str
    turning: bool
    known: tuple[str, ...]
    inertia: str
    parameters: dict[str, tuple[float, str]]
    missing: str
    mechanism: str
    constant: str
    value: float
    unit: str
    drive: float
    input_unit: str
    mass_unit: str = "kg"

    def truth(self, way: str) -> tuple[float, str]:
        """Return the constant and its unit as a way of writing shows them."""
        if way != "normalised":
            return self.value, self.unit
        return self.value / self.mass, f"({self.unit})/({self.mass_unit})"

    @property
    def force_unit(self) -> str:
        """Unit of the forces in the bracket."""
        return "N*m" if self.turning else "N"

    @property
    def mass(self) -> float:
        """Value of the inertia."""
        values = {n: v for n, (v, _) in self.parameters.items()}
        return float(to_numpy(parse(self.inertia))(values))

    def model(self, way: str) -> Model:
        """Return the model without the missing force, its values a little off."""
        length = "rad" if self.turning else "m"
        speed = f"{length}/s"
        units = {"q": length, "v": speed, "u": self.input_unit, "y": length, "w": speed}
        lines = ['[model]\nname = "plant"\nstates = ["q", "v"]\ninputs = ["u"]']
        lines.append('outputs = ["y", "w"]')
        force = _joined(self.known)
        parameters = {
            n: (0.85 * v if n in _names(self.inertia) else 1.2 * v, unit, True)
            for n, (v, unit) in self.parameters.items()
        }
        for name in {"N", "Jm", "K"} & parameters.keys():  # nothing tells them from J
            parameters[name] = (*self.parameters[name], False)
        inertia = ""
        if way == "divided":
            equation = f"({force})/({self.inertia})"
        elif way == "inertia":
            equation, inertia = force, f'[inertia]\nv = {{ v = "{self.inertia}" }}'
        elif way == "definitions":
            first, rest = self.known[0], self.known[1:]
            lines.append(f'[definitions]\ndrive = "{_joined((first,))}"\nJall = "{self.inertia}"')
            equation = f"(drive {' '.join(rest)})/Jall"
        else:  # every coefficient is per unit of inertia, the input recorded as what it brings
            equation, own = self._normalised()
            parameters = own
            units["u"] = f"{length}/s^2"
        lines.append(f'[equations]\nq = "v"\nv = "{equation}"')
        lines += [inertia, '[readings]\ny = "q"\nw = "v"', "[parameters]"]
        for name, (value, unit, free) in parameters.items():
            low, high = sorted((0.2 * value, 5.0 * value))
            bounds = f", bounds = [{low:.6g}, {high:.6g}]" if free else ""
            lines.append(f'{name} = {{ value = {value:.6g}, unit = "{unit}"{bounds} }}')
        lines += ["[units]", *(f'{n} = "{u}"' for n, u in units.items())]
        return parse_model("\n".join(lines))

    def _normalised(self) -> tuple[str, dict[str, tuple[float, str, bool]]]:
        """Return the known force per inertia, the input apart, and the parameters it has left."""
        parts, own = ["u"], {}
        for summand in self.known[1:]:
            sign, body = summand[0], summand[2:]
            name, _, rest = body.partition("*")
            value, unit = self.parameters[name]
            own[f"{name}m"] = (1.2 * value / self.mass, f"({unit})/({self.mass_unit})", True)
            parts.append(f"{sign} {name}m*{rest}")
        return " ".join(parts), own

    def recordings(self, way: str, seed: int) -> list[Recording]:
        """Return two recordings; seeds tell phases and noise."""
        rng = np.random.default_rng(seed)
        return [self._run(way, rng, f"run{k}.csv", 1.0 + 0.4 * k) for k in range(2)]

    def _run(self, way: str, rng: np.random.Generator, name: str, size: float) -> Recording:
        t = STEP * np.arange(SAMPLES)
        pace = rng.uniform(1.0, 7.0, 4)
        wave = np.sin(np.multiply.outer(t, pace) + rng.uniform(0.0, 6.28, 4)).sum(1) / 2.0
        u = self.drive * size * wave
        values = {n: v for n, (v, _) in self.parameters.items()} | {self.constant: self.value}
        text = _joined((*self.known, self.missing)).replace("sign(v)", f"tanh(v/{WIDTH})")
        force = to_numpy(parse(f"({text})/({self.inertia})"))

        def rate(at: float, x: np.ndarray) -> list[float]:
            own = {"q": x[0], "v": x[1], "u": np.interp(at, t, u), "t": at}
            return [x[1], float(force({**values, **own}))]

        found = solve_ivp(
            rate, (0.0, t[-1]), [0.1, 0.0], "LSODA", t, rtol=1e-9, atol=1e-11, max_step=STEP
        )
        q, v = found.y
        y, w = (a + NOISE * a.std() * rng.normal(size=a.size) for a in (q, v))
        if way == "normalised":
            first = to_numpy(parse(_joined(self.known[:1])))
            u = np.asarray(first({**values, "u": u})) / self.mass
        return Recording(name, t, {"u": u, "y": y, "w": w})


def _joined(summands: tuple[str, ...]) -> str:
    return " ".join(summands).removeprefix("+ ").replace("- ", "-", summands[0][0] == "-")


def _names(text: str) -> frozenset[str]:
    return parse(text).variables


COULOMB = "- Fc*sign(v)", "coulomb_friction", "Fc"
DRAG = "- kd*v*Abs(v)", "quadratic_drag", "kd"
CUBIC = "- k3*q**3", "cubic_stiffness", "k3"
SPRING = "- k1*q", "linear_stiffness", "k1"
STEADY = "+ F0", "constant_force", "F0"
VISCOUS = "- Fv*v", "viscous_damping", "Fv"

_J = {"J": (0.05, "kg*m^2")}
_TORQUE = {"b": (0.08, "N*m*s/rad")}
PLANTS = (
    Plant("cart", False, ("+ u", "- d*v"), "m", {"m": (2.0, "kg"), "d": (1.5, "N*s/m")},
          *COULOMB, 1.2, "N", 6.0, "N"),
    Plant("servo", True, ("+ u", "- b*v"), "J", _J | _TORQUE, *COULOMB, 0.06, "N*m", 0.3, "N*m",
          "kg*m^2"),
    Plant("pendulum", True, ("+ u", "- G*sin(q)", "- b*v"), "J",
          _J | {"b": (0.05, "N*m*s/rad"), "G": (0.9, "N*m")}, *COULOMB, 0.07, "N*m", 0.6, "N*m",
          "kg*m^2"),
    Plant("sprung mass", False, ("+ u", "- k*q", "- d*v"), "m",
          {"m": (1.5, "kg"), "k": (30.0, "N/m"), "d": (0.8, "N*s/m")}, *CUBIC, 60.0, "N/m^3", 12.0,
          "N"),
    Plant("sled in water", False, ("+ u", "- d*v"), "m", {"m": (8.0, "kg"), "d": (3.0, "N*s/m")},
          *DRAG, 9.0, "N*s^2/m^2", 30.0, "N"),
    # Not looked at while the reading of factors was written:
    Plant("geared motor", True, ("+ K*u", "- b*v"), "J + N**2*Jm",
          {"J": (0.03, "kg*m^2"), "N": (5.0, "1"), "Jm": (4e-4, "kg*m^2"), "K": (0.2, "N*m/A"),
           "b": (0.05, "N*m*s/rad")}, *COULOMB, 0.08, "N*m", 2.0, "A", "kg*m^2"),
    Plant("valve flap", True, ("+ u", "- b*v"), "J", _J | _TORQUE, *SPRING, 0.5, "N*m/rad", 0.4,
          "N*m", "kg*m^2"),
    Plant("table on a slope", False, ("+ u", "- d*v"), "m",
          {"m": (3.0, "kg"), "d": (4.0, "N*s/m")}, *STEADY, 2.0, "N", 9.0, "N"),
    Plant("swing arm", True, ("+ u", "- G*sin(q)"), "J", _J | {"G": (0.6, "N*m")}, *VISCOUS, 0.06,
          "N*m*s/rad", 0.5, "N*m", "kg*m^2"),
    Plant("fan rotor", True, ("+ u", "- b*v"), "J", _J | {"b": (0.03, "N*m*s/rad")}, *DRAG, 0.02,
          "N*m*s^2/rad^2", 0.5, "N*m", "kg*m^2"),
)  # fmt: skip
