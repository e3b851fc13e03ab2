"""A rigid-body model of a serial arm, written as a model file from its URDF.

Every quantity stands in the coordinates of its own link, whose origin lies on the joint. With
r the place in a link and dm the mass there, a link is known by

    m = int dm,    h = int r dm,    S = int r r' dm,    inertia about the origin I = tr(S) 1 - S.

The forces of motion come from the recursive Newton-Euler method with zero joint accelerations,
the mass matrix from composite bodies: a link and all that it carries, as if they were one.

References
----------
Siciliano, Sciavicco, Villani & Oriolo, Robotics (2009), section 7.5 (Newton-Euler).
Featherstone, Rigid Body Dynamics Algorithms (2008), section 6.2 (composite bodies).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from jaxsr.datasets.drives import Drive, currents, parameter
from jaxsr.datasets.urdf import SNAP, Body, read_arm, turned
from jaxsr.models.formats.script import (
    CROSS,
    Matrix,
    Poly,
    Script,
    Vector,
    added,
    applied,
    cross,
    dot,
    matmul,
    minus,
    number,
    plus,
    text_of,
    times,
    transposed,
)

GRAVITY = 9.81
SPREAD = 0.5
"""Share of a link's mass by which re-calibration may change it."""


def arm_model(
    urdf: str, name: str, gains: Sequence[float], columns: Mapping[str, str] | None = None
) -> str:
    """Write the model file of an arm whose joints are driven by motor currents.

        K_k i_k = sum_j M_kj(q) dv_j/dt + Ia_k dv_k/dt + load_k(q, v)

    Parameters
    ----------
    urdf : str
        Text of a URDF. Its first link stands upright; gravity points along its -z.
    name : str
        Of the model.
    gains : sequence of float
        Torque per current at each joint, in N m/A.
    columns : mapping of str to str, optional
        Columns of the recordings, by their role in the model.

    Returns
    -------
    str
        States q1.. and v1.., inputs i1.., outputs q1_meas.. and v1_meas..; free are the links'
        masses, with centre and shape as the URDF has them, and the drives' inertias Ia1...
    """
    return write_arm(read_arm(urdf), currents(gains), name, columns, rates=True)


def write_arm(
    bodies: Sequence[Body],
    drives: Sequence[Drive],
    name: str,
    columns: Mapping[str, str] | None = None,
    *,
    rates: bool = False,
    fixed_masses: bool = False,
) -> str:
    """Write the model file of a chain of rigid bodies, each turned by a drive.

        force_k = sum_j M_kj(q) dv_j/dt + Ia_k dv_k/dt + load_k(q, v)

    Parameters
    ----------
    bodies : sequence of Body
        The first one first. Gravity points along -z of what carries it.
    drives : sequence of Drive
        One a body.
    name : str
        Of the model.
    columns : mapping of str to str, optional
        Columns of the recordings, by their role in the model.
    rates : bool
        Whether the joints' speeds are measured beside their angles.
    fixed_masses : bool
        Whether re-calibration leaves the links' masses alone.

    Returns
    -------
    str
        States q1.. and v1.., outputs q1_meas.. and, with `rates`, v1_meas...
    """
    numbers = range(1, len(bodies) + 1)
    arm = _Arm(bodies)
    loads, mass = arm.loads(), arm.mass_matrix()
    equations = {f"q{k}": f"v{k}" for k in numbers}
    equations |= {f"v{k}": f"{drives[k - 1].force} - ({text_of(loads[k - 1])})" for k in numbers}
    rows = {
        f"v{j}": {f"v{k}": text_of(mass[j - 1][k - 1]) for k in numbers if mass[j - 1][k - 1]}
        for j in numbers
    }
    for k in numbers:
        own = rows[f"v{k}"].get(f"v{k}", "")
        rows[f"v{k}"][f"v{k}"] = f"{own} + Ia{k}" if own else f"Ia{k}"
    used = [*equations.values(), *(text for row in rows.values() for text in row.values())]
    measured = [("q", "rad"), ("v", "rad/s")][: 2 if rates else 1]
    readings = {f"{q}{k}_meas": f"{q}{k}" for q, _ in measured for k in numbers}
    inputs = {key: unit for drive in drives for key, unit in drive.inputs.items()}
    units = {f"{q}{k}": u for q, u in (("q", "rad"), ("v", "rad/s")) for k in numbers}
    units |= {f"{q}{k}_meas": u for q, u in measured for k in numbers} | inputs
    lists = {"states": [*equations], "inputs": [*inputs], "outputs": [*readings]}
    lines = ["[model]", f'name = "{name}"', 'time = "t"']
    lines += [f"{key} = [{', '.join(_quoted(names))}]" for key, names in lists.items()]
    lines += ['input_hold = "linear"', ""]
    lines += _table("definitions", arm.script.needed(used)) + _table("equations", equations)
    lines += ["[inertia]"]
    for row, entries in rows.items():
        inner = ", ".join(f'{key} = "{text}"' for key, text in entries.items())
        lines.append(f"{row} = {{ {inner} }}")
    lines += ["", *_table("readings", readings), "[parameters]"]
    lines += [line for drive in drives for line in drive.parameters]
    lines += _masses(bodies, fixed_masses)
    lines += [
        parameter(f"Ia{k}", drive.rotor, "kg*m^2", 0.0, drive.heaviest)
        for k, drive in enumerate(drives, start=1)
    ]
    lines += [parameter("g", GRAVITY, "m/s^2"), parameter("metre", 1.0, "m"), ""]
    lines += _table("units", units) + (_table("columns", dict(columns)) if columns else [])
    return "\n".join(lines)


def _masses(bodies: Sequence[Body], fixed: bool) -> list[str]:
    """Return the links' masses; a link without mass has no parameter."""
    # A first link that turns about the vertical does nothing but add to its drive's inertia.
    idle = abs((bodies[0].turn @ bodies[0].axis)[2]) > 1.0 - SNAP
    lines = []
    for k, mass in enumerate((body.mass for body in bodies), start=1):
        reach = 0.0 if fixed or (idle and k == 1) else SPREAD * mass
        if mass:
            lines.append(parameter(f"m{k}", mass, "kg", *_around(mass, reach)))
    return lines


def _quoted(texts: Iterable[str]) -> list[str]:
    return [f'"{text}"' for text in texts]


def _table(name: str, entries: dict[str, str]) -> list[str]:
    return [f"[{name}]", *(f'{key} = "{text}"' for key, text in entries.items()), ""]


def _around(value: float, reach: float) -> tuple[float, ...]:
    """Return bounds at a distance, none for no distance."""
    return (value - reach, value + reach) if reach else ()


class _Arm:
    """The mechanics of an arm, written into a script link by link."""

    def __init__(self, bodies: Sequence[Body]) -> None:
        self.script = Script()
        self.bodies = list(bodies)
        self.axes = [[number(a) for a in body.axis] for body in bodies]
        self.places = [[number(p, "metre") for p in body.place] for body in bodies]
        self.turns = [self._turn(k, body) for k, body in enumerate(bodies, start=1)]
        self.masses, self.moments, self.spreads = [], [], []
        for k, body in enumerate(bodies, start=1):
            m, share = f"m{k}", body.mass or 1.0
            self.masses.append(number(float(body.mass > 0.0), m))
            self.moments.append([number(h / share, m, "metre") for h in body.moment])
            self.spreads.append(
                [[number(s / share, m, "metre", "metre") for s in row] for row in body.spread]
            )

    def _turn(self, k: int, body: Body) -> Matrix:
        """Return the rotation from a link's coordinates to those of the link before."""
        self.script.name(f"c{k}", {(f"cos(q{k})",): 1.0}, always=True)
        self.script.name(f"s{k}", {(f"sin(q{k})",): 1.0}, always=True)
        still, cosine, sine = (
            body.turn @ turned(body.axis, *cs) for cs in ((0, 0), (1, 0), (0, 1))
        )
        return [
            [
                plus(
                    number(still[i, j]),
                    number(cosine[i, j] - still[i, j], f"c{k}"),
                    number(sine[i, j] - still[i, j], f"s{k}"),
                )
                for j in range(3)
            ]
            for i in range(3)
        ]

    def loads(self) -> Vector:
        """Return the joint torques that hold the arm's motion at zero joint accelerations."""
        script, forces, moments = self.script, [], []
        nothing: Vector = [{}, {}, {}]
        w, e, a = nothing, nothing, [{}, {}, number(1.0, "g")]
        swirl: Matrix = [nothing] * 3
        for k, axis in enumerate(self.axes, start=1):
            back = transposed(self.turns[k - 1])
            a = script.vector(f"b{k}", added(a, applied(swirl, self.places[k - 1])))
            a = script.vector(f"a{k}", applied(back, a))
            carried = script.vector(f"u{k}", applied(back, w))
            rate = [times(part, number(1.0, f"v{k}")) for part in axis]
            w = script.vector(f"w{k}", added(carried, rate))
            e = script.vector(f"e{k}", added(applied(back, e), cross(carried, rate)))
            swirl = self._swirl(k, w, e)
            h, spread = self.moments[k - 1], self.spreads[k - 1]
            inertial = [times(self.masses[k - 1], part) for part in a]
            forces.append(added(inertial, applied(swirl, h)))
            turning = matmul(spread, transposed(swirl))
            axial = [plus(turning[i][j], minus(turning[j][i])) for _, i, j in CROSS]
            moments.append(added(cross(h, a), axial))
        loads: Vector = []
        f, n = nothing, nothing
        for k in range(len(self.bodies), 0, -1):
            f, n = added(forces[k - 1], f), added(moments[k - 1], n)
            f, n = script.vector(f"f{k}", f), script.vector(f"n{k}", n)
            loads.append(dot(self.axes[k - 1], n))
            f, n = self._handed_down(k, f, n, "r")
        return loads[::-1]

    def _swirl(self, k: int, w: Vector, e: Vector) -> Matrix:
        """Return B of the acceleration B r of a place r: [e]x + w w' - |w|^2 1."""
        swirl = [[times(w[i], w[j]) for j in range(3)] for i in range(3)]
        squares = [swirl[i][i] for i in range(3)]
        for axis, i, j in CROSS:
            swirl[axis][axis] = minus(plus(squares[i], squares[j]))
            swirl[j][i] = plus(swirl[j][i], e[axis])
            swirl[i][j] = plus(swirl[i][j], minus(e[axis]))
        return self.script.rows(f"B{k}", swirl)

    def _handed_down(self, k: int, f: Vector, n: Vector, tag: str) -> tuple[Vector, Vector]:
        """Return a force and a moment about the joint of link k as the link before feels them."""
        f = self.script.vector(f"{tag}f{k}", applied(self.turns[k - 1], f))
        n = added(applied(self.turns[k - 1], n), cross(self.places[k - 1], f))
        return f, n

    def mass_matrix(self) -> Matrix:
        """Return the mass matrix, drives apart."""
        count, script = len(self.bodies), self.script
        matrix: Matrix = [[{} for _ in range(count)] for _ in range(count)]
        m: Poly = {}
        h: Vector = [{}, {}, {}]
        spread: Matrix = [[{}, {}, {}] for _ in range(3)]
        for k in range(count, 0, -1):
            axis, turn, place = self.axes[k - 1], self.turns[k - 1], self.places[k - 1]
            m = script.name(f"C{k}", plus(self.masses[k - 1], m))
            h = script.vector(f"H{k}", added(self.moments[k - 1], h))
            spread = [added(a, b) for a, b in zip(self.spreads[k - 1], spread, strict=True)]
            spread = script.symmetric(f"S{k}", spread)
            trace = plus(*(spread[i][i] for i in range(3)))
            f = script.vector(f"F{k}{k}", cross(axis, h))
            n = added([times(trace, a) for a in axis], [minus(x) for x in applied(spread, axis)])
            for j in range(k, 0, -1):
                n = script.vector(f"N{k}{j}", n)
                entry = dot(self.axes[j - 1], n)
                matrix[j - 1][k - 1] = matrix[k - 1][j - 1] = script.name(f"M{j}{k}", entry)
                f, n = self._handed_down(j, f, n, f"R{k}")
            # What link k carries, seen from the link before.
            h = script.vector(f"T{k}", applied(turn, h))
            across = [[times(a, b) for b in place] for a in h]
            shift = [[times(m, a, b) for b in place] for a in place]
            half = script.rows(f"U{k}", matmul(turn, spread))
            spread = matmul(half, transposed(turn))
            parts = zip(spread, across, transposed(across), shift, strict=True)
            spread = [added(*rows) for rows in parts]
            h = added(h, [times(m, p) for p in place])
        return matrix
