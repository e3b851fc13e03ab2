"""What the motion of given bodies asks of their joints, by momentum: no acceleration is estimated.

With test functions phi, momentum p = M(q) v, and f the passive forces less those of gravity and
motion, the force that a joint's drive and what is missing give is

    int phi (dp/dt - f - dM/dt v) dt.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr.models.formats.plant import Plant, mujoco, quietly
from jaxsr.models.model import Model
from jaxsr.models.segments import Prepared, unbroken
from jaxsr.recordings import Recording
from jaxsr.views import WeakView
from jaxsr.views.half_width import choose_half_widths

STEP = 1e-6
"""Step in s by which the change of the mass matrix along a motion is taken."""
MOST_SAMPLES = 20_000
"""Samples that are looked at."""
NARROWEST = 8
"""Least half-width of a test function, in samples."""


@dataclass(frozen=True, eq=False)
class Asked:
    """One unbroken stretch of a motion.

    Attributes
    ----------
    view : WeakView
    time : ndarray, shape (samples,)
    position, rate : ndarray, shape (samples, joints)
        0 where they are unknown.
    inputs : ndarray, shape (samples, inputs)
    good : ndarray of bool, shape (samples,)
        Where position and rate are known.
    force : ndarray, shape (tests, joints)
        What the motion asks of every joint.
    """

    view: WeakView
    time: np.ndarray
    position: np.ndarray
    rate: np.ndarray
    inputs: np.ndarray
    good: np.ndarray
    force: np.ndarray


def unseen(model: Model, recording: Recording) -> str:
    """Return a state that no sensor tells, empty where all are seen."""
    return min(Prepared.build(model, recording).states.hidden, default="")


def asked(plant: Plant, model: Model, recordings: Sequence[Recording]) -> Iterator[Asked]:
    """Yield what the stretches of recordings ask of the joints; every position has a sensor."""
    most, n = MOST_SAMPLES // max(len(recordings), 1), plant.m.nv
    for recording in recordings:
        item = Prepared.build(model, recording)
        for first, last in unbroken(item.time[:most]):
            time, states = item.time[first:last], item.states.values[first:last]
            q, v = states[:, :n], states[:, n : 2 * n]
            good = np.asarray(np.isfinite(states[:, : 2 * n]).all(axis=1))
            width = _half_width(time[good], q[good])
            if width is None or 2.0 * width > time[-1] - time[0]:
                continue
            q, v = np.where(good[:, None], q, 0.0), np.where(good[:, None], v, 0.0)
            view = WeakView.build(time, width, mask=good)
            momentum, force = _balance(plant, q, v)
            own = view.integrate(momentum, 1) - view.integrate(force)
            yield Asked(view, time, q, v, item.inputs[first:last], good, own)


def _half_width(time: np.ndarray, q: np.ndarray) -> float | None:
    moving = np.ptp(q, axis=0) > 0.0 if len(q) else np.zeros(q.shape[1], bool)
    if len(q) < 4 * NARROWEST or not moving.any():
        return None
    least = NARROWEST * float(np.median(np.diff(time)))
    return max(min(choose_half_widths(time, q[:, moving])), least)


def _balance(plant: Plant, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return M v and passive forces - bias + dM/dt v along a motion, actuators apart."""
    library, m = mujoco(), copy.copy(plant.m)
    m.opt.disableflags |= int(library.mjtDisableBit.mjDSBL_CONSTRAINT)
    data, place = library.MjData(m), m.jnt_qposadr
    momentum, force = np.empty_like(v), np.empty_like(v)
    ends = np.empty((2, v.shape[1]))
    with quietly(library):
        for k in range(len(v)):
            for side, shift in enumerate((STEP, -STEP)):
                data.qpos[place], data.qvel = q[k] + shift * v[k], v[k]
                library.mj_fwdPosition(m, data)
                library.mj_mulM(m, data, ends[side], v[k])
            data.qpos[place] = q[k]
            library.mj_fwdPosition(m, data)
            library.mj_fwdVelocity(m, data)
            library.mj_mulM(m, data, momentum[k], v[k])
            force[k] = data.qfrc_passive - data.qfrc_bias + (ends[0] - ends[1]) / (2.0 * STEP)
    return momentum, force
