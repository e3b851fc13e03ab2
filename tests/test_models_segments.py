"""Segments with fewer steps between samples are those built with as many from the start."""

from __future__ import annotations

import numpy as np
import pytest

from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.models import parse_model
from jaxsr.models.segments import Prepared, build_segments, cut
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


@pytest.mark.parametrize("hold", ["zero", "linear"])
@pytest.mark.parametrize(("many", "few"), [(4, 2), (4, 1), (6, 2), (6, 3), (3, 1)])
def test_coarsened_segments_have_the_inputs_of_coarser_steps(hold, many, few):
    model = parse_model(MODEL.replace("HOLD", hold))
    rng = np.random.default_rng(many)
    time = np.cumsum(rng.uniform(0.01, 0.02, 60))
    signals = {"u": rng.normal(size=60), "y": rng.normal(size=60)}
    items = [Prepared.build(model, Recording("a.csv", time, signals))]
    rows = cut(items, 0.3)
    found = build_segments(model, items, rows, many).coarsened(few)
    expected = build_segments(model, items, rows, few)
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


@pytest.mark.parametrize("hold", ["zero", "linear"])
@pytest.mark.parametrize(("few", "factor"), [(1, 2), (1, 4), (2, 3), (3, 2)])
def test_refined_segments_have_the_inputs_of_finer_steps(hold, few, factor):
    model = parse_model(MODEL.replace("HOLD", hold))
    rng = np.random.default_rng(few)
    time = np.cumsum(rng.uniform(0.01, 0.02, 60))
    signals = {"u": rng.normal(size=60), "y": rng.normal(size=60)}
    items = [Prepared.build(model, Recording("a.csv", time, signals))]
    rows = cut(items, 0.3)
    found = build_segments(model, items, rows, few).refined(factor)
    expected = build_segments(model, items, rows, few * factor)
    np.testing.assert_allclose(found.length, expected.length, rtol=1e-12)
    np.testing.assert_allclose(found.stages, expected.stages, rtol=1e-12, atol=1e-12)
