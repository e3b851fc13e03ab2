"""A converter coarser than stated: readings in steps that the model file does not know of.

Steps themselves are noise, which the likelihood knows (`shooting/converters.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxsr.diagnosis.shooting.converters import steps_of
from jaxsr.models import Edit, Model, Parameter
from jaxsr.models.segments import Prepared
from jaxsr.recordings.converter import uniform_variance

STATED = 1.0 / 3.0
"""Share of what is read below which a stated step or noise is another one (docs/mechanisms.md)."""


@dataclass(frozen=True)
class Coarse:
    """A sensor that reads in wider steps than its model says.

    Attributes
    ----------
    output : str
    step : float
    half : float
        Half the interval of the step: how far readings lie off the grid, over their multiples.
    stated : str
        What the model file says instead, in words.
    """

    output: str
    step: float
    half: float
    stated: str

    @property
    def variance(self) -> float:
        """Of the steps, in the square of the reading's unit."""
        return uniform_variance(self.step)


def coarse_sensors(model: Model, prepared: tuple[Prepared, ...]) -> list[Coarse]:
    r"""Return the sensors whose stated resolution, or else noise, is far below what is read.

    A step q is read where [resolution] states less than q/3; where it states nothing, the noise
    of q's steps, :math:`q/\sqrt{12}`, is compared with what [noise] states. A file that states
    neither says nothing of its converters.
    """
    found = []
    for k, (output, step) in enumerate(zip(model.outputs, steps_of(model, prepared), strict=True)):
        stated = _stated(model, output, step)
        if stated is not None:
            readings = np.concatenate([p.outputs[:, k] for p in prepared])
            found.append(Coarse(output, step, _half_width(readings, step), stated))
    return found


def _stated(model: Model, output: str, step: float) -> str | None:
    """Return what is stated in the place of a step, if it is another one."""
    resolution, noise = model.resolution.get(output), model.noise.get(output)
    if resolution is not None:
        return f"steps of {resolution:.4g}" if resolution < STATED * step else None
    if noise is not None and noise < STATED * np.sqrt(uniform_variance(step)):
        return f"noise of {noise:.4g}"
    return None


def _half_width(readings: np.ndarray, step: float) -> float:
    """Bound of a step's error: a reading n steps from another is n times as sharp a ruler."""
    levels = np.unique(readings[np.isfinite(readings)])
    count = np.round((levels - levels[0]) / step)
    off = np.abs(levels - levels[0] - count * step)
    return float(np.quantile(off, 0.98) / max(count[-1], 1.0) + 1e-9 * step)


def rounded_reading(model: Model, coarse: Coarse, name: str) -> Edit:
    """Return the edit that rounds a reading to its grid, the step as parameter `name`."""
    old = model.readings[coarse.output]
    return Edit(
        {
            f"readings.{coarse.output}": f"{name}*floor(({old})/{name} + 0.5)",
            f"parameters.{name}": Parameter(coarse.step, model.units.get(coarse.output)),
        }
    )
