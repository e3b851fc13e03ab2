"""Detection: whether a set beats re-calibration, at a stated rate of false alarms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.special

from jaxsr.diagnosis.judging.coloured import likelihood_ratio
from jaxsr.diagnosis.judging.criteria import independent_residuals
from jaxsr.diagnosis.shooting.entry import Entry

SIGNIFICANCE = 1e-3
"""False-alarm rate per comparison with re-calibration; divided by the candidates."""


@dataclass(frozen=True)
class Detection:
    """Whether something beats re-calibration, at a `rate` of false alarms over all candidates."""

    detected: bool
    log_gain: float
    p: float
    threshold: float
    rate: float


def detect_in_noise(null: Entry, chosen: Entry, candidates: float) -> Detection:
    """Test an entry against re-calibration alone where noise limits the fit: likelihood ratio.

    n log(cost_0 / cost_1) is chi-squared with as many degrees of freedom as there are added
    constants (Wilks); the rate of false alarms, `SIGNIFICANCE`, is shared by all candidates. The
    ratio by innovations sees where in the spectrum coloured noise is strong: a slow force must
    stand out from noise that is slow itself. The smaller of the two counts.
    """
    more = max(chosen.constants - null.constants, 1)
    before, after = np.log(np.clip([null.fit.cost, chosen.fit.cost], 1e-300, 1e300))
    ratio = before - after  # what escapes follows nothing
    statistic = independent_residuals(chosen) * ratio
    if null.fit.usable and chosen.fit.usable:
        statistic = min(statistic, likelihood_ratio(null.fit, chosen.fit))
    p = float(scipy.special.chdtrc(more, max(statistic, 0.0)))
    threshold = SIGNIFICANCE / max(candidates, 1)
    return Detection(p < threshold, float(ratio), p, threshold, SIGNIFICANCE)
