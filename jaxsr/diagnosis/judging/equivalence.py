"""Causes that no data can split, counted as one (docs/mechanisms.md)."""

from __future__ import annotations

from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.models import Model

_CONSTANT = ("constant_force", "gravity")


def equivalent(model: Model, one: Candidate, other: Candidate) -> bool:
    """Whether a constant force and a biased position sensor stand for the same motion.

    A spring that carries a constant force F0 rests at F0/k: a reading that is off by as much
    shows the same. The position must be free, that is, the spring starts from no known place.
    """
    pair = {c.mechanism: c for c in (one, other)}
    force = next((pair[m] for m in _CONSTANT if m in pair), None)
    bias = pair.get("sensor_bias")
    if force is None or bias is None or any("sin(" in term for _, term in force.terms):
        return False
    state = force.site.split(":")[1]
    position = model.kinematic_parent(state)
    output = bias.site.split(":")[1]
    read = model.reading_terms[output].variables
    return position in read and position in model.equation_terms[state].variables
