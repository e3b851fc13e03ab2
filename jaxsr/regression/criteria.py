"""Information criteria for choosing among models (paper Eqs. 10 and 11)."""

from __future__ import annotations

import numpy as np

from jaxsr._result import InputError


def _log_likelihood_part(rss: float, observations: int) -> float:
    if observations < 1:
        raise InputError(f"observations must be at least 1, got {observations}", "criteria")
    if not rss >= 0.0:
        raise InputError(f"rss must not be negative, got {rss}", "criteria")
    with np.errstate(divide="ignore"):
        return float(observations * np.log(rss / observations))


def aic(rss: float, observations: int, terms: int) -> float:
    r"""Return Akaike's criterion :math:`N \log(RSS / N) + 2 d` (Eq. 10); -inf for a zero RSS."""
    return _log_likelihood_part(rss, observations) + 2.0 * terms


def bic(rss: float, observations: int, terms: int) -> float:
    r"""Return the Bayesian criterion :math:`N \log(RSS / N) + d \log N` (Eq. 11)."""
    return _log_likelihood_part(rss, observations) + terms * float(np.log(observations))
