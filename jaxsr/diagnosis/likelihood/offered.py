"""Candidates that a search by evidence may choose from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.likelihood.course import Course
from jaxsr.diagnosis.likelihood.support import supported
from jaxsr.diagnosis.mechanisms import force_candidates, sensor_candidates
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.losses import losses
from jaxsr.diagnosis.mechanisms.memory import memory_candidates
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.mechanisms.timing import timing_candidates
from jaxsr.diagnosis.setup import input_samples, sample_step, state_scale
from jaxsr.models import Model

LOOPS = (0.3, 1.0, 3.0)
"""First sizes of a hysteresis loop, in units of the first guess."""


def offered(model: Model, course: Course, seen: Sequence[Candidate] = ()) -> list[Candidate]:
    """Return forces, actuators and memories, then faults of sensors and of timing.

    Ranges and inner constants are those of the motion that re-calibration follows, so that
    equations of states that no sensor reads are offered as much as others. `seen` are candidates of
    the weak view, whose inner constants it may have found where smoothed forces do not show them,
    or show others: a line of a spectrum elsewhere is another candidate.
    """
    prepared, step = course.prepared, sample_step(course.prepared)
    scale = state_scale(model, prepared)
    forces = force_candidates(model, scale, course.motion, input_samples(model, prepared))
    # Beside a loss in proportion these follow much: the evidence alone charges them for it.
    forces += [c for site in sites_of(model, scale, course.motion) for c in losses(site)]
    memories = [
        v for c in memory_candidates(model, scale, step, course.motion) for v in _variants(c)
    ]
    outputs = np.concatenate([p.outputs for p in prepared])
    sensors = sensor_candidates(model, dict(zip(model.outputs, outputs.T, strict=True)))
    known = [*forces, *memories]
    forces += [c for c in seen if not any(_reaches(other, c) for other in known)]
    duration = max(float(p.time[-1]) for p in prepared)
    every = [*forces, *memories, *sensors, *timing_candidates(model, step, duration)]
    return supported(model, course, every)


def _reaches(candidate: Candidate, other: Candidate) -> bool:
    """Whether a candidate is another, with inner constants in its own ranges."""
    if candidate.label != other.label:
        return False
    first = {p.name: p.neutral for p in other.parameters if not p.coefficient}
    own = (p for p in candidate.parameters if p.name in first)
    return all(p.low <= first[p.name] <= p.high for p in own)


def _variants(candidate: Candidate) -> Iterator[Candidate]:
    """Yield a hysteresis with loops of several first sizes; others as they are.

    The way to slip of presliding is known from the motion.
    """
    if candidate.mechanism != "hysteresis" or "g" not in {p.name for p in candidate.parameters}:
        yield candidate
        return
    for size in LOOPS:
        yield replace(
            candidate,
            parameters=tuple(
                replace(p, neutral=size * p.neutral) if p.name in ("b", "g") else p
                for p in candidate.parameters
            ),
        )
