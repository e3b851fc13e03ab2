"""Blocks held back in turn: their errors, and what they tell about two sets of mechanisms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.special

from jaxsr._deadline import ask
from jaxsr.models.least_squares import Fit
from jaxsr.models.segments import Segments


def held_back(
    pieces: Sequence[tuple[int, int, int, int]], segments: Segments, result: Fit
) -> np.ndarray:
    """Mean squared residual of every block when parameters and starts are estimated without it.

    To first order around the estimate: leaving block b out moves (theta, x0) by the Gauss-Newton
    step of the remaining residuals. A block that is a whole segment has no other data for its
    own start, which is then estimated on it, as in any free run.
    """
    if not result.usable:
        return np.full(1 + max(b for b, *_ in pieces), np.inf)
    states, parameters = result.by_start.shape[0], result.active.size
    count = result.residual.shape[-1]
    whole = segments.count
    products: dict[int, list[tuple[int, bool, np.ndarray, np.ndarray, float, int]]] = {}
    gram = np.zeros((count, parameters + states, parameters + states))
    moment = np.zeros((count, parameters + states))
    for block, s, a, b in pieces:
        columns = np.concatenate(
            [result.jacobian[:, :, a:b, s], result.by_start[:, :, a:b, s]]
        ).reshape(parameters + states, -1)
        r = result.residual[:, a:b, s].ravel()
        g, m = columns @ columns.T, columns @ r
        used = int(segments.weights[:, a:b, s].sum())
        alone = a == 0 and b == whole[s]
        products.setdefault(block, []).append((s, alone, g, m, float(r @ r), used))
        gram[s] += g
        moment[s] += m
    errors = []
    for block in sorted(products):
        ask()
        rest_gram, rest_moment = gram.copy(), moment.copy()
        for s, _, g, m, _, _ in products[block]:
            rest_gram[s] -= g
            rest_moment[s] -= m
        theta_step, start_steps = _solve(rest_gram, rest_moment, parameters)
        sse = used_total = 0.0
        for s, alone, g, m, power, used in products[block]:
            if alone:
                own = m[parameters:] - g[parameters:, :parameters] @ theta_step
                start = np.linalg.lstsq(g[parameters:, parameters:], own, rcond=1e-10)[0]
            else:
                start = start_steps[s]
            step = np.concatenate([theta_step, start])
            sse += max(power - 2 * m @ step + step @ g @ step, 0.0)
            used_total += used
        if used_total:
            errors.append(sse / used_total)
    return np.array(errors)


def _solve(gram: np.ndarray, moment: np.ndarray, parameters: int) -> tuple[np.ndarray, np.ndarray]:
    """Solve for the common parameters and every segment's start (arrow-shaped equations)."""
    inner = gram[:, parameters:, parameters:]
    inverse = np.linalg.pinv(inner, rcond=1e-10, hermitian=True)
    cross = gram[:, :parameters, parameters:]
    own, common = moment[:, parameters:], moment[:, :parameters]
    solved = cross @ inverse
    total = (gram[:, :parameters, :parameters] - solved @ cross.transpose(0, 2, 1)).sum(0)
    right = (common - (solved @ own[..., None])[..., 0]).sum(0)
    step = np.zeros(0)
    if parameters:
        size = column_sizes(total)
        step = np.linalg.lstsq(total / size / size[:, None], right / size, rcond=1e-10)[0] / size
    left = own - np.einsum("spi,p->si", cross, step)
    return step, (inverse @ left[..., None])[..., 0]


def column_sizes(gram: np.ndarray) -> np.ndarray:
    """Square roots of the diagonal, 1 for columns without effect."""
    diagonal = np.diag(gram)
    return np.sqrt(np.where(diagonal > 1e-200, diagonal, 1.0))


def gain(worse: np.ndarray, better: np.ndarray) -> tuple[float, float, float]:
    """Compare two entries block by block.

    Returns
    -------
    mean : float
        Mean of log(worse / better) over the blocks.
    error : float
        Its standard error.
    p : float
        One-sided p-value of Student's t-test that the mean is above zero.
    """
    if not np.isfinite(worse).all() or not np.isfinite(better).all():
        # What could not be simulated loses.
        lost = float(not np.isfinite(worse).all()) - float(not np.isfinite(better).all())
        return lost * np.inf if lost else 0.0, 0.0, 0.5 - 0.5 * lost
    difference = np.log(worse + 1e-300) - np.log(better + 1e-300)
    mean, count = float(np.mean(difference)), difference.size
    error = float(np.std(difference, ddof=1) / np.sqrt(count)) if count > 1 else np.inf
    if error == 0.0:
        return mean, 0.0, 0.5 if mean == 0.0 else float(mean < 0)
    return mean, error, float(scipy.special.stdtr(count - 1, -mean / error))


def correlation_length(residual: np.ndarray) -> float:
    """Return how many neighbouring samples carry one independent residual."""
    total = 0.0
    lags = min(residual.shape[1] - 1, 400)
    r = residual.transpose(0, 2, 1).reshape(-1, residual.shape[1])
    size = float(np.abs(r).max(initial=0.0))
    if not 0.0 < size < np.inf:
        return 1.0
    r = r / size  # what escaped has squares that are no numbers
    power = float(np.mean(r**2))
    for lag in range(1, lags):
        rho = float(np.mean(r[:, :-lag] * r[:, lag:])) / power
        if rho < 0.05:
            break
        total += rho
    return 1.0 + 2.0 * total
