"""What the search by evidence may choose from: the lines of both views."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from test_likelihood_search import MODEL, recorded

from jaxsr.diagnosis.likelihood.course import followed
from jaxsr.diagnosis.likelihood.offered import offered
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.models import Simulator, parse_model
from jaxsr.models.segments import Prepared


def at(candidate: Candidate, factor: float) -> Candidate:
    """Return a candidate whose frequency was found elsewhere."""
    parameters = tuple(
        replace(p, **{n: factor * getattr(p, n) for n in ("low", "neutral", "high")})
        if p.name == "w"
        else p
        for p in candidate.parameters
    )
    return replace(candidate, parameters=parameters)


def test_a_line_that_the_weak_view_has_elsewhere_is_offered_as_well() -> None:
    """Where a sensor is slow, smoothed forces show another line than the equations do."""
    model = Simulator(parse_model(MODEL)).model
    run = recorded(np.random.default_rng(0), lambda q, v: -0.3 * abs(v) * v)
    course = followed(model, [Prepared.build(model, run)])
    assert course is not None
    alone = offered(model, course)
    lines = [c for c in alone if c.label == "harmonic_force@equation:v"]
    assert lines
    first = next(p for p in lines[0].parameters if p.name == "w")
    near, far = at(lines[0], 1.2), at(lines[0], 10.0 * first.high / first.neutral)
    found = offered(model, course, (near, far))
    assert far in found and near not in found
    assert len(found) == len(alone) + 1
