"""Data as a search can use them in its time: what their treatment costs is measured beforehand."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from jaxsr._clock import now
from jaxsr._progress import Budget
from jaxsr.discovery.samples import Roles
from jaxsr.discovery.thinning import Thinned, thin
from jaxsr.discovery.treatment import treat
from jaxsr.discovery.weak_rows import weak_rows
from jaxsr.recordings import Recording

_PROBE = 400  # samples of the signal that is treated for a trial
_TRIAL, _SIGNAL, _ROW = 0.1, 0.05, 4.5e-5  # seconds: that trial, a signal, a row of it, at rest
_SHARE = 0.4  # of the time left that treatment may take


def affordable(
    recordings: Sequence[Recording], part: Roles, limit: Budget, *, joined: bool = False
) -> tuple[Thinned, bool]:
    """Thin recordings for a search, further where the machine is too slow for its time.

    Parameters
    ----------
    recordings : sequence of Recording
    part : Roles
    limit : Budget
    joined : bool
        Whether recordings must not be cut.

    Returns
    -------
    data : Thinned
    hurried : bool
        Whether the time has decided on what is searched.
    """
    data = thin(recordings, part, limit.seconds, joined=joined)
    if math.isinf(limit.seconds) or not recordings:
        return data, False
    states = len(part.states)
    cost = _SIGNAL * states * len(data.searched) + _ROW * states * data.rows
    if cost < 0.1 * _SHARE * limit.remaining:
        return data, False
    cost *= _pace()
    allowed = _SHARE * limit.remaining
    if cost <= allowed:
        return data, False
    seconds = min(limit.seconds, data.seconds) * allowed / cost
    return thin(recordings, part, seconds, joined=joined), True


def _pace() -> float:
    """Return how many times longer than at rest the treatment of a signal takes, one at least."""
    t = np.linspace(0.0, 20.0, _PROBE)
    x = np.sin(t) + 0.05 * np.cos(1e4 * t**2)
    began = now()
    signal = treat(t, x)
    if signal.weak:
        weak_rows(t, signal.recorded, signal.noise)
    return max((now() - began) / _TRIAL, 1.0)
