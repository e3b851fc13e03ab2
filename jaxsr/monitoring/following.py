"""A model along windows of its recordings, and the likelihood of what the sensors read there.

The one module of this package that knows the likelihood of the diagnosis: it linearises the
simulator's own step map, runs its Kalman filter, and gives a logarithm for every window.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr._result import InputError
from jaxsr.diagnosis.likelihood.kalman import Latent, System, smoothed, whitened
from jaxsr.diagnosis.likelihood.local import LocalModel, linearised
from jaxsr.diagnosis.likelihood.sensor_noise import Noise
from jaxsr.diagnosis.likelihood.steps import resolved
from jaxsr.diagnosis.likelihood.workspace import first_noise, start_of
from jaxsr.diagnosis.mechanisms.inertial import inertial
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import state_scale
from jaxsr.diagnosis.shooting.integration import choose_stepping
from jaxsr.models import Model, Simulator
from jaxsr.models.least_squares import Problem
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, Segments, build_segments
from jaxsr.models.states import spread

ROUNDS = 6
"""Linearisations of one window, at most."""
RESTING = 1e-3
"""Step of a path, in the state's deviation, that ends them."""
LANES = 64
"""Windows that are followed side by side."""


@dataclass(frozen=True)
class Window:
    """Samples of a recording that are judged, and those before them that lead the filter there.

    Attributes
    ----------
    recording, start, first, stop : int
        The recording's place; samples ``start`` to ``first`` lead, ``first`` to ``stop`` are
        judged.
    """

    recording: int
    start: int
    first: int
    stop: int


@dataclass(frozen=True, eq=False)
class Filter:
    """What a filter believes of the sensors' noise and of the force that nobody knows.

    Attributes
    ----------
    noise : Noise
    scale : ndarray, shape (forces,)
        Standard deviation of the unknown force along every equation.
    decay : float
        Its correlation from one sample to the next.
    """

    noise: Noise
    scale: np.ndarray
    decay: float


@dataclass(frozen=True, eq=False)
class Followed:
    """Windows, linearised along the motion that the model follows there.

    Attributes
    ----------
    local : LocalModel
        Of the windows side by side.
    leading : LocalModel
        The same up to the samples that are judged.
    finite : ndarray of bool, shape (windows,)
        Whether the model has a motion there at all.
    readings : int
        Of the sensors, that are judged.
    """

    local: LocalModel
    leading: LocalModel
    finite: np.ndarray
    readings: int


@dataclass(frozen=True, eq=False)
class Follower:
    """A model whose equations each carry a force that nobody knows.

    Attributes
    ----------
    model : Model
    simulator : Simulator
        With a constant force along every equation of motion, of value 0.
    stepping : Stepping
    theta : ndarray, shape (parameters,)
    forces : tuple of int
        Where these forces are among the parameters.
    sites : tuple of str
        Where they act.
    start : ndarray, shape (states,)
        Variances of the states at the start of a window, about the path.
    size : ndarray, shape (forces,)
        Rms of the net force along the equations.
    noise : Noise
        White, of the size that neighbouring samples tell.
    spread : ndarray, shape (outputs,)
        Standard deviations of the readings.
    """

    model: Model
    simulator: Simulator
    stepping: Stepping
    theta: np.ndarray
    forces: tuple[int, ...]
    sites: tuple[str, ...]
    start: np.ndarray
    size: np.ndarray
    noise: Noise
    spread: np.ndarray

    @staticmethod
    def of(model: Model, prepared: Sequence[Prepared]) -> Follower:
        """Lay forces along the equations of a model; sizes are those of normal recordings.

        Raises
        ------
        InputError
            The model has events: no filter goes across a jump of the state.
        """
        if model.events:
            remedy = "Give the model without [[events]]"
            raise InputError("a state that jumps cannot be monitored", model.name, remedy)
        sites = sites_of(model, state_scale(model, prepared))
        pushes = [c for s in sites for c in inertial(s) if c.mechanism == "constant_force"]
        columns = SuperModel.build(model, pushes)
        simulator = Simulator(columns.model)
        theta = np.array([p.value for p in columns.model.parameters.values()])
        stepping = choose_stepping(simulator, prepared, theta)
        course = np.concatenate([p.states.values for p in prepared])
        follower = Follower(
            model,
            simulator,
            stepping,
            theta,
            tuple(columns.index(k, coefficients_only=True)[0] for k in range(len(pushes))),
            tuple(c.site for c in pushes),
            start_of(course.T[:, :, None]),
            np.ones(len(pushes)),
            first_noise(model, prepared),
            spread(np.concatenate([p.outputs for p in prepared])),
        )
        places = [model.states.index(c.terms[0][0]) for c in pushes]
        return replace(follower, size=follower._sizes(prepared, places))

    def _sizes(self, prepared: Sequence[Prepared], places: Sequence[int]) -> np.ndarray:
        """Return the rms forces that would move the states as they move."""
        moved, effect = list[np.ndarray](), list[np.ndarray]()
        for number, item in enumerate(prepared):
            count = item.time.size
            segments, path = self._segments(prepared, [Window(number, 0, 0, count)])
            args = self.simulator, self.stepping, segments, self.theta, path, self.forces
            moved.append(np.diff(path[places, :, 0], axis=1))
            effect.append(linearised(*args).by_constant[:, 0][:, places, range(len(places))])
        size = np.sqrt(np.mean(np.concatenate(moved, axis=1) ** 2, axis=1))
        push = np.sqrt(np.mean(np.concatenate(effect) ** 2, axis=0))
        return np.divide(size, push, out=np.zeros(len(places)), where=push > 0.0)

    def _segments(
        self, prepared: Sequence[Prepared], windows: Sequence[Window]
    ) -> tuple[Segments, np.ndarray]:
        rows = [(w.recording, w.start, w.stop) for w in windows]
        model, substeps = self.simulator.model, self.stepping.substeps
        segments = build_segments(model, prepared, rows, substeps)
        return segments, segments.course.copy()

    def follow(
        self, prepared: Sequence[Prepared], windows: Sequence[Window], filter: Filter
    ) -> Followed:
        """Linearise along windows, each about the motion that a filter and smoother finds.

        Parameters
        ----------
        prepared : sequence of Prepared
        windows : sequence of Window
            At most about `LANES` at once.
        filter : Filter
        """
        segments, path = self._segments(prepared, windows)
        args = self.simulator, self.stepping, segments, self.theta
        scale = np.sqrt(self.start)[:, None, None]
        local = linearised(*args, path, self.forces)
        finite = _finite(local)
        for _ in range(ROUNDS):
            with np.errstate(all="ignore"):
                moved = smoothed(self._system(local, [filter]), len(path))
            told = np.isfinite(moved).all(axis=(0, 1))
            moved[:, :, ~(told & finite)] = 0.0
            local = linearised(*args, path + moved, self.forces)
            good = _finite(local)
            if not good[finite].all():  # half a step, where a whole one leaves the model's domain
                moved[:, :, finite & ~good] *= 0.5
                local = linearised(*args, path + moved, self.forces)
                good = _finite(local)
            path, finite = path + moved, finite & told & good
            if np.max(np.abs(moved) / scale, initial=0.0) < RESTING:
                break
        judged = [w.first - w.start for w in windows]
        leading = _up_to(local, judged)
        count = np.isfinite(local.innovation).sum() - np.isfinite(leading.innovation).sum()
        return Followed(local, leading, finite, int(count))

    def resolved(
        self, prepared: Sequence[Prepared], windows: Sequence[Window], filter: Filter
    ) -> Follower:
        """Return the follower with the fewest steps whose errors the sensors would not see."""
        segments, path = self._segments(prepared, windows)
        problem = Problem(self.simulator, self.stepping, segments, self.spread)
        found = resolved(problem, self.theta, path, filter.noise, self.start, self.forces)
        return replace(self, stepping=found.stepping)

    def log_likelihoods(self, followed: Followed, filters: Sequence[Filter]) -> np.ndarray:
        r"""Return the log density of what is judged, given what leads there.

        .. math:: \log p(y_{b} \mid y_{a}) = \log p(y_{a}, y_{b}) - \log p(y_{a})

        Returns
        -------
        ndarray, shape (filters, windows)
            NaN where the model has no motion.
        """
        whole = self._logs(followed.local, filters)
        found = whole - self._logs(followed.leading, filters)
        return np.where(followed.finite & np.isfinite(found), found, np.nan)

    def _logs(self, local: LocalModel, filters: Sequence[Filter]) -> np.ndarray:
        with np.errstate(all="ignore"):
            found = whitened(self._system(local, filters))
            score = found.log_determinant + np.sum(found.rows[..., 0] ** 2, axis=1)
        return -0.5 * score.reshape(len(filters), -1)

    def _system(self, local: LocalModel, filters: Sequence[Filter]) -> System:
        """Return the state space of every filter about one linearisation."""
        entering, read = local.by_constant, local.reading_by_constant
        latent = [Latent(entering, f.scale, f.decay, read) for f in filters]
        at = local.moved(np.zeros(len(self.forces)))
        return System.of(at, latent, [f.noise for f in filters], self.start)


def _finite(local: LocalModel) -> np.ndarray:
    """Return which windows have finite steps, shape (windows,)."""
    return np.asarray(np.isfinite(local.defect).all(axis=(0, 2)))


def _up_to(local: LocalModel, counts: Sequence[int]) -> LocalModel:
    """Return a model's first samples, the window's own number of them."""
    last = max(max(counts), 2)
    innovation = local.innovation[:last].copy()
    for k, count in enumerate(counts):
        innovation[count:, k] = np.nan
    return LocalModel(
        local.defect[: last - 1],
        local.by_state[: last - 1],
        local.by_constant[: last - 1],
        innovation,
        local.reading[:last],
        local.reading_by_constant[:last],
    )
