"""Periodic mechanisms: forces that come back with time or along the path."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.dissipative import wave_numbers
from jaxsr.diagnosis.mechanisms.motion import WITHIN, Line
from jaxsr.diagnosis.mechanisms.site import Site, inverse_unit

_GENERIC = (Line(1.0, 0.25 * np.pi, 1.0),)
"""Offered where no signals are at hand."""
_PHASE = 10.0


def periodic(site: Site) -> Iterator[Candidate]:
    """Yield forces in time, along the path, and a spring whose stiffness swings."""
    for line in _pushes(site):
        yield harmonic(site, line, line.among)
    if site.position is None:
        return
    for line in _ripples(site):
        yield ripple(site, line, line.among)
    for line in _swings(site):
        yield swing(site, line, line.among)


def harmonic(site: Site, line: Line, tried: int = 1) -> Candidate:
    """Return a force of constant frequency."""
    return Candidate(
        "harmonic_force",
        "periodic",
        site.name,
        (ParameterSpec("A", site.force_unit), *_shape("w", "rad/s", line)),
        "A force of constant frequency that no column records acts along {site}.",
        terms=((site.state, f"+ {{A}}*sin({{w}}*{site.model.time} + {{phi}})"),),
        tried=tried,
        source="den Hartog, Mechanical Vibrations (1956), section 2.8",
    )


def ripple(site: Site, line: Line, tried: int = 1) -> Candidate:
    """Return a force that repeats along the path."""
    q = str(site.position)
    unit = inverse_unit(site.model.units.get(q))
    return Candidate(
        "position_ripple",
        "periodic",
        site.name,
        (ParameterSpec("A", site.force_unit), *_shape("n", unit, line)),
        "A force that repeats along the path (cogging, eccentricity) acts along {site}.",
        terms=((site.state, f"+ {{A}}*sin({{n}}*{q} + {{phi}})"),),
        tried=tried,
        source="Holtz & Springob, IEEE Trans. Ind. Electron. 43 (1996)",
    )


def swing(site: Site, line: Line, tried: int = 1) -> Candidate:
    """Return a spring whose stiffness swings with time."""
    q = str(site.position)
    return Candidate(
        "parametric_excitation",
        "periodic",
        site.name,
        (ParameterSpec("kp", site.per(q)), *_shape("w", "rad/s", line)),
        "The stiffness along {site} swings with time.",
        terms=((site.state, f"- {{kp}}*{q}*cos({{w}}*{site.model.time} + {{phi}})"),),
        tried=tried,
        source="Nayfeh & Mook, Nonlinear Oscillations (1979), chapter 5",
    )


def _shape(name: str, unit: str | None, line: Line) -> tuple[ParameterSpec, ParameterSpec]:
    """Wave number or frequency, within a third of the line, and the phase."""
    return (
        ParameterSpec(name, unit, line.value / WITHIN, WITHIN * line.value, line.value, False),
        ParameterSpec("phi", "rad", -_PHASE, _PHASE, line.phase, False),
    )


def _pushes(site: Site) -> list[Line] | tuple[Line, ...]:
    """Frequencies of a push in time: those of spectral peaks."""
    return _GENERIC if site.motion is None else site.motion.frequencies(site.state)


def _ripples(site: Site) -> list[Line] | tuple[Line, ...]:
    """Wave numbers along a turning coordinate or a drive, where poles, teeth and screws repeat."""
    if not (site.may_turn or site.driven):
        return ()
    path = site.signal(site.position)
    if site.motion is None or path is None:
        return _GENERIC

    def pair(n: float) -> np.ndarray:
        return np.stack([np.sin(n * path), np.cos(n * path)], axis=1)

    return site.motion.lines(site.state, pair, wave_numbers(site))


def _swings(site: Site) -> list[Line] | tuple[Line, ...]:
    """Frequencies of a swinging stiffness, about zero position, where the motion goes both ways."""
    path, time = site.signal(site.position), site.signal("t")
    if not site.reverses:
        return ()
    if site.motion is None or path is None or time is None:
        return _GENERIC

    def pair(w: float) -> np.ndarray:
        # -kp*q*cos(w*t + phi) = kp*q*(sin(phi)*sin(w*t) - cos(phi)*cos(w*t))
        return np.stack([-path * np.cos(w * time), path * np.sin(w * time)], axis=1)

    span = float(np.ptp(site.motion.centre)) or 1.0
    top = np.pi / (4.0 * site.motion.spacing)
    low = 4.0 * np.pi / span
    count = int(np.clip(2.0 * (top - low) * span / np.pi, 0, 160))
    grid = np.linspace(low, top, count) if top > low else np.zeros(0)
    return site.motion.lines(site.state, pair, grid, 1)
