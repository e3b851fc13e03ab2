"""Data as a search can use them in its time: what their treatment costs is measured beforehand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from jaxsr._clock import now
from jaxsr._progress import Budget
from jaxsr.discovery.samples import Roles
from jaxsr.discovery.thinning import LEAST_ROWS, Thinned, thin
from jaxsr.discovery.treatment import treat
from jaxsr.discovery.weak_rows import weak_rows
from jaxsr.recordings import Recording, noise_level

_PROBE = 400  # samples of the signal that is treated for a trial
_TRIAL, _SIGNAL, _ROW = 0.1, 0.05, 4.5e-5  # seconds: that trial, a signal, a row of it, at rest
_SHARE = 0.4  # of the time left that treatment may take
_DEAR = 1.5  # times that share, from which noisy signals are smoothed evenly
_EVENLY = 0.25  # of the time that a signal takes otherwise
_CELLS = 500_000  # samples times signals up to which nothing is asked
_THINNING = 2.5  # times as long as telling the noise of everything
_LOOKED = 0.2  # share of the time left that thinning may take
_STRETCHES = 4  # into which a recording is cut that cannot be looked at as a whole


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
    recordings = recordings if joined else _bearable(recordings, part, limit)
    data = thin(recordings, part, limit.seconds, joined=joined)
    if math.isinf(limit.seconds) or not recordings:
        return data, False
    cost = _cost(data, part)
    if cost < 0.1 * _SHARE * limit.remaining:
        return data, False
    cost *= _pace()
    allowed = _SHARE * limit.remaining
    if cost <= allowed:
        return data, False
    seconds = min(limit.seconds, data.seconds) * allowed / cost
    return thin(data.searched, part, seconds, joined=joined), True


def evenly(data: Thinned, part: Roles, limit: Budget) -> Thinned | None:
    """Return what there is time for where signals are smoothed evenly; None where all is well.

    Many short signals take too long, each of which is smoothed by itself.
    """
    if math.isinf(limit.seconds) or not data.searched:
        return None
    cost, allowed = _cost(data, part), _DEAR * _SHARE * limit.remaining
    if cost < 0.1 * allowed:
        return None
    cost *= _pace()
    if cost < allowed:
        return None
    count = len(data.searched)
    kept = max(int(count * _SHARE * limit.remaining / (_EVENLY * cost + 1e-9)), 1)
    if kept >= count:
        return data
    few = tuple(data.searched[k] for k in np.linspace(0, count - 1, kept).astype(int))
    return replace(data, searched=few, whole=few, rows=sum(len(r) for r in few))


def _cost(data: Thinned, part: Roles) -> float:
    """Return the seconds that treatment takes at rest."""
    states = len(part.states)
    return _SIGNAL * states * len(data.searched) + _ROW * states * data.rows


def _bearable(recordings: Sequence[Recording], part: Roles, limit: Budget) -> Sequence[Recording]:
    """Return stretches, evenly spread, where there is no time to look at every sample.

    One signal tells how long that takes.
    """
    names = [*part.states, *part.derivatives.values(), *part.inputs]
    cells = len(names) * sum(len(r) for r in recordings)
    if math.isinf(limit.seconds) or cells < _CELLS:
        return recordings
    longest = max(recordings, key=len)
    values = next(v for n, v in longest.channels.items() if n in names)
    began = now()
    noise_level(longest.time, values)
    kept = _LOOKED * limit.remaining / max(_THINNING * (now() - began), 1e-9)
    kept *= len(longest) / cells
    if kept >= 1.0:
        return recordings
    out = []
    for recording in recordings:
        edges = np.linspace(0, len(recording), _STRETCHES + 1).astype(int)
        size = max(int(kept * len(recording) / _STRETCHES), LEAST_ROWS)
        out += [recording.select(slice(a, min(a + size, b))) for a, b in pairwise(edges.tolist())]
    return out


def _pace() -> float:
    """Return how many times longer than at rest the treatment of a signal takes, one at least."""
    t = np.linspace(0.0, 20.0, _PROBE)
    x = np.sin(t) + 0.05 * np.cos(1e4 * t**2)
    began = now()
    signal = treat(t, x)
    if signal.weak:
        weak_rows(t, signal.recorded, signal.noise)
    return max((now() - began) / _TRIAL, 1.0)
