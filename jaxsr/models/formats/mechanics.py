"""Equations of motion of a tree of links, written as definitions of a model file.

Every quantity stands in the coordinates of its own link (`Link`). The forces of motion come from
the recursive Newton-Euler method with zero joint accelerations, the mass matrix from composite
bodies: a link and all that it carries, as if they were one.

References
----------
Featherstone, Rigid Body Dynamics Algorithms (2008), table 5.1 (Newton-Euler) and section 6.2
(composite bodies).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr.models.formats.links import Link
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
    times,
    transposed,
)

NOTHING: Vector = [{}, {}, {}]
Motion = tuple[Vector, Vector, Vector, Matrix]
"""Of a link at zero joint accelerations: angular rate w and its rate e, acceleration a of its
origin less gravity, and B of the acceleration B r of a place r."""


class Mechanics:
    """The mechanics of a tree, written into a script link by link.

    Parameters
    ----------
    links : sequence of Link
        Parents first.
    positions, rates, masses : sequence of str
        Symbols of the joints' positions and rates and of the links' masses (one a link).
    gravity : ndarray, shape (3,)
        Direction of gravity times the share of the symbol ``g``; zeros for none.
    """

    def __init__(
        self,
        links: Sequence[Link],
        positions: Sequence[str],
        rates: Sequence[str],
        masses: Sequence[str],
        gravity: np.ndarray,
    ) -> None:
        self.script = Script()
        self.links, self.rates, self.gravity = list(links), list(rates), gravity
        self.axes: list[Vector] = [[number(a) for a in link.axis] for link in links]
        self.turns: list[Matrix] = []
        self.places: list[Vector] = []
        for k, (link, q) in enumerate(zip(links, positions, strict=True), start=1):
            moved = f"({q} - {link.reference!r})" if link.reference else q
            self._frame(k, link, moved)
        self.motion: list[Motion] = []
        self.masses: list[Poly] = []
        self.moments: list[Vector] = []
        self.spreads: list[Matrix] = []
        for link, m in zip(links, masses, strict=True):
            share = link.mass or 1.0
            self.masses.append(number(float(link.mass > 0.0), m))
            self.moments.append([number(h / share, m, "metre") for h in link.moment])
            self.spreads.append(
                [[number(s / share, m, "metre", "metre") for s in row] for row in link.spread]
            )

    def _frame(self, k: int, link: Link, moved: str) -> None:
        """Write place and orientation of a link in coordinates of its parent."""
        place: Vector = [number(p, "metre") for p in link.place]
        if link.slides:
            along = link.turn @ link.axis
            shift = self.script.name(f"d{k}_", {(moved,): 1.0}, always="(" in moved)
            place = added(place, [times(number(a), shift) for a in along])
            self.turns.append([[number(entry) for entry in row] for row in link.turn])
            self.places.append(place)
            return
        c, s = f"c{k}_", f"s{k}_"
        self.script.name(c, {(f"cos{_bracketed(moved)}",): 1.0}, always=True)
        self.script.name(s, {(f"sin{_bracketed(moved)}",): 1.0}, always=True)
        still = link.turn @ np.outer(link.axis, link.axis)
        skew = np.cross(np.eye(3), link.axis)  # [axis]x
        parts = still, link.turn - still, link.turn @ skew
        self.turns.append(
            [
                [
                    plus(
                        number(parts[0][i, j]), number(parts[1][i, j], c), number(parts[2][i, j], s)
                    )
                    for j in range(3)
                ]
                for i in range(3)
            ]
        )
        self.places.append(place)

    def loads(self) -> Vector:
        """Return the joint forces that hold the motion at zero joint accelerations."""
        script, count = self.script, len(self.links)
        motion = self.motion
        forces: list[Vector] = []
        moments: list[Vector] = []
        base = (NOTHING, NOTHING, [number(-x, "g") for x in self.gravity], [NOTHING] * 3)
        for k, link in enumerate(self.links, start=1):
            w, e, a, swirl = base if link.parent is None else motion[link.parent]
            back, axis = transposed(self.turns[k - 1]), self.axes[k - 1]
            a = script.vector(f"b{k}_", added(a, applied(swirl, self.places[k - 1])))
            a = applied(back, a)
            carried = script.vector(f"u{k}_", applied(back, w))
            rate = [times(part, number(1.0, self.rates[k - 1])) for part in axis]
            if link.slides:
                twice = [times(number(2.0), x) for x in cross(carried, rate)]
                a, w = added(a, twice), carried
                e = script.vector(f"e{k}_", applied(back, e))
            else:
                w = script.vector(f"w{k}_", added(carried, rate))
                e = script.vector(f"e{k}_", added(applied(back, e), cross(carried, rate)))
            a = script.vector(f"a{k}_", a)
            swirl = self._swirl(k, w, e)
            motion.append((w, e, a, swirl))
            h, spread = self.moments[k - 1], self.spreads[k - 1]
            inertial = [times(self.masses[k - 1], part) for part in a]
            forces.append(added(inertial, applied(swirl, h)))
            turning = matmul(spread, transposed(swirl))
            axial = [plus(turning[i][j], minus(turning[j][i])) for _, i, j in CROSS]
            moments.append(added(cross(h, a), axial))
        loads: Vector = [{} for _ in range(count)]
        for k in range(count, 0, -1):
            link = self.links[k - 1]
            f, n = script.vector(f"f{k}_", forces[k - 1]), script.vector(f"n{k}_", moments[k - 1])
            loads[k - 1] = dot(self.axes[k - 1], f if link.slides else n)
            if link.parent is not None:
                f, n = self._handed_down(k, f, n, "r")
                forces[link.parent] = added(forces[link.parent], f)
                moments[link.parent] = added(moments[link.parent], n)
        return loads

    def _swirl(self, k: int, w: Vector, e: Vector) -> Matrix:
        """Return B of the acceleration B r of a place r: [e]x + w w' - |w|^2 1."""
        swirl = [[times(w[i], w[j]) for j in range(3)] for i in range(3)]
        squares = [swirl[i][i] for i in range(3)]
        for axis, i, j in CROSS:
            swirl[axis][axis] = minus(plus(squares[i], squares[j]))
            swirl[j][i] = plus(swirl[j][i], e[axis])
            swirl[i][j] = plus(swirl[i][j], minus(e[axis]))
        return self.script.rows(f"B{k}_", swirl)

    def _handed_down(self, k: int, f: Vector, n: Vector, tag: str) -> tuple[Vector, Vector]:
        """Return a force and a moment about the origin of link k as its parent feels them."""
        f = self.script.vector(f"{tag}f{k}_", applied(self.turns[k - 1], f))
        n = added(applied(self.turns[k - 1], n), cross(self.places[k - 1], f))
        return f, n

    def mass_matrix(self) -> Matrix:
        """Return the mass matrix, armatures apart."""
        count, script = len(self.links), self.script
        matrix: Matrix = [[{} for _ in range(count)] for _ in range(count)]
        masses, moments, spreads = list(self.masses), list(self.moments), list(self.spreads)
        for k in range(count, 0, -1):
            link, axis = self.links[k - 1], self.axes[k - 1]
            m = script.name(f"C{k}_", masses[k - 1])
            h = script.vector(f"H{k}_", moments[k - 1])
            spread = script.symmetric(f"S{k}_", spreads[k - 1])
            if link.slides:
                f, n = [times(m, a) for a in axis], cross(h, axis)
            else:
                trace = plus(*(spread[i][i] for i in range(3)))
                f = cross(axis, h)
                turned = applied(spread, axis)
                n = added([times(trace, a) for a in axis], [minus(x) for x in turned])
            f, n = script.vector(f"F{k}{k}_", f), script.vector(f"N{k}{k}_", n)
            self._row(matrix, k, f, n)
            if link.parent is None:
                continue
            p, turn, place = link.parent, self.turns[k - 1], self.places[k - 1]
            h = script.vector(f"T{k}_", applied(turn, h))
            across = [[times(a, b) for b in place] for a in h]
            shift = [[times(m, a, b) for b in place] for a in place]
            half = script.rows(f"U{k}_", matmul(turn, spread))
            parts = zip(
                spreads[p],
                matmul(half, transposed(turn)),
                across,
                transposed(across),
                shift,
                strict=True,
            )
            masses[p] = plus(masses[p], m)
            moments[p] = added(moments[p], h, [times(m, x) for x in place])
            spreads[p] = [added(*rows) for rows in parts]
        return matrix

    def _row(self, matrix: Matrix, k: int, f: Vector, n: Vector) -> None:
        """Write what the joint of link k and those below it feel of its unit acceleration."""
        j = k
        while True:
            link = self.links[j - 1]
            entry = dot(self.axes[j - 1], f if link.slides else n)
            entry = self.script.name(f"M{j}_{k}", entry)
            matrix[j - 1][k - 1] = matrix[k - 1][j - 1] = entry
            if link.parent is None:
                return
            f, n = self._handed_down(j, f, n, f"R{k}")
            j = link.parent + 1
            n = self.script.vector(f"N{k}_{j}", n)


def _bracketed(text: str) -> str:
    return text if text.startswith("(") else f"({text})"
