"""Measurement and parameter mechanisms: the impostors of missing physics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from jaxsr.diagnosis.candidates import UNLIMITED, Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import Threshold
from jaxsr.models import Model

FLAT = 3
"""Equal neighbouring readings at the largest value that show a sensor at its limit."""


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
        )
        yield Candidate(
            "sensor_bias",
            "measurement",
            f"output:{output}",
            (ParameterSpec("y0", unit),),
            "Sensor {site} has an offset.",
            readings=((output, "{old} + {y0}"),),
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
    """Return the largest size read, where it is read several samples in a row, more than once.

    A free turning point of the motion passes its largest value but for one sample; a sensor that
    stands at rest there does so once.
    """
    size = np.abs(values[np.isfinite(values)])
    if size.size == 0 or not np.ptp(size) > 0.0:
        return None
    at = np.concatenate([[False], size > size.max() - 1e-9 * np.ptp(size), [False]]).astype(int)
    starts, ends = np.flatnonzero(np.diff(at) == 1), np.flatnonzero(np.diff(at) == -1)
    return float(size.max()) if np.sum(ends - starts >= FLAT) >= 2 else None


def wrong_values(model: Model) -> Iterator[Candidate]:
    """Yield every fixed parameter as possibly wrong."""
    for name, parameter in model.parameters.items():
        if parameter.free:
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
        )
