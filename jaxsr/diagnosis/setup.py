"""From files and a simulator to everything a diagnosis works on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxsr.diagnosis.mechanisms import Motion, force_candidates
from jaxsr.diagnosis.mechanisms.memory import memory_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.screening.columns import WeakColumns, motion_of, with_candidates
from jaxsr.diagnosis.screening.many_equations import many_equations, screen_each
from jaxsr.diagnosis.screening.memory_columns import with_memory
from jaxsr.diagnosis.screening.screen import Screening, screen
from jaxsr.diagnosis.screening.weak_system import WeakSystem, observable_states, weak_system
from jaxsr.models import Model, Simulator
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording, read_recording
from jaxsr.views import choose_half_width

NARROWEST = 8
"""Least half-width of a test function, in samples."""
QUANTILES = np.linspace(0.0, 1.0, 21)


def open_recording(model: Model, item: str | Path | Recording) -> Recording:
    """Read a file with the model's time column; recordings pass through."""
    if isinstance(item, Recording):
        return item
    return read_recording(item, time=model.columns.get(model.time), sample_time=model.sample_time)


def prepare(model: Model, items: Sequence[str | Path | Recording]) -> tuple[Prepared, ...]:
    """Read recordings and estimate their states."""
    return tuple(Prepared.build(model, open_recording(model, item)) for item in items)


def state_scale(model: Model, prepared: Sequence[Prepared]) -> dict[str, np.ndarray]:
    """Quantiles of every state over all recordings."""
    values = np.concatenate([p.states.values for p in prepared])
    return {s: np.nanquantile(values[:, i], QUANTILES) for i, s in enumerate(model.states)}


def half_width_of(prepared: Sequence[Prepared]) -> float:
    """Half-width of the test functions: the shortest that any output asks for."""
    found = []
    for item in prepared:
        for column in item.outputs.T:
            good = np.isfinite(column)
            found.append(choose_half_width(item.time[good], column[good]))
    shortest = min(p.time[-1] - p.time[0] for p in prepared)
    return float(min(min(found), shortest / 4.0))


def sample_step(prepared: Sequence[Prepared]) -> float:
    """Median sample interval in s."""
    return float(np.median([p.recording.sample_time for p in prepared]))


@dataclass(frozen=True, eq=False)
class Screened:
    """The weak view of all candidates and the sets it suggests; absent where a state hides."""

    super_model: SuperModel
    system: WeakSystem
    screening: Screening
    half_width: float


def screen_all(simulator: Simulator, prepared: Sequence[Prepared]) -> Screened | None:
    """Screen every force mechanism, where the equations can be read off the sensors."""
    model = simulator.model
    # A test function across a jump of the state would see an impulse that no equation says.
    if model.events or not observable_states(simulator, prepared):
        return None
    half_width = half_width_of(prepared)
    theta = np.array([p.value for p in model.parameters.values()])
    given = weak_system(simulator, prepared, theta, half_width)
    columns = WeakColumns(model, prepared, half_width)
    scale = state_scale(model, prepared)
    candidates = force_candidates(model, scale, motion_of_case(simulator, prepared, half_width))
    if many_equations(given):
        super_model = SuperModel.build(model, candidates)
        system = with_candidates(columns, given, super_model)
        return Screened(super_model, system, screen_each(system, super_model), half_width)
    candidates += memory_candidates(model, scale, sample_step(prepared))
    super_model = SuperModel.build(model, candidates)
    system = with_memory(with_candidates(columns, given, super_model), super_model, prepared)
    return Screened(super_model, system, screen(system, super_model), half_width)


def motion_of_case(simulator: Simulator, prepared: Sequence[Prepared], half_width: float) -> Motion:
    """What re-calibration leaves, seen through test functions a third as wide.

    Inner constants are sought where the screening hardly looks: noise is larger there, but a
    line gathers it from the whole recording.
    """
    model = simulator.model
    samples = max(float(np.median(np.diff(p.time))) for p in prepared)
    narrow = min(max(half_width / 3.0, NARROWEST * samples), half_width)
    theta = np.array([p.value for p in model.parameters.values()])
    given = weak_system(simulator, prepared, theta, narrow)
    return motion_of(WeakColumns(model, prepared, narrow), given)
