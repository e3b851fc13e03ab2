"""Measurement and parameter mechanisms: the impostors of missing physics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import UNLIMITED, Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import Threshold
from jaxsr.models import Model
from jaxsr.models.physical_constants import fixed_for_good

_METROLOGY = "JCGM 100, Guide to the Expression of Uncertainty in Measurement (2008)"
FLAT = 3
"""Equal neighbouring readings at the largest value that show a sensor at its limit."""
NEVER = 1e-2
"""Share of equal neighbours below which a sensor never stands still but at its limit."""
BAND = 8.0
"""Depth below the largest size, in standard deviations of the noise, in which to look."""


def measurement(
    model: Model, readings: Mapping[str, np.ndarray] | None = None
) -> Iterator[Candidate]:
    """Yield a wrong gain and a bias of every sensor, and clipping where readings stand still."""
    for output in model.outputs:
        unit = model.units.get(output)
        yield Candidate(
            "sensor_gain",
            "measurement",
            f"output:{output}",
            (ParameterSpec("g", "1", low=0.2, high=5.0, neutral=1.0),),
            "The scale of sensor {site} is wrong.",
            readings=((output, "{g}*({old})"),),
            source=_METROLOGY,
        )
        yield Candidate(
            "sensor_bias",
            "measurement",
            f"output:{output}",
            (ParameterSpec("y0", unit),),
            "Sensor {site} has an offset.",
            readings=((output, "{old} + {y0}"),),
            source=_METROLOGY,
        )
        top = 1.0 if readings is None else _limit(readings[output])
        if top is None:
            continue
        yield Candidate(
            "clipping",
            "measurement",
            f"output:{output}",
            (Threshold("ymax", unit, low=0.0, neutral=UNLIMITED, seed=top),),
            "Sensor {site} reads no further than its limit.",
            readings=((output, "Max(Min({old}, {ymax}), -{ymax})"),),
            source="Ljung, System Identification (1999), section 14.1",
        )


def _limit(values: np.ndarray) -> float | None:
    """Return the size at which readings stand still, exactly or up to noise, more than once.

    A free turning point of the motion passes its largest value at once, or in a parabola that is
    wider than the noise; a sensor that stands at rest there does so once, and elsewhere too.
    """
    values = values[np.isfinite(values)]
    size, spread = np.abs(values), float(np.ptp(np.abs(values))) if values.size else 0.0
    if values.size < 8 or not spread > 0.0:
        return None
    flat = [run.size for run in _near_top(size, 1e-9 * spread) if run.size >= FLAT]
    below = size[1:] < size.max() - 1e-9 * spread
    equal = (np.diff(values) == 0.0) & below
    standing = float(np.mean(equal[below])) if below.any() else 1.0
    # A coarse converter repeats readings where the motion turns, but briefly.
    moving = np.flatnonzero(np.concatenate([[True], ~equal, [True]]))
    longest = int(np.diff(moving).max())
    if len(flat) >= 2 or (flat and (standing < NEVER or flat[0] > 2 * longest)):
        return float(size.max())
    # Third differences of white noise have 20 times its variance.
    noise = float(np.median(np.abs(np.diff(values, 3)))) / (0.6745 * np.sqrt(20.0))
    runs = _near_top(size, BAND * noise)
    still = [run for run in runs if run.size >= 2 * FLAT and run.std() < 1.5 * noise]
    return float(max(run.mean() for run in still)) if len(still) >= 2 else None


def _near_top(size: np.ndarray, depth: float) -> list[np.ndarray]:
    """Return runs of neighbouring readings less than `depth` below the largest."""
    at = np.concatenate([[False], size > size.max() - depth, [False]]).astype(int)
    starts, ends = np.flatnonzero(np.diff(at) == 1), np.flatnonzero(np.diff(at) == -1)
    return [size[a:b] for a, b in zip(starts, ends, strict=True)]


def wrong_values(model: Model) -> Iterator[Candidate]:
    """Yield every fixed parameter as possibly wrong, constants of nature apart."""
    known = fixed_for_good(model)
    for name, parameter in model.parameters.items():
        if parameter.free or name in known:
            continue
        span = 2.0 * abs(parameter.value) or 1.0
        yield Candidate(
            "wrong_value",
            "parameter",
            f"parameter:{name}",
            (
                ParameterSpec(
                    name,
                    parameter.unit,
                    low=parameter.value - span,
                    high=parameter.value + span,
                    neutral=parameter.value,
                ),
            ),
            f"The value of {name} in the model is wrong.",
            fixed_parameter=name,
            source="Ljung, System Identification (1999)",
        )
