"""Numbers to as many digits as they tell: choices that can be made again."""

from __future__ import annotations

from typing import Any

import numpy as np

LOSS_BITS, SINGLE_BITS = 22, 17
"""Binary digits by which losses are compared, and what is calculated in single precision."""


def rounded(values: Any, bits: int = LOSS_BITS) -> Any:
    """Return numbers, or a number, to so many binary digits.

    The last digits of a sum are those of a processor, a library and of where arrays lie. No choice
    of a search may hang on them, or it cannot be run again.
    """
    mantissa, exponent = np.frexp(values)
    return np.ldexp(np.round(np.ldexp(mantissa, bits)), exponent - bits)


def largest(values: np.ndarray, count: int, bits: int = LOSS_BITS) -> np.ndarray:
    """Return the places of the largest values, of equals those that come first."""
    values = np.where(np.isnan(values), -np.inf, rounded(values, bits))
    if count < len(values):
        least = np.partition(values, len(values) - count)[len(values) - count]
        places = np.flatnonzero(values >= least)
    else:
        places = np.arange(len(values))
    return places[np.argsort(-values[places], kind="stable")][:count]
