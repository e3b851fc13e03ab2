"""Sensors that read absolute values, and recordings in which their readings have signs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from scipy.special import expit

from jaxsr.models import Edit, Model, with_values
from jaxsr.models.unfolding import signed_readings
from jaxsr.recordings import Recording


@dataclass(frozen=True)
class Rectified:
    """A sensor that reads no signs.

    Attributes
    ----------
    output : str
    log_odds : float
        Of signs that are missing, against readings as the model says.
    values : mapping
        Parameters of the model with which it tells signs: re-calibrated ones.
    """

    output: str
    log_odds: float
    values: Mapping[str, float] = field(default_factory=dict)

    @property
    def probability(self) -> float:
        """That the sensor reads absolute values."""
        return float(expit(self.log_odds))

    def edit(self, model: Model) -> Edit:
        """Return the edit of the reading."""
        return Edit({f"readings.{self.output}": f"Abs({model.readings[self.output]})"})


def signed(
    model: Model, recordings: Sequence[Recording], sensors: Sequence[Rectified]
) -> list[Recording]:
    """Return recordings in which the readings of some sensors have their signs again."""
    found = []
    for recording in recordings:
        channels = dict(recording.channels)
        for sensor in sensors:
            column = model.column(sensor.output)
            if column in channels:
                led = with_values(model, sensor.values)
                reading = led.reading_terms[sensor.output]
                channels[column] = signed_readings(led, recording, reading, channels[column])
        found.append(replace(recording, channels=channels))
    return found
