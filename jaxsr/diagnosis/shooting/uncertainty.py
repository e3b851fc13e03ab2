"""Intervals, angles and smallest effects, all from one matrix of sensitivities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.special

from jaxsr.diagnosis.shooting.arena import Arena
from jaxsr.diagnosis.shooting.blocks import column_sizes
from jaxsr.diagnosis.shooting.converters import correlated, finest_noise
from jaxsr.diagnosis.shooting.reduced import resolved
from jaxsr.diagnosis.shooting.tangent import Tangent
from jaxsr.models.least_squares import Fit

NORMAL = 1.96
"""Deviations of half a 95 % interval."""
RANK = 1e-10
"""Eigenvalue, relative to the largest, below which a direction of parameters leaves no trace."""
LEAST_LEFT = 1e-3
"""Share of what is known that a block must leave to the others for its gradient to be scaled."""


def covariance(arena: Arena, result: Fit) -> np.ndarray:
    r"""Covariance of the estimated parameters.

    The larger, parameter by parameter, of two estimates: residuals of their own correlation
    length, and `spread_over_blocks`, which also sees errors of the model that come and go with the
    motion.
    """
    hessian, gradient = result.normal_equations()
    unknowns = result.active.size + np.sum(arena.problem.segments.free_start)
    variance = _of_a_residual(arena, result, int(unknowns))
    blocks = _in_blocks(arena, hessian), _in_blocks(arena, gradient)
    return covariance_of(hessian.sum(0), variance, blocks)


def _of_a_residual(arena: Arena, result: Fit, unknowns: int) -> float:
    """Return the variance of an independent weighted residual, at least the finest noise's."""
    weights = arena.problem.segments.weights.sum(axis=(1, 2))
    finest = finest_noise(arena.super_model.given, arena.prepared) / arena.problem.scale**2
    cost = max(result.cost, float(weights @ finest))
    length = correlated(result.residual, arena.converters)
    return cost / max(weights.sum() - unknowns, 1.0) * length


def covariance_of(
    total: np.ndarray, variance: float, blocks: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Return the larger of the two estimates of a covariance, parameter by parameter.

    Parameters
    ----------
    total : ndarray, shape (parameters, parameters)
        Hessian, starts projected out.
    variance : float
        Of an independent residual.
    blocks : tuple of ndarray, shapes (blocks, parameters, parameters) and (blocks, parameters)
        Hessians and gradients of parts of the recordings.
    """
    count = len(total)
    if count == 0:
        return np.zeros((0, 0))
    if not np.isfinite(total).all():
        return np.diag(np.full(count, np.inf))
    size = column_sizes(total)
    values, vectors = np.linalg.eigh(total / size / size[:, None])
    seen = values > RANK * values[-1]
    root = vectors[:, seen] / np.sqrt(values[seen]) / size[:, None]
    plain = root @ root.T * variance
    if len(blocks[1]) <= count + 1:
        return plain
    spread = spread_over_blocks(root, *blocks)
    ratio = np.sqrt(np.maximum(spread / np.maximum(np.diag(plain), 1e-300), 1.0))
    return plain * ratio[:, None] * ratio[None, :]


def spread_over_blocks(root: np.ndarray, hessian: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    r"""Return the variance of every parameter by the spread of the blocks' gradients.

    .. math:: \sum_b d_b^2, \qquad d_b = L (1 - L^T H_b L)^{-1/2} L^T g_b, \qquad L L^T = H^{-1}.

    The root makes good that the estimate has turned the few blocks' gradients against each other:
    for equal errors the variance is right on average, however few the blocks (bias-reduced
    linearisation; Bell & McCaffrey, Survey Methodology 28 (2002)).

    Parameters
    ----------
    root : ndarray, shape (parameters, directions)
        L.
    hessian : ndarray, shape (blocks, parameters, parameters)
    gradient : ndarray, shape (blocks, parameters)
    """
    spread = np.zeros(root.shape[0])
    for own, pull in zip(hessian, gradient, strict=True):
        share, turn = np.linalg.eigh(root.T @ own @ root)
        grown = turn @ ((turn.T @ (root.T @ pull)) / np.sqrt(np.maximum(1.0 - share, LEAST_LEFT)))
        spread += (root @ grown) ** 2
    return spread


@dataclass(frozen=True, eq=False)
class Unseen:
    """Directions of the active parameters that leave no trace in the sensors.

    Only kinematics measured, all masses and forces may grow by one factor: the data tell ratios
    alone, and the factor is told by the bounds of the free parameters, which are taken for
    uniform priors (variance = width^2/12). What k directions leave open of n bounded parameters
    is known k times, not n times: precisions are weighed by k/n.

    Attributes
    ----------
    directions : ndarray, shape (active, unseen)
    spread : ndarray, shape (unseen, unseen)
        Covariance of the coordinates along them, by the bounds.
    precision : ndarray, shape (active,)
        Of the bounds, zero without any.
    """

    directions: np.ndarray
    spread: np.ndarray
    precision: np.ndarray

    @property
    def covariance(self) -> np.ndarray:
        """Of the active parameters, beside what the data tell."""
        return self.directions @ self.spread @ self.directions.T

    def step(self, distance: np.ndarray) -> np.ndarray:
        """Return the way to the values that the bounds favour; `distance` is that from given."""
        return -self.directions @ self.spread @ self.directions.T @ (self.precision * distance)


def unseen(arena: Arena, result: Fit) -> Unseen:
    """Return the directions that no data tell about, with what the bounds tell."""
    total, count = result.normal_equations()[0].sum(0), result.active.size
    precision = np.zeros(count)
    low, high = (bound[result.active] for bound in arena.bounds)
    free = np.isin(result.active, arena.super_model.base_index()) & np.isfinite(high - low)
    precision[free] = 12.0 / np.maximum(high[free] - low[free], 1e-300) ** 2
    if count == 0 or not np.isfinite(total).all():
        return Unseen(np.zeros((count, 0)), np.zeros((0, 0)), precision)
    size = column_sizes(total)
    values, vectors = np.linalg.eigh(total / size / size[:, None])
    directions = vectors[:, values < RANK * values[-1]] / size[:, None]
    moving = np.abs(directions).max(axis=1, initial=0.0) * np.sqrt(precision)
    bounded = np.count_nonzero(moving > RANK**0.5 * moving.max(initial=0.0))
    precision *= min(directions.shape[1] / max(bounded, 1), 1.0)
    inner = directions.T @ (precision[:, None] * directions)
    if not len(inner):
        return Unseen(directions, inner, precision)
    return Unseen(directions, np.linalg.pinv(inner, rcond=1e-9, hermitian=True), precision)


def _in_blocks(arena: Arena, values: np.ndarray) -> np.ndarray:
    """Sum what belongs to segments over each block; none where blocks share segments."""
    if len({s for _, s, _, _ in arena.pieces}) < len(arena.pieces):
        return np.zeros((0, *values.shape[1:]))
    blocks = np.zeros((1 + max(b for b, *_ in arena.pieces), *values.shape[1:]))
    for block, s, _, _ in arena.pieces:
        blocks[block] += values[s]
    return blocks


def half_widths(arena: Arena, result: Fit) -> np.ndarray:
    """Half the 95 % interval of every estimated parameter, by what the data tell."""
    blocks = 1 + max(b for b, *_ in arena.pieces)
    return half_widths_of(covariance(arena, result), blocks)


def half_widths_of(covariance: np.ndarray, blocks: int) -> np.ndarray:
    """Half the 95 % interval of every parameter, where so many blocks tell the spread."""
    quantile = float(scipy.special.stdtrit(max(blocks - 1, 3), 0.975))
    return quantile * np.sqrt(np.maximum(np.diag(covariance), 0.0))


def untold(arena: Arena, result: Fit) -> np.ndarray:
    """Half the 95 % interval along the directions that no data tell about."""
    return NORMAL * np.sqrt(np.maximum(np.diag(unseen(arena, result).covariance), 0.0))


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Effects of all candidates in the sensors, free parameters and starts projected out.

    Attributes
    ----------
    columns : ndarray of int
        Parameters of the super-model, one coefficient per candidate.
    candidates : tuple of int
    gram : ndarray, shape (candidates, candidates)
    error : ndarray, shape (candidates,)
        Standard error of each coefficient if it were added to the estimate.
    angle_to_parameters : ndarray, shape (candidates,)
        Degrees between the effect and what the free parameters can reproduce.
    size : ndarray, shape (candidates,)
        Length of the change of the weighted readings with the coefficient, nothing projected out.
    variance : float
        Of an independent weighted residual.
    """

    candidates: tuple[int, ...]
    gram: np.ndarray
    error: np.ndarray
    angle_to_parameters: np.ndarray
    size: np.ndarray
    variance: float

    def angle(self, i: int, j: int) -> float:
        """Degrees between two effects."""
        a, b = self.candidates.index(i), self.candidates.index(j)
        # one root of the product would overflow
        sizes = np.sqrt(max(self.gram[a, a], 0.0)), np.sqrt(max(self.gram[b, b], 0.0))
        norm = sizes[0] * sizes[1] + 1e-300
        return float(np.degrees(np.arccos(min(abs(self.gram[a, b]) / norm, 1.0))))


def sensitivities(arena: Arena, result: Fit, exclude: tuple[int, ...] = ()) -> Sensitivities:
    """Linearise around an estimate along the first coefficient of every candidate but its own."""
    super_model = arena.super_model
    numbers = tuple(i for i in range(len(super_model.candidates)) if i not in exclude)
    own = [super_model.index(i, coefficients_only=True)[0] for i in numbers]
    base = [int(a) for a in result.active]
    problem = resolved(arena.problem, super_model, exclude)
    tangent = Tangent.of(problem, super_model, exclude, result, numbers)
    total = tangent.fit.normal_equations()[0].sum(0)
    raw = np.einsum("poks,poks->p", tangent.fit.jacobian, tangent.fit.jacobian)
    position = [tangent.columns[j] for j in own]
    known = list(range(len(base)))
    cross = total[np.ix_(known, position)]
    solved = np.linalg.lstsq(total[np.ix_(known, known)], cross, rcond=1e-12)[0] if known else cross
    gram = total[np.ix_(position, position)] - cross.T @ solved
    strength = np.maximum(np.diag(gram), 0.0)
    angle = np.degrees(np.arcsin(np.sqrt(np.clip(strength / (raw[position] + 1e-300), 0, 1))))
    variance = _of_a_residual(arena, result, len(base))
    error = np.sqrt(variance) / np.sqrt(strength + 1e-300)  # one root would overflow
    size = np.sqrt(raw[position])
    return Sensitivities(numbers, gram, error, angle, size, float(variance))
