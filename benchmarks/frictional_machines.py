"""Machines whose own model has a law with a corner: dry friction, a stop, play, a limit of a drive.

How such laws of the given model are integrated was settled before, on a conveyor like that of
`SEEN`; no rule came of these or of `HELD_OUT`.
"""

from __future__ import annotations

from benchmarks.machine_models import free, model_text
from benchmarks.unread_machines import Machine

SEEN = {
    "conveyor": Machine(
        model_text(
            {"x": "v", "v": "(F - f*sign(v) - b*v)/2"},
            '"F"',
            {"encoder": "x"},
            {"f": free(1.5, 0.1, 6.0), "b": free(1.2, 0.1, 6.0)},
        ),
        *("v", "- 0.8*v*Abs(v)", "quadratic_drag", 0.01, 5.0, (0.0, 0.0)),
    ),
    "end stop": Machine(
        model_text(
            {"x": "v", "v": "(F - k*x - c*v - s*Max(x - 0.25, 0))/2"},
            '"F"',
            {"y": "x"},
            {"k": free(20.0, 5.0, 60.0), "c": free(0.8, 0.0, 5.0), "s": free(400.0, 50.0, 2000.0)},
        ),
        *("v", "- 0.9*sign(v)", "coulomb_friction", 0.02, 9.0, (0.2, 0.0)),
    ),
    "pendulum with a dry bearing": Machine(
        model_text(
            {"q": "w", "w": "(M - 9.81*m*sin(q) - f*tanh(w/0.01) - c*w)/m"},
            '"M"',
            {"angle": "q", "gyro": "w"},
            {"m": free(1.0, 0.2, 3.0), "f": free(0.4, 0.0, 3.0), "c": free(0.15, 0.0, 2.0)},
        ),
        *("w", "- 2.5*q**3", "cubic_stiffness", 0.01, 4.0, (0.8, 0.0)),
    ),
    "motor with brushes": Machine(
        model_text(
            {"i": "(U - r*i - 0.08*w)/0.004", "w": "(0.08*i - f*sign(w) - b*w)/0.0006"},
            '"U"',
            {"current": "i", "speed": "w"},
            {
                "r": free(1.2, 0.3, 5.0),
                "f": free(0.02, 0.0, 0.1),
                "b": free(0.0006, 0.0, 0.01),
            },
        ),
        *("w", "- 0.05*w*Abs(w)", "quadratic_drag", 0.002, 8.0, (0.0, 0.0)),
    ),
}
HELD_OUT = {
    "slide with a Stribeck curve": Machine(
        model_text(
            {"x": "v", "v": "(F - (f + g*exp(-(v/0.15)**2))*sign(v) - b*v)/3"},
            '"F"',
            {"scale": "x", "tacho": "v"},
            {"f": free(2.0, 0.2, 8.0), "g": free(1.2, 0.0, 6.0), "b": free(3.0, 0.3, 12.0)},
        ),
        *("v", "- 12*x", "linear_stiffness", 0.01, 8.0, (0.05, 0.0)),
    ),
    "two masses that rub": Machine(
        model_text(
            {
                "x1": "v1",
                "x2": "v2",
                "v1": "(F - k*x1 - f*sign(v1 - v2))/1.5",
                "v2": "(f*sign(v1 - v2) - 40*x2 - c*v2)/0.8",
            },
            '"F"',
            {"y1": "x1", "y2": "x2"},
            {"k": free(60.0, 20.0, 200.0), "f": free(1.5, 0.1, 6.0), "c": free(0.6, 0.0, 5.0)},
        ),
        *("v1", "- 900*x1**3", "cubic_stiffness", 0.01, 12.0, (0.1, 0.0, 0.0, 0.0)),
    ),
    "gear with play": Machine(
        model_text(
            {
                "a": "u",
                "b": "w",
                "u": "(M - c*u - k*(Max(a - b - 0.05, 0) - Max(b - a - 0.05, 0)))/0.2",
                "w": "(k*(Max(a - b - 0.05, 0) - Max(b - a - 0.05, 0)) - d*w)/0.5",
            },
            '"M"',
            {"motor": "a", "load": "b"},
            {"k": free(30.0, 5.0, 120.0), "c": free(0.3, 0.0, 2.0), "d": free(0.4, 0.0, 2.0)},
        ),
        *("w", "- 0.6*sign(w)", "coulomb_friction", 0.01, 2.5, (0.0, 0.0, 0.0, 0.0)),
    ),
    "spool against its ends": Machine(
        model_text(
            {
                "x": "v",
                "v": "(F - k*x - c*v - s*Max(x - 0.3, 0) + s*Max(-x - 0.2, 0) - f*sign(v))/1.2",
            },
            '"F"',
            {"lvdt": "x"},
            {
                "k": free(15.0, 3.0, 60.0),
                "c": free(1.0, 0.0, 6.0),
                "s": free(300.0, 50.0, 2000.0),
                "f": free(0.5, 0.0, 4.0),
            },
        ),
        *("v", "- 1.0*v*Abs(v)", "quadratic_drag", 0.015, 8.0, (0.1, 0.0)),
    ),
    "saturated servo": Machine(
        model_text(
            {"q": "w", "w": "(Min(Max(g*u, -3), 3) - d*w - f*sign(w))/0.4"},
            '"u"',
            {"angle": "q"},
            {"g": free(4.0, 1.0, 12.0), "d": free(0.8, 0.1, 4.0), "f": free(0.3, 0.0, 2.0)},
        ),
        *("w", "- 2.0*sin(q)", "gravity", 0.01, 0.9, (0.3, 0.0)),
    ),
    "joint of a robot": Machine(
        model_text(
            {"q": "w", "w": "(M - g*sin(q) - f*sign(w) - e - b*w)/I"},
            '"M"',
            {"resolver": "q", "rate": "w"},
            {
                "I": free(0.9, 0.2, 3.0),
                "g": free(6.0, 1.0, 20.0),
                "f": free(0.8, 0.0, 4.0),
                "e": free(0.3, -2.0, 2.0),
                "b": free(0.5, 0.0, 4.0),
            },
        ),
        *("w", "- 0.4*w*Abs(w)", "quadratic_drag", 0.008, 7.0, (0.2, 0.0)),
    ),
}
MACHINES = {**SEEN, **HELD_OUT}
