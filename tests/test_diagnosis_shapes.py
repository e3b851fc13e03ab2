"""Corrections to the law of a level, where no law can be searched."""

from __future__ import annotations

import numpy as np
import pytest
from diagnosis_systems import RAIL, TANKS

from jaxsr import diagnose
from jaxsr.diagnosis.mechanisms.shapes import shapes
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.models import Simulator, parse_model
from jaxsr.recordings import Recording


def test_only_levels_and_flows_are_corrected() -> None:
    for text, count in ((TANKS, 2), (RAIL, 0)):
        model = parse_model(text)
        scale = {s: np.linspace(0.0, 1.0, 21) for s in model.states}
        found = [c for site in sites_of(model, scale) for c in shapes(site)]
        assert len(found) == count
        assert {c.family for c in found} <= {"unnamed"}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_an_outflow_of_another_law_is_said_to_have_no_name(seed: int) -> None:
    """The lower tank empties by 0.05*sqrt(h) + 0.01*h; the upper level is not measured."""
    rng = np.random.default_rng(seed)
    drive = np.repeat(rng.uniform(0.5, 4.5, 50), 12)
    upper, lower, level, fine = 4.0, 4.0, np.empty(drive.size), 40
    for k, u in enumerate(drive):
        level[k] = lower
        for _ in range(fine):
            flow = 0.06 * np.sqrt(upper)
            upper += (0.065 * u - flow) * 4.0 / fine
            lower += (flow - 0.05 * np.sqrt(lower) - 0.01 * lower) * 4.0 / fine
    y = level + 0.01 * rng.normal(size=level.size)
    recording = Recording("run.csv", 4.0 * np.arange(drive.size), {"u": drive, "y": y})
    found = diagnose(Simulator(parse_model(TANKS)), [recording], seed=0)
    assert found.verdict == "structure"
    named = {(row["mechanism"], row["site"]) for row in found.findings}
    assert ("unnamed", "equation:h2") in named
    train = found.fit["train"]
    assert train["explained"][-1] < 0.3 * train["recalibrated"][-1]
