"""Measurement and parameter mechanisms: the impostors of missing physics."""

from __future__ import annotations

from collections.abc import Iterator

from jaxsr.diagnosis.candidates import Candidate, ParameterSpec
from jaxsr.models import Model


def measurement(model: Model) -> Iterator[Candidate]:
    """Yield a wrong gain and a bias of every sensor."""
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
