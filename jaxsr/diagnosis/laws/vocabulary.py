"""The vocabulary of an equation of motion: its named forces as functions of the recorded signals.

Which mechanisms there are, and within which limits, the families of `mechanisms` say; here they
are only read.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.laws.landmarks import Landmarks
from jaxsr.diagnosis.mechanisms import FAMILIES, actuator
from jaxsr.diagnosis.mechanisms.candidate import UNNAMED, Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.dissipative import friction_ripple
from jaxsr.diagnosis.mechanisms.gain_by_state import gain_by_state
from jaxsr.diagnosis.mechanisms.motion import Line
from jaxsr.diagnosis.mechanisms.periodic import harmonic, ripple, swing
from jaxsr.diagnosis.mechanisms.site import Site, Threshold
from jaxsr.diagnosis.setup import QUANTILES
from jaxsr.expressions import Term, evaluate, parse

PHASES = (0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi)
"""Phases that a sine is sought from."""
Signals = Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class NamedForce:
    """The force of a mechanism along one equation.

    Attributes
    ----------
    candidate : Candidate
    term : Term
        The force, its constants by their own names with `OWN` behind.
    linear, inner : tuple of ParameterSpec
        Constants that the force is linear in, and the others.
    starts : tuple of tuple of float
        Inner constants to start from.
    """

    candidate: Candidate
    term: Term
    linear: tuple[ParameterSpec, ...]
    inner: tuple[ParameterSpec, ...]
    starts: tuple[tuple[float, ...], ...]

    @property
    def constants(self) -> int:
        """Number of constants."""
        return len(self.linear) + len(self.inner)

    def columns(self, inner: tuple[float, ...], signals: Signals) -> np.ndarray:
        """Return what does not depend on the linear constants, and a column for each of them.

        Shape (samples, 1 + linear).
        """
        at = {f"{s.name}{OWN}": x for s, x in zip(self.inner, inner, strict=True)}
        zero = {f"{s.name}{OWN}": 0.0 for s in self.linear}
        size = next(iter(signals.values())).shape

        def force(values: Mapping[str, float]) -> np.ndarray:
            with np.errstate(all="ignore"):
                found = evaluate(self.term, {**signals, **at, **values})
            return np.broadcast_to(np.asarray(found, dtype=float), size)

        rest = force(zero)
        units = [force({**zero, name: 1.0}) - rest for name in zero]
        return np.stack([rest, *units], axis=1)

    def values(self, linear: np.ndarray, inner: tuple[float, ...]) -> np.ndarray:
        """Return the constants in the order of the candidate's parameters."""
        own = dict(zip((s.name for s in self.linear), map(float, linear), strict=True))
        own |= dict(zip((s.name for s in self.inner), inner, strict=True))
        return np.array([own[s.name] for s in self.candidate.parameters])

    def allows(self, linear: np.ndarray, inner: tuple[float, ...]) -> bool:
        """Whether constants are physical."""
        pairs = [*zip(self.linear, linear, strict=True), *zip(self.inner, inner, strict=True)]
        if not all(s.low <= x <= s.high for s, x in pairs):
            return False
        physical = self.candidate.physical
        return physical is None or physical({s.name: float(x) for s, x in pairs})


OWN = "__own"
"""Behind the names of a mechanism's constants, which the model may have as well."""


def vocabulary(site: Site, signals: Signals, landmarks: Landmarks) -> list[NamedForce]:
    """Return the named forces along an equation that depend on nothing but known signals.

    Parameters
    ----------
    site : Site
    signals : mapping of str to ndarray, shape (samples,)
        States, and whatever else is known at the same moments: time, inputs, parameters.
    landmarks : Landmarks
        Of the law that a name is sought for: where inner constants start.
    """
    site = _scaled(site, signals)
    groups: dict[tuple[object, ...], list[Candidate]] = {}
    for candidate in _candidates(site, signals, landmarks):
        template = next((t for s, t in candidate.terms if s == site.state), None)
        if template is not None and _is_static(candidate):
            bounds = tuple((s.low, s.high) for s in candidate.parameters)
            groups.setdefault((candidate.label, template, bounds), []).append(candidate)
    found = []
    for variants in groups.values():
        template = next(t for s, t in variants[0].terms if s == site.state)
        force = _read(variants, template, landmarks)
        constants = {f"{s.name}{OWN}" for s in force.candidate.parameters}
        if force.term.variables <= signals.keys() | constants:
            found.append(force)
    return found


def _is_static(candidate: Candidate) -> bool:
    """Whether a mechanism is a force and nothing else, with a name, for as long as it is there."""
    other = candidate.states or candidate.replaced or candidate.inertia or candidate.quiet
    fixed = candidate.fixed_parameter is not None or candidate.passing
    return not other and not fixed and candidate.mechanism != UNNAMED


def _candidates(site: Site, signals: Signals, landmarks: Landmarks) -> Iterator[Candidate]:
    for family in FAMILIES:
        yield from family(site)
        for other in site.others:  # a spring between two axes is offered at one of them
            beside = replace(other, others=(site,), scale=site.scale)
            yield from (c for c in family(beside) if len(c.terms) > 1)
    inputs = {u: signals[u] for u in site.model.inputs if u in signals}
    if len(inputs) == len(site.model.inputs):
        yield from actuator(site.model, inputs)
        yield from gain_by_state(site.model, site.scale)
    frequencies = landmarks.frequencies
    for w, phase in itertools.product(frequencies.get(site.model.time, ()), PHASES):
        yield harmonic(site, Line(w, phase, 1.0))
        if site.position is not None:
            yield swing(site, Line(w, phase, 1.0))
    for n, phase in itertools.product(frequencies.get(site.position or "", ()), PHASES):
        yield ripple(site, Line(n, phase, 1.0))
        yield friction_ripple(site, n, phase)


def _scaled(site: Site, signals: Signals) -> Site:
    """Return the site with quantiles of the signals, where it has none, and without evidence."""
    states = [s for s in site.model.states if s in signals]
    scale = site.scale or {s: np.nanquantile(signals[s], QUANTILES) for s in states}
    others = tuple(replace(o, scale=scale, motion=None) for o in site.others)
    return replace(site, scale=scale, others=others, motion=None)


def _read(variants: list[Candidate], template: str, landmarks: Landmarks) -> NamedForce:
    """Read the force of a mechanism; variants differ in where their inner constants start."""
    first = variants[0]
    linear = tuple(s for s in first.parameters if s.coefficient and not isinstance(s, Threshold))
    inner = tuple(s for s in first.parameters if s not in linear)
    starts = dict.fromkeys(
        tuple(_start(s) for s in c.parameters if s.name in {i.name for i in inner})
        for c in variants
    )
    if len(inner) == 1:
        low, high = inner[0].low, inner[0].high
        near = (sign * v for v in landmarks.values for sign in (1.0, -1.0))
        starts |= {(v,): None for v in near if low <= v <= high}
    text = template.format(**{s.name: f"{s.name}{OWN}" for s in first.parameters})
    return NamedForce(first, parse(text), linear, inner, tuple(starts))


def _start(spec: ParameterSpec) -> float:
    return spec.seed if isinstance(spec, Threshold) else spec.neutral


__all__ = ["OWN", "NamedForce", "Signals", "vocabulary"]
