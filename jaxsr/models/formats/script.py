"""Vectors of sums of products, written as named definitions of a model file."""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import product

AXES = "xyz"
TINY = 1e-15
"""Numbers up to which a factor is what rounding leaves of zero."""
CROSS = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
"""Axes k, i, j of (a x b)_k = a_i b_j - a_j b_i."""
Poly = dict[tuple[str, ...], float]
"""A sum of products of symbols: sorted names to the number before them."""
Vector = list[Poly]
Matrix = list[Vector]


class Script:
    """Definitions of a model file, each a sum of products of earlier ones."""

    def __init__(self) -> None:
        self.lines: dict[str, str] = {}
        self.known: dict[str, str] = {}  # the same the other way round

    def name(self, name: str, value: Poly, always: bool = False) -> Poly:
        """Define a symbol for a value, where it is more than a number or a multiple of one."""
        if not always and (not value or (len(value) == 1 and len(next(iter(value))) <= 1)):
            return value
        text = text_of(value)
        known = self.known.setdefault(text, name)
        self.lines.setdefault(known, text)
        return {(known,): 1.0}

    def vector(self, name: str, values: Vector) -> Vector:
        """Define symbols for the components of a vector."""
        return [self.name(f"{name}{a}", v) for a, v in zip(AXES, values, strict=True)]

    def rows(self, name: str, values: Matrix) -> Matrix:
        """Define symbols for the entries of a matrix."""
        return [self.vector(f"{name}{a}", row) for a, row in zip(AXES, values, strict=True)]

    def symmetric(self, name: str, values: Matrix) -> Matrix:
        """Define symbols for the entries of a symmetric matrix."""
        pairs = [(i, j) for i in range(3) for j in range(i, 3)]
        own = {(i, j): self.name(f"{name}{AXES[i]}{AXES[j]}", values[i][j]) for i, j in pairs}
        return [[own[min(i, j), max(i, j)] for j in range(3)] for i in range(3)]

    def needed(self, texts: Iterable[str]) -> dict[str, str]:
        """Return the definitions that expressions rest on."""
        wanted: set[str] = set()
        texts = list(texts)
        while texts:
            names = set(re.findall(r"[A-Za-z_]\w*", texts.pop())) & self.lines.keys() - wanted
            wanted |= names
            texts += [self.lines[name] for name in names]
        return {name: text for name, text in self.lines.items() if name in wanted}


def text_of(value: Poly) -> str:
    """Write a sum of products."""
    text = ""
    for names, number in value.items():
        factors = [repr(abs(number))] if abs(number) != 1.0 or not names else []
        sign = (" + " if text else "") if number > 0 else (" - " if text else "-")
        text += sign + "*".join([*factors, *names])
    return text or "0"


def plus(*parts: Poly) -> Poly:
    """Add sums of products, and leave out what cancels."""
    total: Poly = {}
    for part in parts:
        for names, number in part.items():
            total[names] = total.get(names, 0.0) + number
    return {names: number for names, number in total.items() if abs(number) > TINY}


def times(*parts: Poly) -> Poly:
    """Multiply sums of products."""
    total: Poly = {(): 1.0}
    for part in parts:
        pairs = product(total.items(), part.items())
        total = plus(*({tuple(sorted(a + b)): x * y} for (a, x), (b, y) in pairs))
    return total


def number(value: float, *names: str) -> Poly:
    """Return a number before symbols."""
    return {tuple(sorted(names)): float(value)} if abs(value) > TINY else {}


def dot(a: Vector, b: Vector) -> Poly:
    """Return the inner product."""
    return plus(*(times(x, y) for x, y in zip(a, b, strict=True)))


def minus(value: Poly) -> Poly:
    """Change the sign."""
    return {names: -number for names, number in value.items()}


def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product."""
    return [plus(times(a[i], b[j]), minus(times(a[j], b[i]))) for _, i, j in CROSS]


def added(*vectors: Vector) -> Vector:
    """Add vectors."""
    return [plus(*parts) for parts in zip(*vectors, strict=True)]


def applied(matrix: Matrix, vector: Vector) -> Vector:
    """Return matrix times vector."""
    return [dot(row, vector) for row in matrix]


def transposed(matrix: Matrix) -> Matrix:
    """Return the transpose."""
    return [list(row) for row in zip(*matrix, strict=True)]


def matmul(a: Matrix, b: Matrix) -> Matrix:
    """Return the product of two matrices."""
    return transposed([applied(a, column) for column in transposed(b)])
