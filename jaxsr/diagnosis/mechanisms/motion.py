"""What the recordings show: signals, and what re-calibration leaves of every equation.

The inner constants of mechanisms (frequencies, periods, places in time) are seeded from here.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from jaxsr._deadline import ask

MOST_FREQUENCIES = 1500
AT_ONCE = 2**15
"""Samples times constants that are looked at together: as much as fits the cache."""
SINGULAR = 1e-6
"""Singular value, relative to the largest, below which columns are one."""
WITHIN = 1.5
"""Factor within which a constant is estimated about its line."""
Columns = Callable[[float], np.ndarray]
"""A constant to signals of shape (samples, columns)."""


@dataclass(frozen=True)
class Line:
    """A spectral line of a residual force: a*f1 + b*f2 with f1, f2 a pair in quadrature.

    Attributes
    ----------
    value : float
        The constant (frequency, wave number) at the line.
    phase : float
        atan2(b, a).
    share : float
        Share of the residual's power that the pair removes.
    among : int
        Ranges as wide as that within which it is estimated, among which it was picked.
    """

    value: float
    phase: float
    share: float
    among: int = 1


@dataclass(frozen=True, eq=False)
class Motion:
    """Signals of all recordings end to end, and the residual forces in the weak view.

    Attributes
    ----------
    signals : mapping
        Symbol (time, states, inputs) to its samples, shape (samples,).
    recordings : tuple of str
        Names, in the order of the samples.
    edges : ndarray of int, shape (recordings + 1,)
        First sample of every recording, and the number of samples.
    integrate : callable
        Signals (samples, columns) to the rows of the weak view (rows, columns).
    centre : ndarray, shape (rows,)
        Times of the rows in seconds.
    rows : mapping
        State to the rows that its equation has; all by default.
    spacing : float
        Distance of the rows in seconds.
    residual : mapping
        State to what re-calibration leaves of its equation, shape (its rows,).
    basis : mapping
        State to orthonormal columns that re-calibration can reproduce, shape (its rows, columns).
    """

    signals: Mapping[str, np.ndarray]
    recordings: tuple[str, ...]
    edges: np.ndarray
    integrate: Callable[[np.ndarray], np.ndarray]
    centre: np.ndarray
    spacing: float
    residual: Mapping[str, np.ndarray]
    basis: Mapping[str, np.ndarray]
    rows: Mapping[str, np.ndarray] = field(default_factory=dict)

    def of(self, state: str, rows: np.ndarray) -> np.ndarray:
        """Return those of all rows that the equation of `state` has."""
        return rows[self.rows[state]] if state in self.rows else rows

    def share(self, state: str, columns: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the share of the residual's power that columns remove, and their coefficients."""
        ask()
        a, y = self.of(state, self.integrate(columns)), self.residual[state]
        q = self.basis[state]
        a = a - q @ (q.T @ a)
        solved = np.linalg.lstsq(a, y, rcond=SINGULAR)[0]
        power = float(y @ y) + 1e-300
        return 1.0 - float(np.sum((y - a @ solved) ** 2)) / power, solved

    def shares(self, state: str, columns: np.ndarray) -> np.ndarray:
        """Return the share of the residual's power that each column alone removes."""
        a, y = self.of(state, self.integrate(columns)), self.residual[state]
        q = self.basis[state]
        a = a - q @ (q.T @ a)
        size = np.sum(a**2, axis=0)
        seen = size > 1e-9 * size.max(initial=1e-300)
        return np.where(seen, (a.T @ y) ** 2 / np.where(seen, size, 1.0), 0.0) / (y @ y + 1e-300)

    def lines(self, state: str, pair: Columns, grid: np.ndarray, most: int = 2) -> list[Line]:
        """Return the peaks over a grid of constants, the highest first."""
        if grid.size < 8 or state not in self.residual:
            return []
        few = max(AT_ONCE // self.signals["t"].size, 1)
        parts = [
            self._powers(state, [pair(c) for c in grid[k : k + few]])
            for k in range(0, grid.size, few)
        ]
        return self._peaks(state, pair, grid, np.concatenate(parts), most)

    def _powers(self, state: str, several: Sequence[np.ndarray]) -> np.ndarray:
        r"""Return the power that each of several groups of as many columns removes.

        With the base eliminated, of columns A and the residual y: y'A (A'A)^{-1} A'y.
        """
        ask()
        a, y = self.of(state, self.integrate(np.concatenate(several, axis=1))), self.residual[state]
        q = self.basis[state]
        a = (a - q @ (q.T @ a)).reshape(len(a), len(several), -1)
        gram, pull = np.einsum("rgi,rgj->gij", a, a), np.einsum("rgi,r->gi", a, y)
        inverse = np.linalg.pinv(gram, rcond=SINGULAR**2, hermitian=True)
        return np.einsum("gi,gij,gj->g", pull, inverse, pull)

    def frequencies(self, state: str, most: int = 2) -> list[Line]:
        """Return the highest peaks of a residual's spectrum, in rad/s.

        Whether they are more than noise, or brought by an input, the evidence tells: in a short
        recording no line stands out from its neighbours.
        The strongest line of another residual counts as well, where it is none of these: what
        pushes one coordinate shows in the equations of those that it moves.
        """
        if state not in self.residual:
            return []
        own, t = self._spectra[state][:most], self.signals["t"]
        others = [found[0] for s, found in self._spectra.items() if s != state and found]
        best = max(others, key=lambda x: x.share, default=None)
        if best is None or any(best.value / 1.5 < x.value < 1.5 * best.value for x in own):
            return own
        pair = np.stack([np.sin(best.value * t), np.cos(best.value * t)], axis=1)
        share, (a, b) = self.share(state, pair)
        return [*own, Line(best.value, float(np.arctan2(b, a)), share, best.among)]

    @functools.cached_property
    def _spectra(self) -> dict[str, list[Line]]:
        """The lines of every residual, the highest first."""
        return {state: self._own_frequencies(state) for state in self.residual}

    def _own_frequencies(self, state: str, most: int = 2) -> list[Line]:
        ask()
        if self.residual[state].size < 32:
            return []
        y, centre = self.residual[state], self.of(state, self.centre)
        span = float(np.ptp(centre)) or 1.0
        top = np.pi / (2.0 * self.spacing)
        # From two periods in the record on: a slower one is a drift.
        grid = np.linspace(4.0 * np.pi / span, top, _count(span * top / np.pi))
        power = np.abs(np.exp(-1j * np.outer(grid, centre)) @ (y - y.mean())) ** 2
        t = self.signals["t"]

        def pair(w: float) -> np.ndarray:
            return np.stack([np.sin(w * t), np.cos(w * t)], axis=1)

        return self._peaks(state, pair, grid, power, most)

    def _peaks(
        self,
        state: str,
        pair: Columns,
        grid: np.ndarray,
        power: np.ndarray,
        most: int,
    ) -> list[Line]:
        among = max(int(np.ceil(np.log(grid[-1] / grid[0]) / np.log(WITHIN**2))), 1)
        inner = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])) + 1
        found = []
        for i in inner[np.argsort(-power[inner])][:most]:
            near = np.linspace(grid[i - 1], grid[i + 1], 9)
            fits = [self.share(state, pair(c)) for c in near]
            best = int(np.argmax([share for share, _ in fits]))
            share, (a, b) = fits[best][0], fits[best][1][:2]
            found.append(Line(float(near[best]), float(np.arctan2(b, a)), share, among))
        return [line for line in found if line.share > 0.01]


def _count(wanted: float) -> int:
    return int(np.clip(2.0 * wanted, 16, MOST_FREQUENCIES))
