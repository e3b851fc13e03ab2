"""Segments with fewer steps between samples are those built with as many from the start."""

from __future__ import annotations

import numpy as np
import pytest

from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.shooting.reduced import restepped
from jaxsr.models import parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, Segments, build_segments, cut, unbroken
from jaxsr.recordings import Recording

MODEL = """
[model]
name = "turntable"
states = ["phi", "x", "w", "v"]
inputs = ["u"]
outputs = ["y"]
input_hold = "HOLD"
[equations]
phi = "w"
x = "v"
w = "u - 2*sin(phi) - 0.1*w"
v = "-x - 0.1*v"
[readings]
y = "phi + x"
"""


def segments_of(hold: str, substeps: int) -> Segments:
    """Segments of a noisy recording with uneven samples."""
    model = parse_model(MODEL.replace("HOLD", hold))
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.uniform(0.01, 0.02, 60))
    signals = {"u": rng.normal(size=60), "y": rng.normal(size=60)}
    items = [Prepared.build(model, Recording("a.csv", time, signals))]
    return build_segments(model, items, cut(items, 0.3), substeps)


@pytest.mark.parametrize("hold", ["zero", "linear"])
@pytest.mark.parametrize(("many", "few"), [(4, 2), (4, 1), (6, 2), (6, 3), (3, 1)])
def test_segments_have_the_inputs_of_coarser_and_of_finer_steps(hold, many, few):
    fine, coarse = segments_of(hold, many), segments_of(hold, few)
    for found, expected in ((fine.coarsened(few), coarse), (coarse.refined(many // few), fine)):
        np.testing.assert_allclose(found.length, expected.length, rtol=1e-12)
        np.testing.assert_allclose(found.stages, expected.stages, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("hold", ["zero", "linear"])
@pytest.mark.parametrize("old", [1, 2, 3, 8, 11])
@pytest.mark.parametrize("new", [1, 2, 3, 8, 11])
def test_any_number_of_steps_follows_any_other(hold: str, old: int, new: int) -> None:
    """A memory of eleven steps had no two of implicit steps beside dry friction."""
    steps = Stepping("rk4", old, ()), Stepping("rk4", new, ())
    found, expected = restepped(segments_of(hold, old), steps[1], steps[0]), segments_of(hold, new)
    np.testing.assert_allclose(found.length, expected.length, rtol=1e-12)
    np.testing.assert_allclose(found.stages, expected.stages, rtol=1e-12, atol=1e-12)


def test_angles_without_a_unit_are_known_by_their_sine():
    model = parse_model(MODEL.replace("HOLD", "zero"))
    turning = {site.position: site.turning for site in sites_of(model, {})}
    assert turning == {"phi": True, "x": False}
    stated = (
        MODEL.replace("HOLD", "zero").replace("phi + x", "phi") + '[units]\nphi = "1"\nx = "m"\n'
    )
    turning = {site.position: site.turning for site in sites_of(parse_model(stated), {})}
    assert turning == {"phi": True, "x": False}


def test_no_segment_goes_across_a_break_in_the_rows() -> None:
    """Two stretches of 200 rows, 30 s apart, and one row after another pause of 30 s."""
    time = np.concatenate([0.01 * np.arange(200), 32.0 + 0.01 * np.arange(200), [64.0]])
    assert unbroken(time) == [(0, 200), (200, 400)]
    model = parse_model(
        '[model]\nstates = ["x"]\noutputs = ["y"]\n[equations]\nx = "-x"\n[readings]\ny = "x"\n'
    )
    item = Prepared.build(
        model, Recording("a.csv", time, {"y": np.cos(time) + np.exp(-(time % 32.0))})
    )
    assert cut([item], None) == [(0, 0, 200), (0, 200, 400)]
    assert all(b - a <= 51 and (b <= 200) == (a < 200) for _, a, b in cut([item], 0.5))
    wide = build_segments(model, [item], [(0, 150, 200), (0, 200, 250)], 1, margin=25)
    assert wide.start.tolist() == [125, 200] and np.diff(wide.time, axis=0).max() < 0.02
