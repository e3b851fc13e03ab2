"""Measurement and parameter mechanisms: the impostors of missing physics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.limits import clipping
from jaxsr.models import Model
from jaxsr.models.physical_constants import fixed_for_good

_METROLOGY = "JCGM 100, Guide to the Expression of Uncertainty in Measurement (2008)"


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
        yield from clipping(output, unit, None if readings is None else readings[output])


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
