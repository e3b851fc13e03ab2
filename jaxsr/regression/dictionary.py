"""A fixed set of candidate columns, searched for what a residual holds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from jaxsr.expressions.term import Term
from jaxsr.regression.digits import SINGLE_BITS, largest
from jaxsr.regression.excerpt import Excerpt
from jaxsr.regression.signs import Signs, signs_of

_CHUNK = 256
_NEW = 1e-6  # share of a column's square that must be new beside the terms already there


class Offering(Protocol):
    """A problem as far as candidates are concerned, see `RegressionProblem`."""

    excerpt: Excerpt

    @property
    def signs(self) -> Signs: ...
    def admitted(self, terms: Sequence[Term]) -> bool: ...


class Dictionary:
    """Unit-norm columns of candidate terms in a problem's view, made once.

    Some rows and float32 are enough: only an order of merit is read from them.

    Parameters
    ----------
    problem : Offering
    terms : sequence of Term
        Candidates; those without finite columns, or not admitted, are left out.
    """

    def __init__(self, problem: Offering, terms: Sequence[Term]) -> None:
        self._rows = problem.excerpt
        terms = [term for term in terms if problem.admitted([term])]
        kept: list[Term] = []
        columns = np.empty((len(terms), len(self._rows.target)), np.float32)
        for start in range(0, len(terms), _CHUNK):
            part = list(terms[start : start + _CHUNK])
            found, norms, whole = self._rows.norms(part)
            usable = np.isfinite(norms) & (norms < 1e100) & (norms > 1e-9 * whole)
            here = columns[len(kept) : len(kept) + int(np.count_nonzero(usable))]
            np.divide(found[usable], norms[usable, None], out=here, casting="same_kind")
            kept += [term for term, ok in zip(part, usable, strict=True) if ok]
        self.terms = tuple(kept)
        self._signs = signs_of(kept, problem.signs)
        self.columns: NDArray[np.float32] = columns[: len(kept)]

    def best(self, terms: Sequence[Term], count: int) -> list[Term]:
        """Return the candidates that would lower the loss most if added to ``terms``."""
        if not self.terms:
            return []
        theta, target = self._rows.columns(terms, keep=True), self._rows.target
        if not np.all(np.isfinite(theta)):
            return []
        norms = np.linalg.norm(theta, axis=1)
        theta = theta[norms > 0.0].T / norms[norms > 0.0]  # a column of zeros explains nothing
        basis = np.linalg.qr(theta)[0] if theta.shape[1] else theta
        residual = target - basis @ (basis.T @ target)
        size = float(np.linalg.norm(residual)) or 1.0
        beside = np.column_stack([residual / size, basis]).astype(np.float32)
        products = self.columns @ beside  # the columns are gone through once
        shares = products[:, 0]
        left = 1.0 - np.sum(products[:, 1:] ** 2, axis=1)
        gain = np.where(left > _NEW, shares**2 / np.maximum(left, _NEW), -1.0)
        gain[shares * self._signs < 0.0] = -1.0  # it would come in with the wrong sign
        order = largest(gain, count, SINGLE_BITS)
        return [self.terms[k] for k in order if gain[k] > 0.0]
