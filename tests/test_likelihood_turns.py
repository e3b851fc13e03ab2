"""What is tried beside a latent force, and when free runs bear a decision out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from jaxsr._result import StoppedBy
from jaxsr.diagnosis import settled
from jaxsr.diagnosis.decision import Decision
from jaxsr.diagnosis.judging.detection import Detection
from jaxsr.diagnosis.likelihood import additions as promised
from jaxsr.diagnosis.likelihood import loop
from jaxsr.diagnosis.likelihood.sensor_noise import Noise
from jaxsr.diagnosis.likelihood.state import State
from jaxsr.diagnosis.shooting.entry import Entry

PLAIN = 12
"""Candidates; the last is what the force stands for."""


@dataclass(frozen=True)
class Promises:
    """Log evidence by size of the latent force, and what each column adds to it."""

    grams: list[tuple[float, Mapping[int, float]]]
    base: tuple[int, ...] = ()
    own: Mapping[int, tuple[int, ...]] = field(
        default_factory=lambda: {i: (i,) for i in range(PLAIN)}
    )

    def best(self, columns: Sequence[int]) -> float:
        return max(log + sum(adds.get(k, 0.0) for k in columns) for log, adds in self.grams)


def additions(share: float) -> list[int]:
    """What is tried about re-calibration, in turn."""
    candidates = [
        SimpleNamespace(label=str(i), states=(), mechanism="law", site=str(i)) for i in range(PLAIN)
    ]
    state: Any = SimpleNamespace(
        work=SimpleNamespace(super_model=SimpleNamespace(candidates=candidates), force_states=(0,)),
        offered=PLAIN,
    )
    with_force = 0.0, {i: PLAIN - 1.0 - i for i in range(PLAIN)}
    without = -1e4, {PLAIN - 1: 500.0, 0: 100.0}
    table: Any = Promises([without, with_force])
    leader: Any = SimpleNamespace(members=(), share=share)
    return promised.additions(state, table, leader)[0]


def test_what_a_latent_force_stands_for_is_tried_though_it_promises_nothing_beside_it() -> None:
    turns = additions(0.1)
    assert turns[0] == 0 and turns[1] == PLAIN - 1
    assert sorted(turns) == list(range(PLAIN))


def test_where_there_is_no_force_candidates_come_by_their_promise() -> None:
    assert additions(0.0) == list(range(PLAIN))


def decision(left: float, detected: bool) -> Decision:
    """A decision whose set leaves a share of what re-calibration leaves."""
    residual = np.ones((1, 50, 2))
    null, chosen = (
        Entry(members, cast(Any, SimpleNamespace(cost=cost, residual=residual)))
        for members, cost in (((), 1.0), ((0,), left))
    )
    arena: Any = SimpleNamespace(problem=SimpleNamespace(scale=np.ones(1)))
    test = Detection(detected, 0.0, 1.0, 0.0, 1e-3)
    return Decision(arena, [null, chosen], chosen, 1.0, StoppedBy.CONVERGED, test)


@pytest.mark.parametrize(
    ("left", "ratio", "detected", "force", "noise", "stands"),
    [
        (0.9, 1.0, False, 0.0, 7.0, True),
        # Of a hundred readings: under a unit of log likelihood.
        (1.019, 1.0, False, 0.0, 7.0, True),
        (1.03, 1.0, True, 0.0, 7.0, False),
        (np.inf, 1.0, False, 0.0, 7.0, False),
        (np.nan, 1.0, False, 0.0, 7.0, False),
        (0.3, 7.0, True, 0.0, 7.0, False),
        (0.08, 7.0, True, 0.0, 7.0, False),
        (0.08, 7.0, True, 0.0, 1.0, True),  # no more is taken for noise than the sensor has
        (0.08, 7.0, True, 0.1, 7.0, True),
        (0.08, 7.0, False, 0.1, 7.0, False),
        (0.1, 7.0, True, 0.1, 1.0, False),  # something else acts as well
    ],
)
def test_a_decision_stands_on_noise_or_explains_most_of_what_no_noise_is(
    monkeypatch: pytest.MonkeyPatch,
    left: float,
    ratio: float,
    detected: bool,
    force: float,
    noise: float,
    stands: bool,
) -> None:
    monkeypatch.setattr(settled, "residual_to_noise", lambda *_: ratio)
    monkeypatch.setattr(settled, "sensor_noise", lambda *_: 0.1)
    own = Noise.white_of(np.array([0.01 * noise**2]))
    leader: Any = SimpleNamespace(share=force, settled=True, noise=own)
    assert settled.borne_out(decision(left, detected), leader) == stands
    leader.settled = False
    assert settled.borne_out(decision(left, detected), leader) == (stands and ratio == 1.0)


def test_a_bias_that_wanders_is_noise_where_the_evidence_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(settled, "ratios_to_noise", lambda *_: [7.0])
    found = decision(0.3, True)
    for size, noise_alone in ((2.0, True), (0.1, False)):
        wandering = Noise(np.array([1e-2]), np.array([size]), np.array([0.998]))
        assert settled.above_noise(found, wandering) != noise_alone


def test_another_search_begins_from_what_shares_nothing_with_the_set_that_led(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What led and what shares a member with it is known, and not estimated again."""

    def weighed(members: tuple[int, ...], log: float) -> Any:
        return SimpleNamespace(members=members, log_evidence=log, settled=True)

    sets = {(): 0.0, (0,): 9.0, (1,): 5.0, (0, 1): 8.0}
    state = State(cast(Any, None), cast(Any, None), {m: weighed(m, v) for m, v in sets.items()})
    state = replace(state, grown=frozenset({(0,)}))
    began: list[State] = []

    def grown(state: State, *_: object) -> State:
        began.append(state)
        more = {(1, 2): weighed((1, 2), 12.0)}
        return replace(state, known={**state.known, **more}, grown=frozenset({(1, 2)}))

    monkeypatch.setattr(loop, "grown", grown)
    found = loop.grown_apart(state, (0,))
    assert {m for m, h in began[0].known.items() if h is None} == {(0,), (0, 1)}
    assert not began[0].grown
    assert {m: h.log_evidence for m, h in found.known.items() if h} == sets | {(1, 2): 12.0}
    assert found.grown == {(0,), (1, 2)}
