"""Laws with a name, what they are, and laws without one, over the signals of two machines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxsr.models import Model, parse_model

Truth = dict[str, dict[str, float]]
"""Mechanisms of a law with their constants."""

_TEXT = """
[model]
states = ["{q}", "{v}", "p", "s"]
inputs = ["u"]
outputs = ["y"]
[equations]
{q} = "{v}"
{v} = "u - b*{v}"
p = "s"
s = "-b*s"
[inertia]
{v} = {{ {v} = "M" }}
s = {{ s = "M" }}
[readings]
y = "{q}"
[parameters]
b = {{ value = 0.1, unit = "{force}/({speed})", bounds = [0.0, 10.0] }}
M = {{ value = 1.0, unit = "{mass}", bounds = [0.1, 10.0] }}
[units]
{q} = "{way}"
{v} = "{speed}"
p = "{way}"
s = "{speed}"
u = "{force}"
"""


@dataclass(frozen=True, eq=False)
class Machine:
    """A machine's model and signals.

    Attributes
    ----------
    way, speed, time, input : str
        Names of the signals along the first axis.
    unit : str
        Of its forces.
    """

    model: Model
    signals: dict[str, np.ndarray]
    way: str
    speed: str
    unit: str


def machine(kind: str, seed: int, samples: int = 3000) -> Machine:
    """Return a turning joint (rad, N m) or a short slide (m, N), moved by random sines."""
    rng = np.random.default_rng(seed)
    turning = kind == "joint"
    q, v = ("q", "w") if turning else ("x", "v")
    size = 1.5 if turning else 0.02
    units = ("rad", "rad/s", "N*m", "kg*m^2") if turning else ("m", "m/s", "N", "kg")
    names = dict(zip(("way", "speed", "force", "mass"), units, strict=True))
    time = np.linspace(0.0, 20.0, samples)
    signals = {"t": time}
    for way, speed in ((q, v), ("p", "s")):
        lines, phases = rng.uniform(0.5, 6.0, 4), rng.uniform(0.0, 6.28, 4)
        angle = np.multiply.outer(time, lines) + phases
        signals[way] = size * 0.7 * np.sin(angle).sum(1)
        signals[speed] = size * 0.7 * (lines * np.cos(angle)).sum(1)
    signals["u"] = 3.0 * np.sin(np.multiply.outer(time, rng.uniform(0.5, 9.0, 3))).sum(1)
    noisy = {
        n: x if n in "tu" else x + 1e-3 * np.std(x) * rng.normal(size=samples)
        for n, x in signals.items()
    }
    model = parse_model(_TEXT.format(q=q, v=v, **names))
    return Machine(model, noisy, q, v, names["force"])


@dataclass(frozen=True)
class Named:
    """A law with a name: Q, W and U stand for sizes of way, speed and input in its texts.

    Attributes
    ----------
    truth : dict
        Constants as texts of those sizes.
    plain : str
        The law as a mechanism writes it.
    writings : tuple of str
        Other ways.
    """

    truth: dict[str, dict[str, str]]
    plain: str
    writings: tuple[str, ...]


_STRIBECK = {"stribeck_friction": {"Fc": "0.3", "Fs": "0.55", "vs": "0.11*W"}}
_STOP = {"piecewise_stiffness": {"ks": "40/Q", "qs": "1.2*Q"}}
NAMED = (
    Named({"coulomb_friction": {"Fc": "0.41"}}, "-0.41*sign(v)",
          ("-0.41*(Abs(v/(3.4*W))/(v/(3.4*W)))", "-0.41*v/sqrt(v**2)")),
    Named({"coulomb_friction": {"Fc": "0.41"}, "viscous_damping": {"Fv": "0.13/W"}},
          "-0.41*sign(v) - (0.13/W)*v",
          ("-0.41*(v/W)/Abs(v/W) - 0.13*(v/W)", "-v*(0.41/Abs(v) + 0.13/W)")),
    Named({"coulomb_friction": {"Fc": "0.3"}, "constant_force": {"F0": "0.12"}},
          "0.12 - 0.3*sign(v)",
          ("Piecewise((-0.18, v > 0), (0.42, True))", "0.42 - 0.6*Heaviside(v)")),
    Named(_STRIBECK, "-(0.3 + 0.25*exp(-(Abs(v)/(0.11*W))**2))*sign(v)",
          ("-0.3*v/Abs(v) - 0.25*exp(-(v/(0.11*W))**2)*sign(v)",)),
    Named(_STRIBECK, "-(0.3 + 0.25*exp(-Abs(v)/(0.11*W)))*sign(v)",
          ("(0.3 + 0.25/exp(sqrt(v**2)/(0.11*W)))*Abs(v)/(-v)",
           "-sign(v/W)*0.3 - sign(v)*0.25*exp(-9.0909090909090909*Abs(v/W))")),
    Named({"linear_stiffness": {"k1": "2/Q"}, "cubic_stiffness": {"k3": "0.7/Q**3"}},
          "-(2/Q)*q - (0.7/Q**3)*q**3",
          ("-(q/Q)*(2 + 0.7*(q/Q)**2)", "-2*(q/Q) - 0.7*(q/Q)*Abs(q/Q)**2")),
    Named(_STOP, "-(40/Q)*Max(q - 1.2*Q, 0)",
          ("Piecewise((-40*(q/Q - 1.2), q > 1.2*Q), (0, True))",
           "-40*(q/Q - 1.2)*Heaviside(q/Q - 1.2)")),
    Named({"end_stop": {"ks": "40/Q", "cs": "5/(Q*W)", "qs": "1.2*Q"}},
          "-(40/Q + 5/(Q*W)*v)*Max(q - 1.2*Q, 0)",
          ("-(20 + 2.5*v/W)*(q/Q - 1.2 + Abs(q/Q - 1.2))",)),
    Named({"backlash": {"kb": "3/Q", "b": "0.4*Q"}},
          "-(3/Q)*(Max(q - 0.4*Q, 0) + Min(q + 0.4*Q, 0))",
          ("-3*(q/Q - Max(Min(q/Q, 0.4), -0.4))",
           "-3*sign(q)*(Abs(q/Q) - 0.4)*Heaviside(Abs(q/Q) - 0.4)")),
    Named({"quadratic_drag": {"kd": "0.2/W**2"}}, "-(0.2/W**2)*v*Abs(v)",
          ("-0.2*(v/W)**2*sign(v)", "-0.2*(v/W)*sqrt((v/W)**2)")),
    Named({"harmonic_force": {"A": "0.5", "w": "5.3", "phi": "0.9273"}}, "0.5*sin(5.3*t + 0.9273)",
          ("0.4*cos(5.3*t) + 0.3*sin(5.3*t)", "-0.5*cos(5.3*t + 2.4981)")),
    Named({"position_ripple": {"A": "0.3", "n": "6/Q", "phi": "1.0708"}},
          "0.3*sin((6/Q)*q + 1.0708)", ("0.3*cos(6*(q/Q) - 0.5)",)),
    Named({"position_dependent_friction": {"Fc": "0.4", "g1": "0.06/Q"}},
          "-(0.4 + (0.06/Q)*q)*sign(v)", ("-v*(0.4 + 0.06*(q/Q))/Abs(v)",)),
    Named({"power_law_drag": {"kd": "0.2/W**1.5", "p": "1.5"}}, "-(0.2/W**1.5)*sign(v)*Abs(v)**1.5",
          ("-0.2*(v/W)*sqrt(sqrt((v/W)**2))",)),
    Named({"input_saturation": {"us": "1.1*U"}}, "Max(Min(u, 1.1*U), -1.1*U) - u",
          ("-(u - 1.1*U)*Heaviside(u - 1.1*U) - (u + 1.1*U)*Heaviside(-u - 1.1*U)",)),
    Named({"input_deadzone": {"ud": "0.25*U"}}, "-Max(Min(u, 0.25*U), -0.25*U)",
          ("(Abs(u - 0.25*U) - Abs(u + 0.25*U))/2",)),
    Named({"viscous_damping": {"Fv": "0.5/W"}, "asymmetric_friction": {"Fa": "0.2/W"}},
          "-(0.5/W)*v - (0.2/W)*Abs(v)", ("Piecewise((-0.7*v/W, v > 0), (-0.3*v/W, True))",
           "-(v/W)*(0.7*Heaviside(v) + 0.3*Heaviside(-v))")),
    Named({"parametric_excitation": {"kp": "2/Q", "w": "4.1", "phi": "0.3"}},
          "-(2/Q)*q*cos(4.1*t + 0.3)", ("2*(q/Q)*sin(4.1*t - 1.2708)",)),
    Named({"coupling_stiffness": {"kc": "2/Q"}, "coupling_damping": {"cc": "0.3/W"}},
          "-(2/Q)*(q - p) - (0.3/W)*(v - s)", ("2*(p/Q - q/Q) + 0.3*(s - v)/W",)),
    Named({**_STRIBECK, "position_ripple": {"A": "0.3", "n": "6/Q", "phi": "0.5"}},
          "0.3*sin((6/Q)*q + 0.5) - (0.3 + 0.25*exp(-(Abs(v)/(0.11*W))**2))*sign(v)",
          ("0.3*sin(6*(q/Q) + 0.5) - (0.3 + 0.25*exp(-(v/(0.11*W))**2))*v/Abs(v)",)),
)  # fmt: skip

UNNAMED = (
    "cos((v/(3.4*W))**2 + 30)", "-0.4*(v/W)/(1 + (v/W)**2)", "-0.3*tanh(1.3*v/W)",
    "-0.8*(q/Q)**2*(v/W)", "-1.5*(v/W)**2*tanh(3*q/Q)", "-0.5*(q/Q)**5", "0.1*exp(1.1*q/Q)",
    "-2*(q/Q)*exp(-(q/Q)**2)", "-(q/Q)/(0.4 + (q/Q)**4)", "0.3*(q/Q)*(v/W)",
    "-log(1.7 + (v/W)**2)", "0.2*sin(3*q/Q)*(v/W)", "-(q/Q)/sqrt(0.3 + (q/Q)**2)",
    "-0.6*(v/W)*exp(-Abs(q/Q))", "0.4*sin(4*t)*sin(3*q/Q)", "-0.3*(v/W)*Max(q/Q, 0)",
    "0.3*sign(v)", "0.5*sin(0.3*t**2)", "-0.2*(q/Q)**3*(v/W)", "-0.5*atan(2*q/Q)",
)  # fmt: skip
"""The 17th drives where friction must brake; nothing else in the table jumps with the speed."""

__all__ = ["NAMED", "UNNAMED", "Machine", "Named", "Truth", "machine"]
