"""Fixed-step Runge-Kutta roll-outs of many copies of a system at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxsr._deadline import ensure, never
from jaxsr.discovery.rollout.segments import Segments

_FAR = 1e8  # times what was recorded: a state that large has left where the law was found


def simulate(
    rates: Callable[[Mapping[str, Any], Any], list[Any]],
    states: Sequence[str],
    time_name: str,
    segments: Segments,
    constants: np.ndarray,
    starts: np.ndarray,
    substeps: int = 1,
    expired: Callable[[], bool] = never,
) -> np.ndarray:
    """Integrate by the classical method of order four.

    Between samples, driving signals are cubics where their slopes are known, else straight.

    Parameters
    ----------
    rates : callable
        ``System.function()``.
    states : sequence of str
        Simulated states; other names are taken from ``segments.values``.
    constants : ndarray, (copies, constants)
    starts : ndarray, (states, copies, segments)
    substeps : int
        Steps between samples.
    expired : callable
        Whether the time is over.

    Returns
    -------
    ndarray, (samples, states, copies, segments)
        Not finite from where a copy has diverged.

    Raises
    ------
    OutOfTime
        Once the time is over.
    """
    samples = len(segments.time)
    c = list(constants.T[:, :, None])
    driven = [name for name in segments.values if name not in states]
    far = np.array([_FAR * segments.size(name) for name in states])[:, None, None]
    out = np.full((samples, *starts.shape), np.nan)
    out[0] = x = starts.copy()

    def known(place: int, part: float) -> dict[str, Any]:
        t = segments.time
        values: dict[str, Any] = {time_name: t[place] + part * (t[place + 1] - t[place])}
        return values | {name: _between(segments, name, place, part) for name in driven}

    def f(x: np.ndarray, values: dict[str, Any], slope: np.ndarray) -> np.ndarray:
        for name, row in zip(states, x, strict=True):
            values[name] = row
        for place, rate in enumerate(rates(values, c)):
            slope[place] = rate
        return slope

    parts = np.arange(2 * substeps + 1) / 2.0 / substeps
    room = [np.empty_like(x) for _ in range(4)]
    with np.errstate(all="ignore"):
        for place in range(samples - 1):
            ensure(expired)
            h = (segments.time[place + 1] - segments.time[place]) / substeps
            nodes = [known(place, part) for part in parts]  # steps share their ends
            for at, half, end in zip(nodes[:-1:2], nodes[1::2], nodes[2::2], strict=True):
                k1 = f(x, at, room[0])
                k2 = f(x + 0.5 * h * k1, half, room[1])
                k3 = f(x + 0.5 * h * k2, half, room[2])
                k4 = f(x + h * k3, end, room[3])
                x = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
            x[np.abs(x) > far] = np.nan
            out[place + 1] = x
    return out


def _between(segments: Segments, name: str, place: int, part: float) -> np.ndarray:
    """Return a driving signal (segments,) at a part of the way to the next sample."""
    v, slope = segments.values[name], segments.slopes.get(name)
    change = v[place + 1] - v[place]
    straight = v[place] + part * change
    if slope is None or not 0.0 < part < 1.0:
        return straight
    step = segments.time[place + 1] - segments.time[place]
    first, last = slope[place] * step - change, slope[place + 1] * step - change
    return straight + part * (1.0 - part) * ((1.0 - part) * first - part * last)
