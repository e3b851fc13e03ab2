"""Rows of the weak view: a state integrated against test functions, over several recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse

from jaxsr.views import WeakView, choose_half_width

_SPACING = 8.0  # test functions to a half-width
_MOST = 2000  # test functions in a recording,
_LEAST = 120  # and, nearly, the least: a smooth motion must not leave fewer rows than terms
_LOCAL, _FLAT = 0.02, 0.005  # error of smoothed terms, of the row's target and of its rms
_WIDEST = 0.1  # half-width of a test function, of the recording


@dataclass(frozen=True, eq=False)
class WeakRows:
    r"""One equation's rows :math:`\int \phi_c \dot x\,dt = \int \phi_c f\,dt`.

    Attributes
    ----------
    matrix : csr_array, (rows, samples)
        Weights of the right-hand side's samples.
    target : ndarray, (rows,)
        Left-hand side, by parts: no derivative of data is taken.
    error : ndarray, (rows,)
        Standard deviation that the noise of the samples leaves in the target, with what smoothed
        states leave in the right-hand side.
    """

    matrix: sparse.csr_array
    target: np.ndarray
    error: np.ndarray

    def take(self, samples: np.ndarray) -> WeakRows:
        """Return the rows whose test functions lie wholly on the given samples."""
        every = np.diff(self.matrix.indptr)
        chosen = sparse.csr_array(self.matrix[:, samples])
        whole = np.flatnonzero(np.diff(chosen.indptr) == every)
        return WeakRows(chosen[whole], self.target[whole], self.error[whole])

    @staticmethod
    def joined(parts: Sequence[WeakRows]) -> WeakRows:
        """Return the rows of recordings one after the other."""
        return WeakRows(
            sparse.csr_array(sparse.block_diag([p.matrix for p in parts])),
            np.concatenate([p.target for p in parts]),
            np.concatenate([p.error for p in parts]),
        )


def weak_rows(t: np.ndarray, x: np.ndarray, noise: np.ndarray, order: int = 1) -> WeakRows:
    """Integrate a recorded state against test functions that suit its noise.

    Parameters
    ----------
    t, x : ndarray, (samples,)
        NaN where missing.
    noise : ndarray, (samples,)
        Standard deviation of every sample.
    order : int
        2: ``x`` is a displacement and the equation that of its acceleration.

    Returns
    -------
    WeakRows
        None of them where no stretch without gaps is long enough for a test function.
    """
    level = float(np.sqrt(np.mean(noise**2)))
    span = float(t[-1] - t[0])
    half_width = min(choose_half_width(t, x, level), _WIDEST * span)
    spacing = max(min(half_width / _SPACING, span / _LEAST), span / _MOST)
    view = WeakView.build(t, half_width, spacing, mask=np.isfinite(x))
    kept = np.flatnonzero(view.valid)
    if not len(kept):
        none = np.zeros(0)
        return WeakRows(sparse.csr_array((0, len(t))), none, none)
    weights = view.matrices[order][kept]
    target = weights @ np.nan_to_num(x)
    size = float(np.sqrt(np.mean(target**2)))
    smoothing = (_LOCAL * target) ** 2 + (_FLAT * size) ** 2
    error = np.sqrt((weights**2) @ noise**2 + smoothing)
    return WeakRows(sparse.csr_array(view.matrices[0][kept]), target, error)
