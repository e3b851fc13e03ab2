"""From files and a simulator to everything a diagnosis works on."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxsr._result import InputError
from jaxsr.diagnosis.mechanisms import Motion, force_candidates
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.weak.residual_motion import motion_of
from jaxsr.diagnosis.weak.weak_grid import WeakGrid
from jaxsr.diagnosis.weak.weak_system import WeakSystem, weak_system
from jaxsr.models import Model, Simulator
from jaxsr.models.segments import Prepared
from jaxsr.models.states import is_absent, role_channel
from jaxsr.recordings import Recording, check_time_units, read_recording, unwrap
from jaxsr.views.half_width import FEWEST, LONGEST, SHORTEST, choose_half_widths, sampled_alike

NARROWEST = 8
"""Least half-width of a test function, in samples."""
QUANTILES = np.linspace(0.0, 1.0, 21)

BY_EVIDENCE_ALONE = frozenset({"input_curve", "input_gain_by_state"})
"""Mechanisms that follow much beside what they stand for: only the evidence charges them for it."""


def open_recording(model: Model, item: str | Path | Recording) -> Recording:
    """Read a file with the model's time column; angles that wrap are counted on.

    Samples that the model's equations do not cover (`Model.within`) are left out.
    """
    if not isinstance(item, Recording):
        time = model.columns.get(model.time)
        item = read_recording(item, time=time, sample_time=model.sample_time)
    # a model that reads an angle within one turn wants it so
    folded = {y for y, e in model.readings.items() if re.search(r"\b(floor|atan2)\s*\(", e)}
    used = [c for c in (*model.inputs, *model.outputs) if c not in folded]
    item = unwrap(item, [model.column(c) for c in used])
    return item if model.within is None else model.within(item)


def prepare(model: Model, items: Sequence[str | Path | Recording]) -> tuple[Prepared, ...]:
    """Read recordings and estimate their states."""
    opened = [open_recording(model, item) for item in items]
    check_time_units(opened)
    return tuple(Prepared.build(model, recording) for recording in opened)


def prepare_data(model: Model, items: Sequence[str | Path | Recording]) -> tuple[Prepared, ...]:
    """Read recordings that choices rest on, and check that they can (`check_data`)."""
    prepared = prepare(model, items)
    check_data(model, [p.recording for p in prepared])
    return prepared


def check_data(model: Model, recordings: Sequence[Recording]) -> None:
    """Refuse recordings that no choice can rest on.

    Raises
    ------
    InputError
        No recording has a sample of some output, or no output moves.
    """
    moving, seen = False, set[str]()
    for recording in recordings:
        held = [y for y in model.outputs if not is_absent(recording, model.column(y))]
        for output in held or model.outputs:
            role_channel(model, recording, output)  # says what is wrong with it
        seen.update(held)
    for output in model.outputs:
        column = model.column(output)
        if output not in seen:
            recordings[0].channel(column)  # says what is wrong with it
        values = [r.channels[column] for r in recordings if column in r.channels]
        low = min(np.fmin.reduce(v, initial=np.inf) for v in values)
        high = max(np.fmax.reduce(v, initial=-np.inf) for v in values)
        moving |= bool(high > low)
    if not moving:
        raise InputError(
            f"nothing moves: {', '.join(model.outputs)} are constant throughout",
            recordings[0].name,
            "Name the columns of the sensors in [columns], or record a motion",
        )


def state_scale(model: Model, prepared: Sequence[Prepared]) -> dict[str, np.ndarray]:
    """Quantiles of every state over all recordings."""
    values = np.concatenate([p.states.values for p in prepared])
    return {s: np.nanquantile(values[:, i], QUANTILES) for i, s in enumerate(model.states)}


def input_samples(model: Model, prepared: Sequence[Prepared]) -> dict[str, np.ndarray]:
    """Samples of every input over all recordings."""
    values = np.concatenate([p.inputs for p in prepared])
    return dict(zip(model.inputs, values.T, strict=True))


def half_width_of(prepared: Sequence[Prepared]) -> float | None:
    """Half-width of the test functions in s: the shortest that any output asks for.

    A support holds some samples of the slowest sensor. None where every recording is too short.
    """
    found, slowest = [], 0.0
    for item in prepared:
        for present, columns in sampled_alike(item.outputs):
            if np.count_nonzero(present) >= FEWEST:
                time = item.time[present]
                found += choose_half_widths(time, columns)
                interval = float(np.median(np.diff(time)))
                slowest = max(slowest, min(SHORTEST * interval, LONGEST * (time[-1] - time[0])))
    return max(min(found), slowest) if found else None


def sample_step(prepared: Sequence[Prepared]) -> float:
    """Median sample interval in s."""
    return float(np.median([p.recording.sample_time for p in prepared]))


@dataclass(frozen=True, eq=False)
class Seen:
    """What smoothed signals show of equations that can be read off the sensors.

    Attributes
    ----------
    candidates : tuple of Candidate
        Forces, with inner constants that the force left along each equation shows.
    grid : WeakGrid
        Test functions along the recordings.
    """

    candidates: tuple[Candidate, ...]
    grid: WeakGrid

    @property
    def half_width(self) -> float:
        """Half the support of a test function, in s."""
        return self.grid.half_width


def seen_by(simulator: Simulator, prepared: Sequence[Prepared]) -> Seen | None:
    """Look at the equations through test functions; None where none can be read off the sensors."""
    model = simulator.model
    # A test function across a jump of the state would see an impulse that no equation says.
    if model.events:
        return None
    half_width = half_width_of(prepared)
    if half_width is None:
        return None
    grid = WeakGrid.build(model, prepared, half_width)
    theta = np.array([p.value for p in model.parameters.values()])
    given = weak_system(simulator, grid, theta)
    if not enough_rows(given, len(model.free_parameters)):
        return None
    scale = state_scale(model, prepared)
    motion = motion_of_case(simulator, prepared, half_width)
    candidates = force_candidates(model, scale, motion, input_samples(model, prepared))
    kept = [c for c in candidates if c.mechanism not in BY_EVIDENCE_ALONE]
    return Seen(tuple(kept), grid)


def enough_rows(system: WeakSystem, free: int) -> bool:
    """Whether an equation is told at all: by finite rows, more than the free parameters."""
    finite = np.isfinite(system.residual).all() and np.isfinite(system.jacobian).all()
    return bool(finite) and system.residual.size > free


def motion_of_case(
    simulator: Simulator, prepared: Sequence[Prepared], half_width: float
) -> Motion | None:
    """What re-calibration leaves, seen through test functions a third as wide.

    Inner constants are sought where the screening hardly looks: noise is larger there, but a
    line gathers it from the whole recording. None where so narrow functions tell no equation.
    """
    model = simulator.model
    samples = max(float(np.median(np.diff(p.time))) for p in prepared)
    narrow = min(max(half_width / 3.0, NARROWEST * samples), half_width)
    theta = np.array([p.value for p in model.parameters.values()])
    grid = WeakGrid.build(model, prepared, narrow)
    given = weak_system(simulator, grid, theta)
    if not enough_rows(given, len(model.free_parameters)):
        return None
    return motion_of(grid, given)
