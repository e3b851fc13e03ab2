"""What a plant is: true equations of motion in NumPy, and the same as text for a model file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from benchmarks.concealed.units import FORCE, LENGTH, NONE, TIME, Dims, times

Array = np.ndarray
Values = Mapping[str, Array | float]


@dataclass(frozen=True)
class Constant:
    """A constant of a plant: its range in SI, its dimensions, and whether it may be calibrated."""

    low: float
    high: float
    dims: Dims
    free: bool = True


@dataclass(frozen=True)
class Drive:
    """A recorded input, and the row that it pushes."""

    name: str
    row: int
    dims: Dims = FORCE
    actuated: bool = True
    scale: str = ""


def _upright(p: Values) -> tuple[Array, Array]:
    return np.zeros(0), np.zeros(0)


@dataclass(frozen=True)
class System:
    """A plant with n coordinates: mass(q) a = bias(q, v) + applied(q, v, u).

    Arrays have the shape (n, B) or (inputs, B) with B runs side by side; ``mass`` returns a
    nested list of rows. A plant of order 1 has no velocities: mass * dq/dt = applied(q, u).

    Attributes
    ----------
    coordinates : tuple of Dims
        Dimensions of q: a length or none (an angle).
    force_dims : tuple of Dims
        Dimensions of every row's generalised force.
    inertia, forces : mappings
        The same equations as text over q1, q2, ..., v1, ..., the drives' and constants' names.
    springs : mapping
        Name of a spring's constant to its incidence g (elongation g.q) in the coordinates.
    twins : mapping
        (mechanism, row) to the constants whose change reproduces that mechanism exactly.
    loops : tuple of int pairs
        (drive, coordinate) pairs that a controller can close.
    target : float
        Usual rms of the first coordinate, in SI, about its rest.
    rest : callable
        Constants to (q, u) at rest; empty arrays stand for zeros.
    """

    name: str
    coordinates: tuple[Dims, ...]
    force_dims: tuple[Dims, ...]
    drives: tuple[Drive, ...]
    constants: Mapping[str, Constant]
    inertia: Mapping[int, Mapping[int, str]]
    forces: tuple[str, ...]
    mass: Callable[[Array, Values], list[list[Array | float]]]
    applied: Callable[[Array, Array, Array, Values], Array]
    bias: Callable[[Array, Array, Values], Array] | None = None
    order: int = 2
    springs: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    twins: Mapping[tuple[str, int], tuple[str, ...]] = field(default_factory=dict)
    loops: tuple[tuple[int, int], ...] = ()
    target: float = 0.1
    bandwidth: float = 6.0
    rest: Callable[[Values], tuple[Array, Array]] = _upright
    turning: tuple[int, ...] = ()
    # constants that follow from others, in order
    derive: Callable[[dict[str, float]], dict[str, float]] | None = None
    simulator: str = "ode"

    @property
    def size(self) -> int:
        """How many coordinates."""
        return len(self.coordinates)

    @property
    def multibody(self) -> bool:
        """Whether several bodies are coupled."""
        return self.order == 2 and self.size > 1

    def at_rest(self, p: Values) -> tuple[Array, Array]:
        """Return coordinates and inputs at rest."""
        q, u = self.rest(p)
        return (
            q if q.size else np.zeros(self.size),
            u if u.size else np.zeros(len(self.drives)),
        )

    def rate_dims(self, row: int) -> Dims:
        """Dimensions of a row's velocity."""
        return times(self.coordinates[row], TIME, -1)

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """Draw the constants, log-uniform in their ranges."""
        p = {
            name: float(np.exp(rng.uniform(np.log(c.low), np.log(c.high))))
            for name, c in self.constants.items()
        }
        return p if self.derive is None else self.derive(p)


def solve(mass: list[list[Array | float]], force: Array) -> Array:
    """Solve M a = f for every run."""
    if len(mass) == 1:
        return force / mass[0][0]
    if len(mass) == 2:
        (a, b), (c, d) = mass
        determinant = a * d - b * c
        return np.stack([d * force[0] - b * force[1], a * force[1] - c * force[0]]) / determinant
    zero = np.zeros(force.shape[1])
    matrix = np.array([[entry + zero for entry in row] for row in mass])
    return np.linalg.solve(np.moveaxis(matrix, 2, 0), force.T[:, :, None])[:, :, 0].T


def total_force(system: System, q: Array, v: Array, u: Array, p: Values) -> Array:
    """Return bias and applied forces together."""
    out = system.applied(q, v, u, p)
    return out if system.bias is None else out + system.bias(q, v, p)


def per(dims: Dims, coordinate: Dims, power: int = 1, seconds: int = 0) -> Dims:
    """Dimensions of force / (coordinate**power) * s**seconds."""
    return times(times(dims, coordinate, -power), TIME, seconds)


STIFFNESS = per(FORCE, LENGTH)
DAMPING = per(FORCE, LENGTH, 1, 1)
ANGLE = NONE
