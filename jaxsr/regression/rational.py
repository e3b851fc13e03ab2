"""Quotients of short sums, found without guessing: y (b_j - d b_k) = sum of n_m b_m is linear."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from jaxsr.expressions.term import Term
from jaxsr.regression.digits import rounded
from jaxsr.regression.linear import LinearProblem

Terms = tuple[Term, ...]
_ONE = Term.constant(1.0)
_PAIRED = 8  # base columns whose products are base columns too
_WIDEST = 20  # base columns beyond which a denominator is not looked for
_EACH = 3  # numerators kept for a denominator
_WEIGHED = 60  # quotients whose own columns are made


def quotients(problem: LinearProblem, frequencies: Sequence[float], count: int) -> list[Terms]:
    r"""Return sets of terms over one denominator that explain the target best.

    .. math:: y\,b_j = d\,y\,b_k + n_m b_m + n_l b_l
              \quad\Leftrightarrow\quad y = \frac{n_m b_m + n_l b_l}{b_j - d\,b_k}

    Base columns b are 1, the variables, sine and cosine of time at the given frequencies, and
    products of two of them. Every pair below with every pair above is one small solve on a
    shared Gram matrix; the best are then weighed as quotients. Pointwise only: in a weak view
    products with y mean nothing.

    Parameters
    ----------
    frequencies : sequence of float
        rad per unit of time; must be refined ones, a spectrum's grid is too coarse.
    count : int
        Sets returned at most.

    References
    ----------
    Kaheman, Kutz and Brunton, "SINDy-PI", Proc. R. Soc. A 476 (2020), section 2.
    """
    weights = _weights(problem)
    basis, below = _basis(problem, frequencies)
    if weights is None or problem.fixed.shape[1] or not basis:
        return []
    found = _pairs(problem, *_gram(problem, basis, problem.y / weights), len(basis), below)
    sets: list[Terms] = []
    for _, j, k, above, d in found[:_WEIGHED]:
        bottom = basis[j]
        if k >= 0:
            part = Term.constant(d)
            part = part if k == 0 else Term.apply("mul", part, basis[k])
            bottom = Term.apply("sub", bottom, part)
        terms = tuple(Term.apply("div", basis[m], bottom) for m in above if m >= 0)
        sets += [terms, *((term,) for term in terms)]
    sets = list(dict.fromkeys(sets))
    problem.index([term for terms in sets for term in terms])  # in one batch
    usable = [terms for terms in sets if -1 not in problem.index(terms)]
    if not usable:
        return []
    _, losses = problem.solve(usable)
    return [usable[k] for k in np.argsort(rounded(losses), kind="stable")[:count]]


def _basis(problem: LinearProblem, frequencies: Sequence[float]) -> tuple[list[Term], int]:
    small = [Term.variable(n) for n in problem.variables if n != problem.time]
    if problem.time in problem.variables:
        t = Term.variable(problem.time)
        for w in frequencies:
            angle = Term.apply("mul", Term.constant(w), t)
            small += [Term.apply("sin", angle), Term.apply("cos", angle)]
    if not small or len(small) > _WIDEST:
        return [], 0
    basis = [_ONE, *small]
    if len(small) <= _PAIRED:
        pairs = itertools.combinations_with_replacement(small, 2)
        basis += [Term.apply("mul", a, b) for a, b in pairs]
    # with few base columns their products may stand below the line too
    return basis, len(basis) if len(small) <= _PAIRED // 2 else 1 + len(small)


def _weights(problem: LinearProblem) -> np.ndarray | None:
    """Return what the view multiplies each row by, None if it does anything else."""
    if problem.view is None:
        return np.ones(problem.rows)
    if problem.samples != problem.rows:
        return None
    ramp = np.linspace(1.0, 2.0, problem.rows)[:, None]
    weights = problem.view(np.ones_like(ramp))[:, 0]
    same = np.allclose(problem.view(ramp)[:, 0], weights * ramp[:, 0]) and np.all(weights)
    return weights if same else None


def _gram(
    problem: LinearProblem, basis: list[Term], y: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the Gram matrix of [y b | b], unit columns, and the size of each y b."""
    theta = problem.columns(basis)
    theta[:, ~np.all(np.isfinite(theta), axis=0)] = 0.0
    both = np.empty((2 * len(basis), len(y)))
    np.multiply(theta.T, y / np.sqrt(np.mean(y**2)), out=both[: len(basis)])
    both[len(basis) :] = theta.T
    size = np.sqrt(np.vecdot(both, both))
    size[size == 0.0] = 1.0
    both /= size[:, None]
    return both @ both.T, size[: len(basis)]


def _pairs(
    problem: LinearProblem, gram: np.ndarray, size: np.ndarray, n: int, below: int
) -> list[tuple[float, int, int, tuple[int, int], float]]:
    """Return (loss, j, k, (m, l), d), best first."""
    above = [(m, -1) for m in range(n)] + list(itertools.combinations(range(n), 2))
    up = np.where(np.array(above) >= 0, np.array(above) + n, -1)
    pairs = [(j, -1) for j in range(1, below)]
    pairs += [(j, k) for j in range(1, below) for k in range(j)]
    found = []
    for j, k in pairs:
        problem.check()
        index = np.column_stack([np.full(len(up), k), up])
        absent = index < 0
        A = gram[index[:, :, None], index[:, None, :]]
        A = np.where(absent[:, :, None] | absent[:, None, :], 0.0, A)
        A += (absent + 1e-12)[:, :, None] * np.eye(3)  # an absent unknown is zero
        b = np.where(absent, 0.0, gram[j, index])
        x = np.linalg.solve(A, b[:, :, None])[:, :, 0]
        loss = rounded(1.0 - np.sum(x * b, axis=1))
        for row in np.argsort(loss, kind="stable")[:_EACH]:
            d = float(x[row, 0] * size[j] / size[k]) if k >= 0 else 0.0
            found.append((float(loss[row]), j, k, above[row], d))
    return sorted(found, key=lambda item: item[0])
