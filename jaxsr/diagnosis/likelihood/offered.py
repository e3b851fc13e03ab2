"""Candidates that a search by evidence may choose from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr.diagnosis.mechanisms import force_candidates, sensor_candidates
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.timing import timing_candidates
from jaxsr.diagnosis.setup import Screened, input_samples, sample_step, state_scale
from jaxsr.models import Model
from jaxsr.models.segments import Prepared


def offered(
    model: Model, prepared: Sequence[Prepared], screened: Screened | None
) -> list[Candidate]:
    """Return forces, memories and actuators, then faults of sensors and of timing.

    Where the weak view shows no equation, constants that only its residual forces tell have
    generic values.
    """
    if screened is not None:
        forces = list(screened.super_model.candidates)
    else:
        forces = force_candidates(
            model, state_scale(model, prepared), inputs=input_samples(model, prepared)
        )
    outputs = np.concatenate([p.outputs for p in prepared])
    sensors = sensor_candidates(model, dict(zip(model.outputs, outputs.T, strict=True)))
    duration = max(float(p.time[-1]) for p in prepared)
    return [*forces, *sensors, *timing_candidates(model, sample_step(prepared), duration)]
