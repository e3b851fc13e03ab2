"""Derivatives carried from sample to sample, number by number.

Written for a compiler (`_machine_code`): thousands of products of matrices of a few rows cost NumPy
its calls, not its arithmetic.
"""

from __future__ import annotations

import numpy as np

Array = np.ndarray


def carry(slopes: Array, defects: Array, carried: Array) -> None:
    """Fill all samples but the first from those before them, segment by segment.

    Parameters
    ----------
    slopes : ndarray, shape (steps, segments, states, directions)
        Of each one-sample map: by its start, then by the parameters.
    defects : ndarray, shape (steps, segments, states)
    carried : ndarray, shape (steps + 1, segments, states, directions + 1)
        Derivatives of each sample's states, the first ones by the segment's start, and last the
        states' shift.
    """
    steps, segments, n, count = slopes.shape
    for k in range(steps):
        for s in range(segments):
            before, after, by = carried[k, s], carried[k + 1, s], slopes[k, s]
            for i in range(n):
                row, own = after[i], by[i]
                for j in range(n):
                    row[j] = 0.0
                for j in range(n, count):
                    row[j] = own[j]
                row[count] = defects[k, s, i]
                for m in range(n):
                    factor, other = own[m], before[m]
                    if factor != 0.0:
                        for j in range(count + 1):
                            row[j] += factor * other[j]
