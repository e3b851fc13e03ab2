"""What every hypothesis of a diagnosis shares: pieces of recordings, noise, beliefs, scales."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from jaxsr.diagnosis.likelihood.scales import Scales, reaching
from jaxsr.diagnosis.likelihood.sensor_noise import Noise
from jaxsr.diagnosis.likelihood.walk import through_jumps
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.converters import finest_noise
from jaxsr.diagnosis.shooting.integration import choose_stepping
from jaxsr.diagnosis.shooting.memory_starts import start_of
from jaxsr.models.least_squares import Problem
from jaxsr.models.model import Model
from jaxsr.models.segments import Prepared, build_segments, unbroken
from jaxsr.models.simulator import Simulator
from jaxsr.models.states import spread
from jaxsr.recordings import noise_level

LENGTH = 512
"""Samples of a piece: as many passes in time as that, whatever the length of the recordings."""
SHARES = (0.0, *np.geomspace(1e-3, 1.0, 7))
"""Of the net force that the latent force may be."""
TIMES, BRIEFER = 4, 4.0
"""Times for which the latent force may keep its sign, and the factor from one to the next."""


@dataclass(frozen=True, eq=False)
class Workspace:
    """Candidates, data and beliefs.

    Attributes
    ----------
    super_model : SuperModel
        All candidates.
    columns : SuperModel
        Those without states of their own.
    place : tuple of int
        Where the candidates of `columns` stand in `super_model`.
    prepared : tuple of Prepared
    rows : tuple of (recording, start, stop)
        The pieces of recordings.
    narrow : Problem
        Of `columns`.
    theta : ndarray, shape (parameters of `super_model`,)
    scales : Scales
        `forces` are parameters of `columns`.
    force_states : tuple of int
    stop : callable
        Whether estimates are to be left where they are: time is over.
    """

    super_model: SuperModel
    columns: SuperModel
    place: tuple[int, ...]
    prepared: tuple[Prepared, ...]
    rows: tuple[tuple[int, int, int], ...]
    narrow: Problem
    theta: np.ndarray
    scales: Scales
    force_states: tuple[int, ...]
    stop: Callable[[], bool] = lambda: False

    @property
    def helpers(self) -> list[int]:
        """Candidates of the super-model that push along an equation, one each."""
        every = enumerate(self.columns.candidates)
        return [self.place[i] for i, c in every if c.mechanism == "constant_force"]

    @staticmethod
    def build(
        super_model: SuperModel,
        prepared: Sequence[Prepared],
        seconds: float,
        noise: Noise | None = None,
        stop: Callable[[], bool] = lambda: False,
        share: float = 0.0,
    ) -> Workspace:
        """Cut recordings into pieces and measure noise and forces.

        Parameters
        ----------
        seconds : float
            How long a force that nobody knows keeps its sign.
        noise : Noise, optional
            Of the sensors; what neighbouring samples tell by default.
        stop : callable
            Whether time is over.
        share : float
            Of the net force that the latent force is known to be: as far its sizes go at least.
        """
        given = super_model.given
        simple = [i for i, c in enumerate(super_model.candidates) if not c.states]
        columns = SuperModel.build(given, [super_model.candidates[i] for i in simple])
        rows = _pieces(prepared)
        outputs = np.concatenate([p.outputs for p in prepared])
        simulator = Simulator(columns.model)
        values = np.array([p.value for p in columns.model.parameters.values()])
        stepping = choose_stepping(simulator, prepared, values)
        segments = build_segments(columns.model, prepared, rows, stepping.substeps)
        narrow = Problem(simulator, stepping, segments, spread(outputs))
        interval = float(np.median([p.recording.sample_time for p in prepared]))
        forces = [i for i, c in enumerate(columns.candidates) if c.mechanism == "constant_force"]
        places = tuple(columns.index(i, coefficients_only=True)[0] for i in forces)
        states = tuple(given.states.index(columns.candidates[i].terms[0][0]) for i in forces)
        told = first_noise(given, prepared)
        decays = tuple(float(np.exp(-(BRIEFER**k) * interval / seconds)) for k in range(TIMES))
        scales = Scales(
            places,
            np.ones(len(places)),
            reaching(np.array(SHARES), share),
            decays[0],
            decays,
            told if noise is None else noise,
            told.between_neighbours,
            start_of(segments.course),
            finest_noise(given, tuple(prepared)),
        )
        if given.events:
            narrow = through_jumps(given, narrow, values, scales.noise, scales.start, states)
        theta = np.array([p.value for p in super_model.model.parameters.values()])
        place, prepared = tuple(simple), tuple(prepared)
        places = columns, place, prepared, tuple(rows)
        return Workspace(super_model, *places, narrow, theta, scales, states, stop)


def first_noise(model: Model, prepared: Sequence[Prepared]) -> Noise:
    """Return white noise of the sizes that neighbouring samples tell, at least the finest."""
    outputs = np.concatenate([p.outputs for p in prepared])
    levels = [
        np.median([noise_level(p.time, p.outputs[:, k]) for p in prepared])
        for k in range(outputs.shape[1])
    ]
    return Noise.white_of(np.maximum(np.square(levels), finest_noise(model, tuple(prepared))))


def along(work: Workspace, path: np.ndarray) -> tuple[Prepared, ...]:
    """Return the recordings with the given model's states from a path of the pieces.

    Parameters
    ----------
    path : ndarray, shape (states, samples, pieces)
    """
    values = [p.states.values.copy() for p in work.prepared]
    for k, (r, start, stop) in enumerate(work.rows):
        values[r][start:stop] = path[:, : stop - start, k].T
    return tuple(
        replace(p, states=replace(p.states, values=v))
        for p, v in zip(work.prepared, values, strict=True)
    )


def in_columns(work: Workspace, theta: np.ndarray) -> np.ndarray:
    """Return parameters of the super-model in the order of the columns' model."""
    there = {n: k for k, n in enumerate(work.super_model.model.parameters)}
    names = {}
    for i, place in enumerate(work.place):
        mine, theirs = work.columns.names[i], work.super_model.names[place]
        names |= {mine[own]: theirs[own] for own in mine}
    values = [p.value for p in work.columns.model.parameters.values()]
    for k, name in enumerate(work.columns.model.parameters):
        position = there.get(names.get(name, name))
        if position is not None:  # a switch stays off
            values[k] = theta[position]
    return np.array(values, dtype=float)


def _pieces(prepared: Sequence[Prepared]) -> list[tuple[int, int, int]]:
    """Cut unbroken stretches into pieces of about equal length, at most `LENGTH` samples."""
    rows = []
    for r, item in enumerate(prepared):
        for first, last in unbroken(item.time):
            count = -(-(last - first) // LENGTH)
            edges = np.linspace(first, last, count + 1).astype(int)
            rows += [(r, int(a), int(b)) for a, b in pairwise(edges)]
    return rows
