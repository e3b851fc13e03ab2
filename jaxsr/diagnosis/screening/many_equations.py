"""Screening of models with many equations: mechanisms at each, added as long as one still gains."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from scipy.optimize import lsq_linear

from jaxsr._deadline import ask, never
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.site import grows_in_proportion
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.screening.screen import (
    COLLINEAR,
    MAX_SET,
    STEEPEST,
    ScreenedSet,
    Screening,
    assign_blocks,
    redundant,
)
from jaxsr.diagnosis.screening.weak_system import WeakSystem

LEAST = 0.1
"""Fall of one equation's log mean square that a further mechanism must bring, block by block."""
RICHER = 0.1
"""The same for every constant of a law beyond its first, seeded or estimated."""
SMALLEST = 0.01
"""Least rms of what a mechanism takes from an equation, relative to the force that drives it: what
the weak view itself gets wrong is no mechanism."""
PER_EQUATION = 4
"""Largest number of mechanisms, relative to that of equations."""
EXCHANGES, ROUNDS = 3, 4
"""Passes over all members, each held against what could stand in its place; and rounds
of least squares, each equation weighed by what it leaves."""
RIVALS = 3
"""Mechanisms that are kept as rivals of each member."""
FAMILIES = frozenset({"measurement", "parameter", "actuator"})
"""Families whose members scale or shift whole signals, which the weak view tells badly."""


def many_equations(system: WeakSystem) -> bool:
    """Whether a model has more equations than the beam search has members in a set."""
    return np.unique(system.state).size > MAX_SET


def screen_each(
    system: WeakSystem, super_model: SuperModel, stop: Callable[[], bool] = never
) -> Screening:
    r"""Choose mechanisms at all equations together with the parameters, one after another.

    A set S leaves the log likelihood

        L(S) = -1/2 sum_k n_k log e_k(S),

    e_k the mean square of the n_k rows of equation k, held back block by block: every equation
    has a scale of its own, so that no joint outweighs the others. The candidate with the largest
    gain is added, then each member is held against what could stand in its place.

    Parameters
    ----------
    stop : callable
        Whether time is over: the set that was found until then comes first, rivals are left out.

    Returns
    -------
    Screening
        The set found comes first, if there is one; then re-calibration alone, and by turns what is
        left without one of its members and with the closest rivals in its place.
    """
    search = _Search(system, super_model, stop)
    members = search.grown(())
    for _ in range(EXCHANGES):
        before, members = members, search.exchanged(members)
        if members == before:
            break
    sets = [members, ()]
    for number in members:
        if stop():
            break
        rest = tuple(i for i in members if i != number)
        sets += [rest, *search.rivals(rest, number)]
    return Screening(tuple(search.scored(list(dict.fromkeys(sets)))), ())


class _Search:
    """Columns of a weak system, and what each would gain beside a set."""

    def __init__(
        self, system: WeakSystem, super_model: SuperModel, stop: Callable[[], bool] = never
    ) -> None:
        self.system, self.super_model, self.stop = system, super_model, stop
        self.base = super_model.base_index()
        count = len(super_model.candidates)
        self.index = [super_model.index(i, coefficients_only=True) for i in range(count)]
        self.usable = [i for i, c in enumerate(super_model.candidates) if _linear(c)]
        order = list(super_model.model.parameters.values())
        self.low = np.array([p.bounds[0] if p.bounds else -np.inf for p in order])
        self.high = np.array([p.bounds[1] if p.bounds else np.inf for p in order])
        self.equations, self.row = np.unique(system.state, return_inverse=True)
        self.block = assign_blocks(system)
        self.blocks = int(self.block.max()) + 1
        group = self.row * self.blocks + self.block
        self.order = np.argsort(group, kind="stable")
        self.groups, self.begin = np.unique(group[self.order], return_index=True)
        self.count = np.bincount(self.row).astype(float)
        driven = np.sqrt(np.bincount(self.row, system.input_side**2) / self.count)
        self.drive = np.where(driven > 0.0, driven, self.estimate(())[1])

    def grown(self, members: tuple[int, ...]) -> tuple[int, ...]:
        """Add the mechanism that gains most until none gains enough."""
        while len(members) < PER_EQUATION * self.equations.size and not self.stop():
            gain, number = max(self.gains(members), default=(0.0, -1))
            if gain < LEAST:
                break
            members = tuple(sorted((*members, number)))
        return members

    def exchanged(self, members: tuple[int, ...]) -> tuple[int, ...]:
        """Replace members for which others gain more, and drop those that gain too little."""
        for number in members:
            if self.stop():
                break
            rest = tuple(i for i in members if i != number)
            gain, best = max(self.gains(rest), default=(0.0, -1))
            if gain < LEAST:
                members = rest
            elif best != number:
                members = tuple(sorted((*rest, best)))
        return members

    def rivals(self, rest: tuple[int, ...], number: int) -> list[tuple[int, ...]]:
        """Return the sets with a mechanism in the place of `number` that come closest to it."""
        labels = [c.label for c in self.super_model.candidates]
        best: dict[str, int] = {labels[number]: number}
        for gain, other in sorted(self.gains(rest), reverse=True):
            if gain >= LEAST:
                best.setdefault(labels[other], other)
        closest = list(best.values())[1 : 1 + RIVALS]
        return [tuple(sorted((*rest, other))) for other in closest]

    def gains(self, members: tuple[int, ...]) -> Iterator[tuple[float, int]]:
        """Yield what each further mechanism gains at one equation's worth of rows, and its number.

        Its constants are estimated without a block, the others' move along; a richer law pays
        for its constants.
        """
        _, scale = self.estimate(members)
        weight = 1.0 / scale[self.row]
        active = self.active(members)
        basis = _basis(self.system.jacobian[:, active] * weight[:, None])
        left = self.system.residual * weight
        left = left - basis @ (basis.T @ left)
        before = self._sums(left**2)
        for number in self.usable:
            ask()
            wider = tuple(sorted((*members, number)))
            if number in members or redundant(self.super_model, wider):
                continue
            columns = self.system.jacobian[:, self.index[number]] * weight[:, None]
            free = columns - basis @ (basis.T @ columns)
            size, told = np.linalg.norm(columns, axis=0), np.linalg.norm(free, axis=0)
            if not size.all() or (told < COLLINEAR * size).any():
                continue
            after = self._held_back(left, free, before)
            if after is None or not self._allowed(number, left, free):
                continue
            taken = (before.sum(1) - after.sum(1)) * (scale / self.drive) ** 2 / self.count
            if taken.max() < SMALLEST**2:
                continue
            fall = np.log(before.sum(1) / after.sum(1))
            price = RICHER * (len(self.super_model.candidates[number].parameters) - 1)
            yield float(self.count @ fall / self.count.mean()) - price, number

    def _held_back(
        self, left: np.ndarray, free: np.ndarray, before: np.ndarray
    ) -> np.ndarray | None:
        """Sum of squares by equation and block, a mechanism's columns estimated without it."""
        moment = self._sums(free * left[:, None])
        gram = self._sums(free[:, :, None] * free[:, None, :])
        others = gram.sum((0, 1)) - gram.sum(0), moment.sum((0, 1)) - moment.sum(0)
        try:
            value = -np.linalg.solve(others[0], others[1][..., None])[..., 0]
        except np.linalg.LinAlgError:
            return None
        after = before + 2.0 * np.einsum("kbi,bi->kb", moment, value)
        after += np.einsum("bi,kbij,bj->kb", value, gram, value)
        return np.maximum(after, 1e-300)

    def _allowed(self, number: int, left: np.ndarray, free: np.ndarray) -> bool:
        """Whether a mechanism's constants keep their signs."""
        at = self.index[number]
        value = self.system.theta[at] - np.linalg.lstsq(free, left, rcond=None)[0]
        if self.super_model.candidates[number].mechanism == "stribeck_friction":
            fc, fs = value
            return bool(0.0 < fc <= fs <= STEEPEST * fc)
        return bool(np.all((value > self.low[at]) & (value < self.high[at])))

    def _sums(self, rows: np.ndarray) -> np.ndarray:
        """Sums over the rows of every equation and block, shape (equations, blocks, ...)."""
        sums = np.zeros((self.equations.size * self.blocks, *rows.shape[1:]))
        sums[self.groups] = np.add.reduceat(rows[self.order], self.begin)
        return sums.reshape(self.equations.size, self.blocks, *rows.shape[1:])

    def active(self, members: Sequence[int]) -> list[int]:
        """Positions of the free parameters and of the members' coefficients."""
        return [*self.base, *(j for i in members for j in self.index[i])]

    def estimate(self, members: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Return all parameters by least squares within bounds, and what each equation leaves."""
        active, theta = self.active(members), self.system.theta.copy()
        scale = self._left(theta)
        start = np.clip(theta[active], self.low[active], self.high[active])
        room = 1e-9 * (1.0 + np.abs(start))
        limits = self.low[active] - theta[active] - room, self.high[active] - theta[active] + room
        for _ in range(ROUNDS if active else 0):
            ask()
            a, b = self._weighed(active, scale)
            size = np.sqrt((a**2).mean(0)) + 1e-300
            found = lsq_linear(a / size, b, (limits[0] * size, limits[1] * size))
            theta[active] = self.system.theta[active] + found.x / size
            scale = self._left(theta)
        return theta, scale

    def _weighed(self, active: Sequence[int], scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns and right side of the least squares, in the scale of every equation."""
        weight = (1.0 / scale)[self.row]
        return self.system.jacobian[:, active] * weight[:, None], -self.system.residual * weight

    def _left(self, theta: np.ndarray) -> np.ndarray:
        """Root mean square that each equation leaves."""
        total = np.bincount(self.row, self.system.at(theta) ** 2)
        return np.sqrt(total / self.count) + 1e-300

    def scored(self, sets: Sequence[tuple[int, ...]]) -> list[ScreenedSet]:
        """Return sets with their estimates and held-back errors, in the scales of the first."""
        _, scale = self.estimate(sets[0])
        found = []
        for members in sets:
            theta, own = self.estimate(members)
            a, b = self._weighed(self.active(members), own)
            errors = np.empty(self.blocks)
            for k in range(self.blocks):
                ask()
                inside = self.block == k
                value = np.linalg.lstsq(a[~inside], b[~inside], rcond=1e-12)[0]
                left = (b - a @ value)[inside] * (own / scale)[self.row[inside]]
                errors[k] = np.mean(left**2)
            found.append(ScreenedSet(members, errors, theta))
        return found


def _linear(candidate: Candidate) -> bool:
    """Whether the weak view tells a mechanism by its coefficients alone, at one equation."""
    alone = candidate.family not in FAMILIES and not candidate.states and not candidate.inertia
    return alone and grows_in_proportion(candidate) and candidate.fixed_parameter is None


def _basis(columns: np.ndarray) -> np.ndarray:
    """Orthonormal columns that span those given."""
    size = np.linalg.norm(columns, axis=0)
    if not (size > 0.0).any():
        return np.zeros((len(columns), 0))
    u, s, _ = np.linalg.svd(columns[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    return u[:, s > 1e-10 * s[0]]
