"""Three bundled models, each written in ten ways that mean the same, with other start values.

What differs: where the mass stands, named expressions, names and order of states, signs of the
axis, other sets of parameters, units or none, values off by up to 50 %, times of nine digits.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

DATASETS = ("emps", "silverbox", "ur10e")
WAYS = 10
OFF = 0.5
"""Largest relative error of a start value."""
DIGITS = 9


@dataclass(frozen=True)
class Way:
    """One way of writing a model.

    Attributes
    ----------
    tables : str
        [definitions], [equations] and [inertia].
    values : dict of str to float
        Parameters whose start values are off.
    fixed : dict of str to float
        Parameters without bounds.
    states : tuple of str
        Displacement and velocity, in the order of the file.
    velocity : str
        The state whose equation is the equation of motion.
    reading : tuple of str
        What the outputs read.
    """

    tables: str
    values: Mapping[str, float]
    fixed: Mapping[str, float] = field(default_factory=dict)
    states: tuple[str, str] = ("q", "v")
    velocity: str = "v"
    reading: tuple[str, ...] = ("q",)


@dataclass(frozen=True)
class Rewriting:
    """A model file, the columns that its recordings need, and the seed of the run."""

    text: str
    columns: Mapping[str, str]  # of the bundled recordings to those of this one
    velocity: str
    seed: int

    def write(self, folder: Path, recordings: list[Path]) -> list[Path]:
        """Write ``model.toml`` and the recordings, times and values to nine digits."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "model.toml").write_text(self.text, encoding="utf-8")
        written = []
        for path in recordings:
            table = pd.read_csv(path)[list(self.columns)].rename(columns=dict(self.columns))
            written.append(folder / path.name)
            table.to_csv(written[-1], index=False, float_format=f"%.{DIGITS}g")
        return written


def rewriting(dataset: str, number: int) -> Rewriting:
    """Return the way of this number, from 0 to 9, of writing a bundled model."""
    way = {"emps": EMPS, "silverbox": SILVERBOX, "ur10e": UR10E}[dataset][number]
    rng = np.random.default_rng([DATASETS.index(dataset), number])
    head, columns = _HEADS[dataset], _COLUMNS[dataset]
    lines = ["[model]", f"states = {json.dumps(way.states)}"]
    lines += [f"{k} = {json.dumps(v)}" for k, v in head.items()]
    lines += [way.tables, "[readings]"]
    outputs = head["outputs"]
    lines += [f'{y} = "{text}"' for y, text in zip(outputs, way.reading, strict=True)]
    lines.append("[parameters]")
    for name, value in way.values.items():
        start = float(f"{value * (1 + OFF * rng.uniform(-1, 1)):.4g}")
        low, high = (value / 8, value * 8) if number % 2 else (value / 3, value * 4)
        lines.append(f"{name} = {{ value = {start!r}, bounds = [{low:.6g}, {high:.6g}] }}")
    lines += [f"{name} = {value!r}" for name, value in way.fixed.items()]
    short = {name: f"c{k}" if number % 2 else name for k, name in enumerate(columns)}
    lines.append("[columns]")
    lines += [f'{role} = "{short[name]}"' for name, role in columns.items()]
    return Rewriting("\n".join(lines) + "\n", short, way.velocity, number % 3)


_HEADS: Mapping[str, dict] = {
    "emps": {"time": "t", "inputs": ["F"], "outputs": ["y"], "input_hold": "linear"},
    "silverbox": {"time": "t", "inputs": ["u"], "outputs": ["r"], "input_hold": "bandlimited"},
    "ur10e": {
        **{"time": "t", "inputs": ["i1", "q2", "q3", "qd2", "qd3"], "input_hold": "linear"},
        "outputs": ["qm", "vm"],
    },
}
_COLUMNS: Mapping[str, dict[str, str]] = {
    "emps": {"time_s": "t", "motor_force_N": "F", "position_m": "y"},
    "silverbox": {"time_s": "t", "input_V": "u", "output_V": "r"},
    "ur10e": {
        **{"t_s": "t", "i1": "i1", "q2": "q2", "q3": "q3", "qd2": "qd2", "qd3": "qd3"},
        **{"q1": "qm", "qd1": "vm"},
    },
}


def _tables(definitions: str, equations: str, inertia: str = "") -> str:
    """Return tables of rows separated by semicolons."""
    parts = (("definitions", definitions), ("equations", equations), ("inertia", inertia))
    lines = []
    for name, rows in parts:
        if rows:
            lines += [f"[{name}]", *(row.strip() for row in rows.split(";"))]
    return "\n".join(lines)


_DRIVE = {"M": 95.0, "d": 200.0}
EMPS = (
    Way(_tables("", 'q = "v"; v = "F - d*v"', 'v = { v = "M" }'), _DRIVE),
    Way(_tables("", 'q = "v"; v = "(F - d*v)/M"'), _DRIVE),
    Way(_tables("", 'q = "v"; v = "F/M - d/M*v"'), _DRIVE),
    Way(_tables('drag = "d*v"', 'q = "v"; v = "F - drag"', 'v = { v = "M" }'), _DRIVE),
    Way(_tables('total = "F - d*v"', 'q = "v"; v = "total/M"'), _DRIVE),
    Way(_tables("", 'q = "v"; v = "a*F - b*v"'), {"a": 1 / 95.0, "b": 200.0 / 95.0}),
    Way(
        _tables("", 'xd = "(F - d*xd)/M"; x = "xd"'),
        _DRIVE,
        states=("xd", "x"),
        velocity="xd",
        reading=("x",),
    ),
    Way(
        _tables('M = "M1 + M2"', 'q = "v"; v = "-d*v + F"', 'v = { v = "M" }'),
        {"M2": 75.0, "d": 200.0},
        {"M1": 20.0},
    ),
    Way(_tables("", 'q = "v"; v = "-(F + d*v)/M"'), _DRIVE, reading=("-q",)),
    Way(_tables("", 'q = "v"; v = "(K*F - v)/T"'), {"K": 1 / 200.0, "T": 95.0 / 200.0}),
)

_CIRCUIT = {"k": 1.9e5, "c": 43.0, "g": 1.87e5}
_MASS = {"m": 1 / 1.87e5, "d": 43.0 / 1.87e5, "s": 1.9 / 1.87}
_RESONANCE = {"w0": 436.0, "z": 0.0493, "G": 1.87 / 1.9}
SILVERBOX = (
    Way(_tables("", 'q = "v"; v = "g*u - c*v - k*q"'), _CIRCUIT),
    Way(_tables("", 'q = "v"; v = "(u - d*v - s*q)/m"'), _MASS),
    Way(_tables("", 'q = "v"; v = "u - d*v - s*q"', 'v = { v = "m" }'), _MASS),
    Way(_tables("", 'q = "v"; v = "w0**2*(G*u - q) - 2*z*w0*v"'), _RESONANCE),
    Way(
        _tables('spring = "k*q"; damper = "c*v"', 'q = "v"; v = "g*u - spring - damper"'), _CIRCUIT
    ),
    Way(
        _tables("", 'rate = "g*u - c*rate - k*level"; level = "rate"'),
        _CIRCUIT,
        states=("rate", "level"),
        velocity="rate",
        reading=("level",),
    ),
    Way(_tables("", 'q = "v"; v = "-g*u - c*v - k*q"'), _CIRCUIT, reading=("-q",)),
    Way(_tables("", 'q = "v"; v = "g*u - (c*v + k*q)"'), _CIRCUIT),
    Way(_tables('f = "u - s*q"', 'q = "v"; v = "f - d*v"', 'v = { v = "m" }'), _MASS),
    Way(_tables('w2 = "w0**2"', 'q = "v"; v = "-w2*(q - G*u) - 2*z*w0*v"'), _RESONANCE),
)

_JOINT = {"Ja": 4.9, "Jb": 4.7, "Jc": 5.0, "Jd": 2.0}
_GAIN = {"K": 10.0}
_ANGLES = 'c2 = "cos(q2)"; c23 = "cos(q2 + q3)"'
_RATES = 'c2_dot = "-sin(q2)*qd2"; c23_dot = "-sin(q2 + q3)*(qd2 + qd3)"'
_J = "Ja + Jb*c2**2 + Jc*c2*c23 + Jd*c23**2"
_J_DOT = "2*Jb*c2*c2_dot + Jc*(c2_dot*c23 + c2*c23_dot) + 2*Jd*c23*c23_dot"
_BOTH = f'{_ANGLES}; {_RATES}; J = "{_J}"; J_dot = "{_J_DOT}"'
_J_DOUBLE = (
    "Ja + Jb/2*(1 + cos(2*q2)) + Jc/2*(cos(q3) + cos(2*q2 + q3)) + Jd/2*(1 + cos(2*q2 + 2*q3))"
)
_J_DOUBLE_DOT = (
    "-Jb*sin(2*q2)*qd2 - Jc/2*(sin(q3)*qd3 + sin(2*q2 + q3)*(2*qd2 + qd3))"
    " - Jd*sin(2*q2 + 2*q3)*(qd2 + qd3)"
)
_DOUBLE = f'J = "{_J_DOUBLE}"; J_dot = "{_J_DOUBLE_DOT}"'


def _joint(tables: str, **options) -> Way:
    return Way(tables, _JOINT, _GAIN, **{"reading": ("q", "v"), **options})


UR10E = (
    _joint(_tables(_BOTH, 'q = "v"; v = "K*i1 - J_dot*v"', 'v = { v = "J" }')),
    _joint(_tables(_BOTH, 'q = "v"; v = "(K*i1 - J_dot*v)/J"')),
    _joint(
        _tables(_ANGLES + "; " + _RATES, f'q = "v"; v = "(K*i1 - ({_J_DOT})*v)/({_J})"'),
    ),
    _joint(
        _tables(
            _ANGLES + "; " + _RATES, f'q = "v"; v = "K*i1 - ({_J_DOT})*v"', f'v = {{ v = "{_J}" }}'
        )
    ),
    _joint(_tables(_DOUBLE, 'q = "v"; v = "K*i1 - J_dot*v"', 'v = { v = "J" }')),
    _joint(_tables(_DOUBLE, 'q = "v"; v = "(K*i1 - J_dot*v)/J"')),
    _joint(
        _tables(
            f'{_BOTH}; torque = "K*i1"; carried = "J_dot*v"',
            'q = "v"; v = "torque - carried"',
            'v = { v = "J" }',
        )
    ),
    _joint(
        _tables(_BOTH, 'w = "(K*i1 - J_dot*w)/J"; th = "w"'),
        states=("w", "th"),
        velocity="w",
        reading=("th", "w"),
    ),
    _joint(
        _tables(_BOTH, 'q = "v"; v = "-K*i1 - J_dot*v"', 'v = { v = "J" }'), reading=("-q", "-v")
    ),
    _joint(_tables(_DOUBLE, 'q = "v"; v = "K*i1/J - J_dot/J*v"')),
)
