"""Of the times for which a latent force may keep its sign, the likeliest mode is kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_likelihood_first_steps import recorded, weighed

from jaxsr.diagnosis.likelihood import estimate, hypotheses
from jaxsr.diagnosis.likelihood.hypotheses import hypothesis


def test_a_time_that_is_likelier_about_one_path_alone_is_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The mode beside another time has less evidence than what led to it: that one stands."""
    every, work, table, null = weighed([recorded(np.random.default_rng(0), 2.0, 32.0)])
    assert null.share > 0.0
    first, *_, last = table.scales.decays
    number = next(i for i, c in enumerate(every.candidates) if c.mechanism == "viscous_damping")

    climb = estimate._Climb  # pyright: ignore[reportPrivateUsage]
    to_the_mode, asked = climb.to_the_mode, []

    def promised(self, point, scales):
        """The other time promises two units about the path of the first."""
        other = last if scales.decay == first else first
        asked.append(other)
        return replace(point, logs=point.logs + 2.0), other

    def reached(self, point, scales):
        """Its own mode has five less than it promises."""
        found, settled = to_the_mode(self, point, scales)
        if scales.decay == first:
            return found, settled
        return replace(found, logs=found.logs - found.log + point.log - 5.0), settled

    # Beside one noise: another would be sought from wherever this ends.
    monkeypatch.setattr(
        hypotheses, "likeliest", lambda found, scales, *_: (scales.noise, found.decay, 0.0)
    )
    alone = replace(table, scales=replace(table.scales, decay=first, decays=(first,)))
    near = replace(null, decay=first)
    expected = hypothesis(work, alone, (number,), near)
    monkeypatch.setattr(climb, "in_other_time", promised)
    monkeypatch.setattr(climb, "to_the_mode", reached)
    both = replace(table, scales=replace(table.scales, decay=first, decays=(first, last)))
    found = hypothesis(work, both, (number,), near)
    assert asked and expected is not None and found is not None
    assert found.decay == first
    assert found.log_evidence == pytest.approx(expected.log_evidence, abs=1e-6)
