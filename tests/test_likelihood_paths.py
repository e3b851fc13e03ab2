"""The path of a hypothesis over the segments that free runs are cut into."""

from __future__ import annotations

import numpy as np

from jaxsr.diagnosis.likelihood.paths import path_over
from jaxsr.models import parse_model
from jaxsr.models.segments import Prepared, build_segments
from jaxsr.recordings import Recording

MODEL = """
[model]
name = "cart"
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u/m"
[readings]
y = "q"
[parameters]
m = { value = 1.0, bounds = [0.5, 2.0] }
"""
SAMPLES, STEP = 90, 0.1


def recorded(every: int = 1) -> Prepared:
    time = STEP * np.arange(0, SAMPLES, every)
    model = parse_model(MODEL)
    signals = {"u": np.sin(time), "y": 1.0 - np.cos(time)}
    return Prepared.build(model, Recording("run", time, signals))


def line(time: np.ndarray) -> np.ndarray:
    """Two states that no interpolation by lines changes."""
    return np.stack([3.0 + 2.0 * time, 7.0 - time])


def test_a_path_is_the_same_over_other_cuts_and_between_thinned_samples() -> None:
    model = parse_model(MODEL)
    whole = recorded()
    wanted = build_segments(model, [whole], [(0, 0, 20), (0, 20, 55), (0, 55, SAMPLES)], 1)
    for every, rows in ((1, [(0, 0, 40), (0, 40, SAMPLES)]), (2, [(0, 0, 30), (0, 30, 45)])):
        known = recorded(every)
        path = np.zeros((2, 50, len(rows)))
        for k, (_, a, b) in enumerate(rows):
            path[:, : b - a, k] = line(known.time[a:b])
        found = path_over(wanted, [whole], [known], rows, path)
        last = known.time[-1]
        for s, (first, count) in enumerate(zip(wanted.start, wanted.count, strict=True)):
            time = whole.time[first : first + count]
            inside = time <= last
            np.testing.assert_allclose(
                found[:, :count, s][:, inside], line(time[inside]), atol=1e-12
            )
            # Beyond what is known the sensors' own states stay.
            own = wanted.course[:, :count, s][:, ~inside]
            np.testing.assert_array_equal(found[:, :count, s][:, ~inside], own)
