"""Cumulative integrals of sampled columns, recording by recording."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxsr._result import InputError


def recording_starts(group: ArrayLike | None, samples: int) -> NDArray[np.intp]:
    """Return where each recording begins, and the number of samples behind.

    Parameters
    ----------
    group : array_like, (samples,), optional
        Number of the recording of each sample; one recording when None.
    samples : int

    Raises
    ------
    InputError
        The length differs, or the samples of a recording do not stand together.
    """
    if group is None:
        return np.array([0, samples])
    number = np.asarray(group)
    if number.shape != (samples,):
        raise InputError(f"group has shape {number.shape}, the data {samples} samples", "group")
    changes = np.flatnonzero(number[1:] != number[:-1]) + 1
    starts = np.concatenate([[0], changes, [samples]])
    if len(np.unique(number)) != len(starts) - 1:
        raise InputError("samples of one recording do not stand together", "group", "Sort them.")
    return starts


def cumulative_trapezoid(
    f: NDArray[np.floating], g: NDArray[np.floating], starts: NDArray[np.intp]
) -> NDArray[np.floating]:
    r"""Return :math:`\int f\,dg` from the start of each recording, by the trapezoidal rule.

    .. math:: I_k = I_{k-1} + \tfrac12 (f_k + f_{k-1})(g_k - g_{k-1}), \qquad I_{start} = 0.

    Parameters
    ----------
    f, g : ndarray, (samples,)
    starts : ndarray of int, (recordings + 1,)
        From :func:`recording_starts`.
    """
    steps = 0.5 * (f[1:] + f[:-1]) * np.diff(g)
    out = np.zeros(len(f))
    for first, end in itertools.pairwise(starts):
        out[first + 1 : end] = np.cumsum(steps[first : end - 1])
    return out
