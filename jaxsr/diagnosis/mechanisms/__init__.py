"""Mechanisms: what a simulator may have left out, one file a family."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from jaxsr.diagnosis.mechanisms.actuator import actuator
from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.coupled import coupled
from jaxsr.diagnosis.mechanisms.coupling import coupling
from jaxsr.diagnosis.mechanisms.dissipative import dissipative
from jaxsr.diagnosis.mechanisms.elastic import elastic
from jaxsr.diagnosis.mechanisms.external import external
from jaxsr.diagnosis.mechanisms.gain_by_state import gain_by_state
from jaxsr.diagnosis.mechanisms.hardening import hardening
from jaxsr.diagnosis.mechanisms.inertial import inertial
from jaxsr.diagnosis.mechanisms.load import load_dependent
from jaxsr.diagnosis.mechanisms.measurement import measurement, wrong_values
from jaxsr.diagnosis.mechanisms.motion import Line, Motion
from jaxsr.diagnosis.mechanisms.one_mode import one_mode
from jaxsr.diagnosis.mechanisms.periodic import periodic
from jaxsr.diagnosis.mechanisms.play import play
from jaxsr.diagnosis.mechanisms.site import Site, Threshold, sites_of
from jaxsr.models import Model

Family = Callable[[Site], Iterator[Candidate]]
FAMILIES: list[Family] = [
    dissipative,
    load_dependent,
    coupled,
    elastic,
    play,
    hardening,
    inertial,
    coupling,
    periodic,
    external,
]
"""Families of forces, asked at every equation of motion."""


def register_mechanism(family: Family) -> Family:
    """Add mechanisms to every later diagnosis; also a decorator.

    Parameters
    ----------
    family : callable
        Takes a `Site` (an equation of motion with its symbols, units and signals) and yields
        `Candidate`; nothing where the mechanism makes no sense. A coefficient (a
        `ParameterSpec` that is linear and neutral at 0) decides whether the effect is there;
        other constants are marked ``coefficient=False`` and start from their `neutral`.

    Returns
    -------
    callable
        `family` itself; ``FAMILIES.remove(family)`` takes it out again.

    Examples
    --------
    >>> @register_mechanism
    ... def sticky(site):
    ...     v = site.state
    ...     yield Candidate(
    ...         "sticky_friction", "dissipative", site.name,
    ...         (ParameterSpec("Fz", site.force_unit, low=0.0),),
    ...         "A friction that vanishes at high speed acts along {site}.",
    ...         terms=((v, f"- {{Fz}}*{v}/(1 + {v}**2)"),),
    ...     )
    """
    if family not in FAMILIES:
        FAMILIES.append(family)
    return family


def force_candidates(
    model: Model,
    scale: Mapping[str, np.ndarray],
    motion: Motion | None = None,
    inputs: Mapping[str, np.ndarray] | None = None,
) -> list[Candidate]:
    """Return every force and actuator mechanism, and every wrong fixed value.

    Where the model switches, plain forces are also offered in one of its modes only.

    `scale` holds quantiles of the states, `inputs` samples; without `motion`, which holds them
    too, nothing is left out for want of evidence, and inner constants start from generic values.
    """
    sites = sites_of(model, scale, motion)
    found = [c for site in sites for family in FAMILIES for c in family(site)]
    switched = [] if motion is None else one_mode(model, found, motion.signals)
    signals = inputs if motion is None else motion.signals
    drives = [*actuator(model, signals), *gain_by_state(model, scale)]
    return [*found, *switched, *drives, *wrong_values(model)]


def sensor_candidates(
    model: Model, readings: Mapping[str, np.ndarray] | None = None
) -> list[Candidate]:
    """Return the sensor mechanisms; `readings` are the outputs' samples."""
    return list(measurement(model, readings))


__all__ = [
    "Candidate",
    "FAMILIES",
    "Line",
    "Motion",
    "ParameterSpec",
    "Site",
    "Threshold",
    "force_candidates",
    "register_mechanism",
    "sensor_candidates",
    "sites_of",
]
