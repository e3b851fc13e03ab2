"""Mechanisms: what a simulator may have left out, one file a family."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from jaxsr.diagnosis.candidates import Candidate
from jaxsr.diagnosis.mechanisms.coupling import coupling
from jaxsr.diagnosis.mechanisms.dissipative import dissipative
from jaxsr.diagnosis.mechanisms.elastic import elastic
from jaxsr.diagnosis.mechanisms.inertial import inertial
from jaxsr.diagnosis.mechanisms.measurement import measurement, wrong_values
from jaxsr.diagnosis.mechanisms.site import Site, sites_of
from jaxsr.models import Model

FAMILIES: list[Callable[[Site], Iterator[Candidate]]] = [dissipative, elastic, inertial, coupling]
"""Families of forces; append a function of a `Site` to register a mechanism."""


def force_candidates(model: Model, scale: Mapping[str, np.ndarray]) -> list[Candidate]:
    """Return every force mechanism at every equation of motion, and every wrong fixed value."""
    found = [c for site in sites_of(model, scale) for family in FAMILIES for c in family(site)]
    return [*found, *wrong_values(model)]


def sensor_candidates(model: Model) -> list[Candidate]:
    """Return the sensor mechanisms."""
    return list(measurement(model))


__all__ = ["FAMILIES", "Site", "force_candidates", "sensor_candidates", "sites_of"]
