"""Evidence does not hang on what was tried first; additions are asked about the leader's motion."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_likelihood_first_steps import recorded as joint
from test_likelihood_first_steps import weighed
from test_likelihood_search import MODEL, recorded

from jaxsr.diagnosis.likelihood import hypotheses, rounding
from jaxsr.diagnosis.likelihood.course import followed
from jaxsr.diagnosis.likelihood.hypotheses import hypothesis
from jaxsr.diagnosis.likelihood.loop import about, begun
from jaxsr.diagnosis.likelihood.offered import offered
from jaxsr.diagnosis.likelihood.scales import likeliest_size, log_odds
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.models import Simulator, parse_model
from jaxsr.models.segments import Prepared


def test_the_likeliest_size_is_the_top_of_a_parabola() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        sizes = np.cumsum(rng.uniform(0.1, 0.8, 5)) + rng.normal()
        top = rng.uniform(sizes[1], sizes[3])
        logs = -rng.uniform(0.1, 1e4) * (sizes - top) ** 2 + rng.normal()
        shares, whole = np.append(0.0, np.exp(sizes)), np.append(logs.min() - 1.0, logs)
        assert np.log(likeliest_size(shares, whole)) == pytest.approx(top, abs=1e-6)
        assert likeliest_size(shares, np.arange(6.0)) == shares[-1]
        assert likeliest_size(shares, -np.arange(6.0)) == 0.0


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_evidence_is_the_same_from_any_sizes_of_the_force(seed: int) -> None:
    """Sizes that were tried in turn differed by a quarter, and evidences by several units."""
    every, work, table, null = weighed([joint(np.random.default_rng(seed), 2.0, 32.0)])
    number = next(i for i, c in enumerate(every.candidates) if c.mechanism == "viscous_damping")
    found = []
    for factor in (1.0, 1.06, 1.12, 1.18):
        shares = factor * table.scales.shares
        begun_there = replace(table, scales=replace(table.scales, shares=shares))
        found.append(hypothesis(work, begun_there, (number,), null))
    assert all(h is not None and h.share > 0.0 for h in found)
    assert np.ptp([h.log_evidence for h in found if h is not None]) < 0.5


@pytest.mark.long
def test_additions_are_asked_about_jumps_as_round_as_those_of_the_leader() -> None:
    """With exact jumps its path is no motion of its model, and has none of its evidence."""
    simulator = Simulator(parse_model(MODEL))
    rng, prepared = np.random.default_rng(3), []
    for _ in range(2):
        run = recorded(rng, lambda q, v: -1.5 * np.tanh(v / 0.05))
        prepared.append(Prepared.build(simulator.model, run))
    course = followed(simulator.model, prepared)
    assert course is not None
    every = SuperModel.build(simulator.model, offered(simulator.model, course, ()))
    work = Workspace.build(every, course.prepared, course.seconds, course.null.noise)
    state = begun(work, course.null)
    table = state.table
    number = next(i for i, c in enumerate(every.candidates) if c.mechanism == "coulomb_friction")
    leader = hypothesis(work, table, (number,), state.known[()])
    assert leader is not None and leader.width is not None and leader.width > 0.0
    here = about(work, leader)
    own = [*here.base, *(k for k in here.own[number] if k not in here.base)]
    known = leader.log_evidence - float(log_odds(leader.share))
    assert here.best(own) == pytest.approx(known, abs=0.5)
    exact = about(work, replace(leader, width=None))
    assert exact.best(own) < known - 50.0


@pytest.mark.long
def test_noise_is_sought_anew_beside_what_does_something_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    every, work, table, null = weighed([joint(np.random.default_rng(0), 2.0, 32.0)])
    asked, likeliest = [], hypotheses.likeliest

    def counted(*args):
        asked.append(1)
        return likeliest(*args)

    monkeypatch.setattr(hypotheses, "likeliest", counted)
    for mechanism, anew in (("power_law_drag", True), ("sensor_bias", False)):
        asked.clear()
        number = next(i for i, c in enumerate(every.candidates) if c.mechanism == mechanism)
        found = hypothesis(work, table, (number,), null)
        assert found is not None
        assert (found.log_evidence > null.log_evidence + hypotheses.CLEAR) == anew
        assert bool(asked) == anew
        if not anew:
            assert found.noise is null.noise


def test_the_width_is_refined_about_a_mode_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """About what is behind and did not rest, Newton's step promises what is not there."""
    asked = []
    widths = object.__new__(rounding._Widths)  # pyright: ignore[reportPrivateUsage]
    monkeypatch.setattr(rounding._Widths, "_step", lambda self, w: asked.append(w))
    widths.follow = SimpleNamespace(best=100.0)  # pyright: ignore[reportAttributeAccessIssue]
    for log, settled, wanted in ((-1e8, False, 0), (-1e8, True, 1), (95.0, False, 1)):
        asked.clear()
        found = SimpleNamespace(log_evidence=log, settled=settled)
        widths.tried = {1.0: (None, found)}  # pyright: ignore[reportAttributeAccessIssue]
        assert widths.refined(1.0)[2] == 1.0
        assert len(asked) == wanted
