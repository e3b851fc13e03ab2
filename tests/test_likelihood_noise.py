"""Slow noise and a latent force tell the same story; the search hears both."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import jaxsr
from jaxsr.diagnosis.likelihood.course import followed
from jaxsr.diagnosis.likelihood.hypotheses import hypothesis
from jaxsr.diagnosis.likelihood.kalman import Noise
from jaxsr.diagnosis.likelihood.loop import begun
from jaxsr.diagnosis.likelihood.offered import offered
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import prepare

WANDERS = 0.25
"""Innovation of the noise, in m."""
FALL = """
[model]
states = ["y", "v"]
outputs = ["height"]
[equations]
y = "v"
v = "-g"
[readings]
height = "y"
[parameters]
g = { value = 9.8, unit = "m/s^2" }
[initial]
y = "free"
v = "free"
[units]
y = "m"
v = "m/s"
height = "m"
"""


def drop(folder: Path, seed: int) -> list[Path]:
    """Height of a ball with linear drag, 52 frames, in noise that wanders from frame to frame."""
    rng, drag, time = np.random.default_rng(seed), 0.55, np.arange(52) / 15.0
    height = 40.0 - 9.8 / drag * (time - (1.0 - np.exp(-drag * time)) / drag)
    noise = np.zeros(52)
    for k in range(1, 52):
        noise[k] = 0.6 * noise[k - 1] + WANDERS * rng.standard_normal()
    path = folder / "drop.csv"
    np.savetxt(path, np.c_[time, height + noise], delimiter=",", header="t,height", comments="")
    return [path]


def short(seed: int, folder: Path) -> float:
    """Return by how much the search's evidence of drag is less than that beside the true noise."""
    file = folder / "fall.toml"
    file.write_text(FALL)
    model = jaxsr.Simulator.from_file(file).model
    course = followed(model, prepare(model, drop(folder, seed)))
    assert course is not None
    super_model = SuperModel.build(model, offered(model, course, ()))
    work = Workspace.build(super_model, course.prepared, course.seconds, course.null.noise)
    state, table = begun(work, course.null)
    every, null = enumerate(super_model.candidates), state.known[()]
    drag = next(i for i, c in every if c.mechanism == "power_law_drag")
    assert null is not None
    found = hypothesis(work, table, (drag,), null)
    slow = Noise(np.array([2e-3]), np.array([WANDERS**2 / (1.0 - 0.6**2)]), np.array([0.6]))
    calm = replace(table, scales=replace(table.scales, shares=np.zeros(1)))
    true = hypothesis(work, calm, (drag,), replace(null, noise=slow, share=0.0))
    assert found is not None and true is not None
    return true.log_evidence - found.log_evidence


def test_slow_noise_is_told_from_a_force_wherever_the_search_begins(tmp_path: Path) -> None:
    """It begins at re-calibration, whose noise is white and whose missing force is large.

    One unit less in a fifth of the draws is what grids of sizes and correlations leave.
    """
    missed = np.array([short(seed, tmp_path) for seed in range(24)])
    assert missed.max() < 2.0
    assert np.sum(missed > 1.0) <= 24 / 5
