"""Recordings of a simulator that has no noise: no sensor is taken for finer than a converter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.planted import misjudged, within
from benchmarks.saturated_machines import MACHINES
from jaxsr.diagnosis import diagnose
from jaxsr.diagnosis.likelihood.scales import LOUDEST, Scales
from jaxsr.diagnosis.likelihood.sensor_noise import Noise
from jaxsr.diagnosis.shooting.converters import BITS, finest_noise
from jaxsr.models import Simulator
from jaxsr.models.segments import Prepared
from jaxsr.recordings.converter import uniform_variance

OVEN = MACHINES["oven"].machine


def test_no_noise_is_finer_than_a_step_or_a_converter() -> None:
    rng = np.random.default_rng(0)
    (recording, _) = OVEN.recordings(rng, False, noise=0.0)
    reading = recording.channel("inside")
    for step in (None, 2.0**-6 * np.ptp(reading)):
        read = reading if step is None else step * np.round(reading / step)
        item = Prepared.build(
            OVEN.model, replace(recording, channels={**recording.channels, "inside": read})
        )
        wanted = uniform_variance(np.ptp(reading) / 2.0**BITS if step is None else step)
        assert finest_noise(OVEN.model, (item,)) == pytest.approx([wanted], rel=1e-9)


def test_the_factor_on_the_noise_leaves_every_sensor_its_finest_and_what_neighbours_tell() -> None:
    rng, apart = np.random.default_rng(1), 0
    for _ in range(100):
        told, white, coloured = 10.0 ** rng.uniform(-4.0, 4.0, (3, 2))
        noise = Noise(white, coloured, np.array([0.9, 0.0]))
        finest = told * 10.0 ** rng.uniform(-6.0, 0.0, 2)
        none = np.zeros(0)
        scales = Scales((), none, none, 0.0, (), noise, told, none, finest)
        quietest, loudest = scales.factors
        near = noise.scaled(loudest).between_neighbours
        assert (near <= LOUDEST * told * (1 + 1e-9)).all() and 0.0 < quietest <= loudest
        if quietest < loudest:
            apart += 1
            whole = noise.scaled(quietest)
            assert (whole.white + whole.coloured >= finest * (1 - 1e-9)).all()
    assert 20 < apart < 100  # both are met


@pytest.mark.parametrize("lacking", [False, True])
def test_a_simulated_oven_has_its_values_and_its_law(lacking: bool) -> None:
    rng = np.random.default_rng(2)
    recordings = OVEN.recordings(rng, lacking, noise=0.0)
    found = diagnose(Simulator(misjudged(OVEN.model, rng)), recordings, budget=60.0)
    laws = [f["mechanism"] for f in found.findings if f["mechanism"] != "wrong_value"]
    assert laws == ["quadratic_drag"] * lacking
    assert found.verdict == ("structure" if lacking else "parameter")
    inside, of = within(OVEN.model, found.document["calibration"])
    assert inside == of == 2
    assert found.document["provenance"]["stopped_by"] == "converged"
