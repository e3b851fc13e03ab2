"""Dimensions, coherent unit strings, and the numbers a quantity has in a case's own units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Dims = tuple[float, float, float]
"""Exponents of mass, length and time."""

NONE: Dims = (0, 0, 0)
LENGTH: Dims = (0, 1, 0)
MASS: Dims = (1, 0, 0)
TIME: Dims = (0, 0, 1)
FORCE: Dims = (1, 1, -2)
TORQUE: Dims = (1, 2, -2)
FLOW: Dims = (0, 3, -1)

LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "inch": 0.0254, "dm": 0.1}
MASSES = {"kg": 1.0, "g": 1e-3, "lb": 0.45359237, "tonne": 1e3}


def times(a: Dims, b: Dims, power: float = 1) -> Dims:
    """Return the dimensions of a * b**power."""
    return (a[0] + power * b[0], a[1] + power * b[1], a[2] + power * b[2])


@dataclass(frozen=True)
class Units:
    """A coherent system of units; time stays in seconds."""

    length: str = "m"
    mass: str = "kg"

    @staticmethod
    def draw(rng: np.random.Generator) -> Units:
        """Draw a unit of length and one of mass."""
        return Units(str(rng.choice(list(LENGTHS))), str(rng.choice(list(MASSES))))

    def number(self, value: float, dims: Dims) -> float:
        """Return the number that an SI value has in these units."""
        return float(value) / (MASSES[self.mass] ** dims[0] * LENGTHS[self.length] ** dims[1])

    def text(self, dims: Dims) -> str:
        """Return a unit as text, such as ``kg*mm/s**2``."""
        above, below = [], []
        for name, power in zip((self.mass, self.length, "s"), dims, strict=True):
            if power:
                word = name if abs(power) == 1 else f"{name}**{abs(power):g}"
                (above if power > 0 else below).append(word)
        return "/".join(["*".join(above) or "1", *below])
