"""Matching: the sum of named forces that a course of a force is, if it is one."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from jaxsr.diagnosis.laws.vocabulary import NamedForce, Signals

MOST = 3
"""Named forces in a sum."""
SHAPED = 2
"""Forces with inner constants among them."""
LEADERS = 6
"""Forces with inner constants that are refined, the nearest first."""
NEAR = 1e-10
"""Singular value, relative to the largest, below which columns are one."""
EVALUATIONS = 40
"""Of a sum while its inner constants are estimated."""
FAR, NOTHING = 0.03, 1e-9
"""Shares of a force's rms left by a sum: no likeness at all, and rounding."""
DEAD = 1e-5
"""Share of a force below which a constant in it does nothing."""

Inner = tuple[float, ...]
Shaped = tuple[tuple[NamedForce, Inner], ...]


@dataclass(frozen=True, eq=False)
class Sum:
    """Named forces, their constants and what is left.

    Attributes
    ----------
    forces : tuple of NamedForce
    values : tuple of ndarray
        Constants of each, in the order of its candidate's parameters.
    difference : ndarray, shape (samples,)
        The course of the force minus the sum.
    """

    forces: tuple[NamedForce, ...]
    values: tuple[np.ndarray, ...]
    difference: np.ndarray

    @property
    def constants(self) -> int:
        """Number of constants."""
        return sum(force.constants for force in self.forces)


def sums(force: np.ndarray, forces: Sequence[NamedForce], signals: Signals) -> Iterator[Sum]:
    """Yield sums of named forces that come near the course of a force, few ones first.

    Inner constants are estimated by variable projection: with all linear ones solved for (Golub &
    Pereyra, SIAM J. Numer. Anal. 10 (1973)). A sum is yielded with the fewest forces first, beside
    each set with inner constants that the plain forces do not bring nearer than it alone does.

    Parameters
    ----------
    force : ndarray, shape (samples,)
    forces : sequence of NamedForce
    signals : mapping of str to ndarray, shape (samples,)
    """
    size = float(np.linalg.norm(force))
    plain = [f for f in forces if not f.inner]
    shaped = [f for f in forces if f.inner]
    if not size > 0.0:
        return
    fit = _Fit(force / size, size, plain, signals)
    yield from fit.sets(())
    leaders = list(_refined(fit, (), shaped))
    for found in leaders:
        yield from fit.sets(found)
    for found in leaders[:SHAPED]:
        for both in itertools.islice(_refined(fit, found, shaped), SHAPED):
            yield from fit.sets(both)


def _refined(fit: _Fit, known: Shaped, shaped: Sequence[NamedForce]) -> Iterator[Shaped]:
    """Yield `known` with one more force that has inner constants, refined, the nearest first."""
    starts = []
    for number, force in enumerate(shaped):
        for inner in force.starts:
            found = (*known, (force, inner))
            weights, rest = fit.solved(found, fit.every)
            # half a turn of phase on, a sine has the other sign: amplitudes are positive
            likeness = round(float(np.linalg.norm(rest)), 9), int((weights < 0.0).sum())
            starts.append((likeness, number, found))
    best: dict[int, Shaped] = {}
    for _, number, found in sorted(starts, key=lambda s: s[:2]):
        if number not in best and len(best) < LEADERS:
            best[number] = fit.refined(found, fit.every)
    yield from sorted(best.values(), key=fit.order)


class _Fit:
    """A force of unit size, and the columns of plain named forces beside it."""

    def __init__(
        self, force: np.ndarray, size: float, plain: Sequence[NamedForce], signals: Signals
    ) -> None:
        self.force, self.size, self.signals = force, size, signals
        courses = [(f, f.columns((), signals)) for f in plain]
        seen = [(f, c) for f, c in courses if np.isfinite(c).all() and c[:, 1:].any()]
        self.plain, self.courses = [f for f, _ in seen], [c for _, c in seen]
        self._nothing = np.zeros((force.size, 0))
        self._known: dict[tuple[int, Inner], np.ndarray] = {}
        self.every = _basis([c[:, 1:] for c in self.courses], force.size)

    def solved(
        self, shaped: Shaped, basis: np.ndarray, plain: Sequence[int] = ()
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the linear constants of forces, in units of the force, and what they leave.

        What lies along the columns of an orthonormal `basis` is free.
        """
        parts = [self._columns(f, inner) for f, inner in shaped]
        parts += [self.courses[i] for i in plain]
        target = self.force - sum((p[:, 0] for p in parts), np.zeros_like(self.force)) / self.size
        columns = np.concatenate([np.zeros((target.size, 0)), *(p[:, 1:] for p in parts)], axis=1)
        if not (np.isfinite(columns).all() and np.isfinite(target).all()):
            return np.zeros(columns.shape[1]), np.full_like(target, 1e3)
        size = np.sqrt(np.einsum("ij,ij->j", columns, columns))
        size[size == 0.0] = 1.0
        both = np.concatenate([columns / size, target[:, None]], axis=1)
        both = both - basis @ (basis.T @ both)
        weights = np.linalg.lstsq(both[:, :-1], both[:, -1], rcond=NEAR)[0]
        return weights / size, both[:, -1] - both[:, :-1] @ weights

    def _columns(self, force: NamedForce, inner: Inner) -> np.ndarray:
        key = id(force), inner
        if key not in self._known:
            self._known[key] = force.columns(inner, self.signals)
        return self._known[key]

    def left(self, shaped: Shaped) -> float:
        """Return what is left of the force, all plain forces beside."""
        return float(np.linalg.norm(self.solved(shaped, self.every)[1]))

    def order(self, shaped: Shaped) -> tuple[float, int]:
        """What is left, and the number of constants where that is the same."""
        return round(self.left(shaped), 6), sum(f.constants for f, _ in shaped)

    def refined(self, shaped: Shaped, basis: np.ndarray) -> Shaped:
        """Estimate the inner constants."""
        specs = [s for f, _ in shaped for s in f.inner]
        if not specs:
            return shaped
        low, high = (np.array([getattr(s, end) for s in specs]) for end in ("low", "high"))
        start = np.array([x for _, inner in shaped for x in inner])
        margin = 1e-9 * np.minimum(high - low, 1.0 + np.abs(start))
        start = np.clip(start, low + margin, high - margin)

        def rest(x: np.ndarray) -> np.ndarray:
            return self.solved(_with(shaped, x), basis)[1]

        if np.linalg.norm(rest(start)) < NOTHING:
            return _with(shaped, start)
        scale = np.maximum(np.abs(start), 1e-3)
        found = least_squares(
            rest, start, bounds=(low, high), x_scale=scale, max_nfev=EVALUATIONS,
            ftol=1e-8, xtol=1e-13, gtol=1e-15,
        )  # fmt: skip
        return _with(shaped, found.x)

    def sets(self, shaped: Shaped) -> Iterator[Sum]:
        """Yield sums of some forces with inner constants and few plain ones, the fewest first.

        It ends with the first size that leaves nothing.
        """
        if self.left(shaped) > FAR:
            return
        for more in range(MOST - len(shaped) + 1):
            chosen = itertools.combinations(range(len(self.plain)), more)
            tried = [(self._left(shaped, plain), plain) for plain in chosen if shaped or plain]
            near = sorted(item for item in tried if item[0] < FAR)[:LEADERS]
            for _, plain in sorted(near, key=self._constants):
                basis = _basis([self.courses[i][:, 1:] for i in plain], self.force.size)
                found = self._sum(self.refined(shaped, basis), plain)
                if found is not None:
                    yield found
            if near and near[0][0] < NOTHING:
                return

    def _constants(self, item: tuple[float, tuple[int, ...]]) -> int:
        return sum(self.plain[i].constants for i in item[1])

    def _left(self, shaped: Shaped, plain: Sequence[int]) -> float:
        return float(np.linalg.norm(self.solved(shaped, self._nothing, plain)[1]))

    def _sum(self, shaped: Shaped, plain: Sequence[int]) -> Sum | None:
        weights, rest = self.solved(shaped, self._nothing, plain)
        forces = (*(f for f, _ in shaped), *(self.plain[i] for i in plain))
        inners = (*(inner for _, inner in shaped), *(() for _ in plain))
        values, at = [], 0
        for force, inner in zip(forces, inners, strict=True):
            own = self.size * weights[at : at + len(force.linear)]
            at += len(force.linear)
            # without one of its constants it is another force
            parts = np.linalg.norm(self._columns(force, inner)[:, 1:], axis=0) * np.abs(own)
            if not force.allows(own, inner) or (parts < DEAD * self.size).any():
                return None
            values.append(force.values(own, inner))
        return Sum(forces, tuple(values), self.size * rest)


def _basis(columns: Sequence[np.ndarray], rows: int) -> np.ndarray:
    """Return an orthonormal basis of what columns span."""
    every = np.concatenate([np.zeros((rows, 0)), *columns], axis=1)
    size = np.linalg.norm(every, axis=0)
    left, values, _ = np.linalg.svd(every / np.where(size, size, 1.0), full_matrices=False)
    return left[:, values > NEAR * values.max(initial=0.0)]


def _with(shaped: Shaped, x: np.ndarray) -> Shaped:
    """Return the forces with other inner constants."""
    found, at = [], 0
    for force, inner in shaped:
        found.append((force, tuple(map(float, x[at : at + len(inner)]))))
        at += len(inner)
    return tuple(found)


__all__ = ["MOST", "Sum", "sums"]
