"""The tangent view of a free run: what forces along one equation would add to the readings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from jaxsr.diagnosis.locating.responses import Part, Responses

SEEN = 1e-5
"""Effect of a course of the force, relative to the largest, from which it counts."""
STRETCHES = 400
"""Most stretches of a segment over which a force is held."""
DETERMINED = 1e-10
"""Eigenvalue, relative to the largest, from which the readings determine a parameter."""


@dataclass(frozen=True, eq=False)
class TangentView:
    r"""Readings in the few directions that a force along one equation can move.

    To first order about an entry's free run, a force f(t) along the equation, a step b of the
    free parameters and steps of the segments' starts leave

    .. math:: |r - G f - \Theta b|^2 = |y - M f - T b|^2 + c

    with the starts projected out and G f compressed, segment by segment, to as many rows as it has
    independent ones. A law is sought in this view as in any other; no differentiated and no hidden
    states are needed, and noise is weighed as in the free run itself.

    Attributes
    ----------
    variables : dict of str to ndarray, shape (samples,)
        States in the middle of the steps, all segments one after another.
    target : ndarray, shape (rows,)
        y.
    fixed : ndarray, shape (rows, parameters)
        T: what steps of the free parameters do.
    maps : tuple of ndarray
        M of every segment, transposed: (samples, rows of the segment).
    beyond : float
        c: the part of the cost that no force along the equation can reach.
    """

    variables: dict[str, np.ndarray]
    target: np.ndarray
    fixed: np.ndarray
    maps: tuple[np.ndarray, ...]
    beyond: float

    @staticmethod
    def of(responses: Responses, site: int, kept: np.ndarray) -> TangentView:
        """Look along the equation number `site`; `kept` marks the parameters that stay free."""
        blocks = [_Block.of(responses, site, s, kept) for s in _seen_segments(responses)]
        gram = np.sum([b.gram for b in blocks], axis=0)
        moment = np.sum([b.moment for b in blocks], axis=0)
        # what the parameters do beside all forces, as one more block of rows
        values, vectors = np.linalg.eigh(gram)
        good = values > DETERMINED * max(float(values.max(initial=0.0)), 1e-300)
        root = np.sqrt(values[good])
        last = (vectors[:, good].T @ moment) / root
        return TangentView(
            states_between(responses),
            np.concatenate([*(b.target for b in blocks), last]),
            np.concatenate([*(b.fixed for b in blocks), root[:, None] * vectors[:, good].T]),
            tuple(b.map for b in blocks),
            max(float(sum(b.beyond for b in blocks) - last @ last), 0.0),
        )

    @property
    def samples(self) -> int:
        """Number of steps at which a force is held."""
        return sum(len(m) for m in self.maps)

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        """Return M f of forces in the middle of the steps, (samples, forces), shape (rows, .)."""
        rows = np.zeros((self.target.size, columns.shape[1]))
        sample = row = 0
        for part in self.maps:
            there = columns[sample : sample + part.shape[0]]
            rows[row : row + part.shape[1]] = part.T @ there
            sample, row = sample + part.shape[0], row + part.shape[1]
        return rows

    def without(self, force: np.ndarray) -> TangentView:
        """Return the view of what is left when a force that acts already is taken away."""
        return replace(self, target=self.target + self(force[:, None])[:, 0])

    def cost(self, columns: np.ndarray) -> float:
        """Return the cost that the best sum of some forces leaves, parameters moving along."""
        every = np.concatenate([self.fixed, self(columns)], axis=1)
        error = self.target - every @ np.linalg.lstsq(every, self.target, rcond=1e-9)[0]
        return float(error @ error) + self.beyond

    def loss(self, cost: float, n: float) -> Callable[[np.ndarray], float]:
        """Return what a difference between two forces loses, in nats.

        To first order beside a force that leaves `cost`, of n independent residuals, free
        parameters moving along.
        """
        basis = np.linalg.qr(self.fixed)[0]

        def nats(difference: np.ndarray) -> float:
            moved = self(difference[:, None])[:, 0]
            moved = moved - basis @ (basis.T @ moved)
            return 0.5 * n * float(np.log1p(moved @ moved / max(cost, 1e-300)))

        return nats


@dataclass(frozen=True, eq=False)
class _Block:
    """One segment of a tangent view; `gram` and `moment` are the parameters' beside the forces."""

    map: np.ndarray
    target: np.ndarray
    fixed: np.ndarray
    gram: np.ndarray
    moment: np.ndarray
    beyond: float

    @staticmethod
    def of(responses: Responses, site: int, s: int, kept: np.ndarray) -> _Block:
        steps, part = int(responses.segments.count[s]) - 1, responses.parts[s]
        held = np.arange(steps) // -(-steps // STRETCHES)
        unit = (held[:, None] == np.arange(held[-1] + 1)).astype(float)
        residual = responses.residual[:, : steps + 1, s]
        seen = part.projected(responses.to(site, s, unit), residual)
        factor = Factor.of(seen.flat @ seen.flat.T)
        target = factor.solved(seen.score)
        fixed = factor.solved(seen.cross[:, kept])
        return _Block(
            (unit / unit.sum(0)) @ factor.rows,
            target,
            fixed,
            part.hessian[np.ix_(kept, kept)] - fixed.T @ fixed,
            part.pull[kept] - fixed.T @ target,
            _beside_start(part, residual) - float(target @ target),
        )


@dataclass(frozen=True, eq=False)
class Factor:
    """Rows R with R R' = G for the products G of many responses, as many as are independent.

    A Cholesky factor with pivots: it takes a small share of the time of a decomposition into
    eigenvectors, which tell no more of |y - R' f|^2.

    Attributes
    ----------
    rows : ndarray, shape (responses, rank)
    order : ndarray of int, shape (rank,)
        Responses that the factor begins with, the largest first.
    """

    rows: np.ndarray
    order: np.ndarray

    @staticmethod
    def of(gram: np.ndarray) -> Factor:
        """Factorise until what is left is below `SEEN` of the largest effect."""
        largest = max(_largest_eigenvalue(gram), 1e-300)
        (factorise,) = scipy.linalg.get_lapack_funcs(("pstrf",), (gram,))
        lower, pivots, rank, _ = factorise(gram, tol=SEEN**2 * largest, lower=1)
        order, rows = pivots - 1, np.zeros((len(gram), rank))
        rows[order] = np.tril(lower)[:, :rank]
        return Factor(rows, order[:rank])

    def solved(self, moment: np.ndarray) -> np.ndarray:
        """Return y with R y = moment, where that holds products with the same responses."""
        if not self.order.size:
            return np.zeros((0, *moment.shape[1:]))
        corner, right = self.rows[self.order], moment[self.order]
        return scipy.linalg.solve_triangular(corner, right, lower=True, check_finite=False)


def _largest_eigenvalue(gram: np.ndarray, rounds: int = 20) -> float:
    """Return about the largest eigenvalue of products, by powers of them."""
    vector, value = np.sqrt(np.maximum(np.diag(gram), 0.0)), 0.0
    for _ in range(rounds):
        size = float(np.linalg.norm(vector))
        if not size > 0.0:
            break
        vector = gram @ (vector / size)
        value = float(np.linalg.norm(vector))
    return value


def states_between(responses: Responses) -> dict[str, np.ndarray]:
    """Return the states in the middle of the steps, all segments one after another."""
    middles = []
    for s in _seen_segments(responses):
        path = responses.path[:, : int(responses.segments.count[s]), s]
        middles.append(0.5 * (path[:, 1:] + path[:, :-1]))
    courses = np.concatenate(middles, axis=1)
    return dict(zip(responses.sites[0].model.states, courses, strict=False))


def _seen_segments(responses: Responses) -> list[int]:
    return [int(s) for s in np.flatnonzero(responses.segments.count > 2)]


def cost_left(
    responses: Responses, site: int, kept: np.ndarray, columns: np.ndarray, acting: np.ndarray
) -> float:
    """Return the cost that the best sum of some forces along an equation leaves, to first order.

    That of the tangent view, without the responses to any other forces.

    Parameters
    ----------
    site : int
    kept : ndarray of bool, shape (parameters,)
        Parameters that move along.
    columns : ndarray, shape (samples, forces)
        Forces in the middle of the steps, all segments one after another.
    acting : ndarray, shape (samples,)
        A force that acts already and is taken away.
    """
    tops, sample = [], 0
    for s in _seen_segments(responses):
        steps, part = int(responses.segments.count[s]) - 1, responses.parts[s]
        there = slice(sample, sample + steps)
        sample += steps
        forces = np.concatenate([columns[there], acting[there, None]], axis=1)
        residual = responses.residual[:, : steps + 1, s]
        flat = part.projected(responses.to(site, s, forces), residual).flat
        whole = np.zeros((residual.shape[0], part.starts.shape[1] // residual.shape[0]))
        whole[:, : residual.shape[1]] = residual
        left = whole.ravel() - (part.starts @ whole.ravel()) @ part.inverse @ part.starts + flat[-1]
        rows = np.concatenate([part.thetas[kept], flat[:-1], left[None]])
        tops.append(np.linalg.qr(rows.T, mode="r"))
    every = np.concatenate(tops)
    known, target = every[:, :-1], every[:, -1]
    error = target - known @ np.linalg.lstsq(known, target, rcond=1e-9)[0]
    return float(error @ error)


def _beside_start(part: Part, residual: np.ndarray) -> float:
    """Sum of squares of a segment's residual, its start projected out."""
    whole = np.zeros((residual.shape[0], part.starts.shape[1] // residual.shape[0]))
    whole[:, : residual.shape[1]] = residual
    flat = whole.ravel()
    moved = part.starts @ flat
    return float(flat @ flat - moved @ part.inverse @ moved)


def surface(along: Sequence[np.ndarray], degrees: Sequence[int]) -> np.ndarray:
    """Return products of Legendre polynomials of some variables over their ranges, as columns."""
    columns = np.ones((along[0].size, 1))
    for x, degree in zip(along, degrees, strict=True):
        low, high = float(x.min()), float(x.max())
        z = 2.0 * (x - low) / max(high - low, 1e-300) - 1.0
        powers = np.polynomial.legendre.legvander(z, degree)
        columns = (columns[:, :, None] * powers[:, None, :]).reshape(x.size, -1)
    return columns


__all__ = ["TangentView", "cost_left", "states_between", "surface"]
