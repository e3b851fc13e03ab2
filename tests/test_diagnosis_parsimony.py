"""Names are no richer than what a set leaves allows."""

from __future__ import annotations

from itertools import combinations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxsr._result import Verdict
from jaxsr.diagnosis.judging import nesting, parsimony
from jaxsr.diagnosis.judging.parsimony import (
    fewer_do,
    fewest,
    simpler,
    without_given,
)

GIVEN = {"J": 0.02, "Fc": 0.0, "kt": 0.0}
FRICTION, VALUE, DRIFT = 0, 1, 2
SAMPLES = 4000


def arena() -> Any:
    """Return an arena of friction Fc, a wrong value of J and a drift kt, two sensors with noise."""
    candidates = [SimpleNamespace(fixed_parameter=n) for n in (None, "J", None)]
    parameters = {n: SimpleNamespace(value=v) for n, v in GIVEN.items()}
    model = SimpleNamespace(parameters=parameters)
    return SimpleNamespace(super_model=SimpleNamespace(candidates=candidates, model=model))


def entry(*members: int) -> Any:
    return SimpleNamespace(members=members)


def estimate(value: float) -> Any:
    return SimpleNamespace(
        positions={"J": 0, "Fc": 1},
        theta=np.array([value, 0.15, 0.0]),
        told=np.array([5e-4, 1e-2, 1e-2]),
    )


@pytest.mark.parametrize(("value", "left"), [(0.0199, True), (0.0206, False)])
def test_a_value_that_may_be_the_given_one_is_left_out(value: float, left: bool) -> None:
    known = [entry(), entry(FRICTION), entry(FRICTION, VALUE)]
    smaller = without_given(known[-1], arena(), known, estimate(value))
    assert smaller is (known[1] if left else None)


def test_what_was_not_estimated_or_would_leave_nothing_is_not_taken() -> None:
    both = entry(FRICTION, VALUE)
    assert without_given(both, arena(), [entry(), both], estimate(0.02)) is None
    alone = entry(VALUE)
    assert without_given(alone, arena(), [entry(), alone], estimate(0.02)) is None


def estimated(members: tuple[int, ...], residual: np.ndarray, constants: int = 0) -> Any:
    """Return a set that leaves so much in two sensors; a constant a member unless told."""
    cost = float(np.sum(residual**2))
    fit = SimpleNamespace(residual=residual, usable=True, cost=cost, theta=None, path=None)
    return SimpleNamespace(members=members, constants=constants or len(members), fit=fit)


@pytest.fixture(autouse=True)
def known_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the ratio to the noise be that of the residuals, whose noise is 1."""
    monkeypatch.setattr(
        parsimony, "ratios_to_noise", lambda _, e: [float(np.std(r)) for r in e.fit.residual]
    )


def sets(rng: np.random.Generator, left: float, more: tuple[float, float]) -> list[Any]:
    """Return no friction, friction, and a law of two constants in its place, which explains `more`.

    What nobody names and what the richer law explains have rms values in noise in two sensors.
    """
    unnamed, extra, noise = rng.standard_normal((3, 2, SAMPLES))
    rest = noise + left * unnamed
    plain = estimated((FRICTION,), rest + np.array(more)[:, None] * extra)
    return [estimated((), 90.0 * noise), plain, estimated((DRIFT,), rest, constants=2)]


@pytest.mark.parametrize("seed", range(20))
def test_a_richer_law_stands_where_it_explains_more_than_is_left(seed: int) -> None:
    rng = np.random.default_rng(seed)
    left, more = 10.0 ** rng.uniform(-0.5, 1.5, 2)
    _, plain, richer = sets(rng, left, (more, more))
    if abs(np.log(more / left)) > 0.3:  # waves and noise are not quite orthogonal
        assert simpler(richer, arena(), [plain]) is (plain if left > more else None)


def test_one_sensor_that_tells_it_is_enough() -> None:
    entries = sets(np.random.default_rng(0), 5.0, (9.0, 0.0))
    assert simpler(entries[-1], arena(), entries[1:2]) is None


def test_noise_alone_imitates_nothing() -> None:
    entries = sets(np.random.default_rng(0), 0.0, (0.3, 0.3))
    assert simpler(entries[-1], arena(), entries[1:2]) is None


def test_a_law_with_as_many_constants_takes_no_place() -> None:
    _, plain, richer = sets(np.random.default_rng(0), 30.0, (2.0, 2.0))
    assert simpler(plain, arena(), [plain]) is None
    assert simpler(plain, arena(), [richer]) is None


@pytest.mark.parametrize("wanted", [Verdict.STRUCTURE, Verdict.MEASUREMENT])
def test_sets_that_need_not_be_estimated_change_no_answer(wanted: Verdict) -> None:
    """Of four members the smallest sets first, until more members are not asked."""
    said = Verdict.STRUCTURE, Verdict.STRUCTURE, Verdict.MEASUREMENT, Verdict.STRUCTURE
    candidates = [SimpleNamespace(verdict=verdict) for verdict in said]
    four: Any = SimpleNamespace(super_model=SimpleNamespace(candidates=candidates))
    rng = np.random.default_rng(7)
    passed = 0
    for _ in range(50):
        left = 10.0 ** rng.uniform(0.5, 1.5)
        sizes = left * np.exp(rng.uniform(-2.0, 2.0, 4))
        unnamed, noise, *effects = rng.standard_normal((6, 2, SAMPLES))

        def of(
            members: tuple[int, ...],
            rest: np.ndarray = noise + left * unnamed,
            effects: list[np.ndarray] = effects,
            sizes: np.ndarray = sizes,
        ) -> Any:
            gone = (sizes[k] * effects[k] for k in range(4) if k not in members)
            return estimated(members, rest + sum(gone, np.zeros(1)))

        *parts, chosen = [of(m) for count in range(1, 5) for m in combinations(range(4), count)]
        known = list[Any]()
        for part in parts:
            if not fewer_do(chosen, four, known, len(part.members)):
                known.append(part)
        passed += len(known) < len(parts)
        told, every = (
            fewest(chosen, four, [e for e in some if wanted in {said[i] for i in e.members}])
            for some in (known, parts)
        )
        assert told is every
    assert passed > 5


@pytest.mark.parametrize("seed", range(20))
def test_members_that_explain_less_than_is_left_are_not_counted(seed: int) -> None:
    """Three effects and what nobody names: named are those without which more than that is left."""
    rng = np.random.default_rng(seed)
    left = 10.0 ** rng.uniform(0.5, 1.5)
    sizes = left * np.sort(np.exp(rng.choice([-1.5, -0.8, 0.8, 1.5, 2.5], 3, replace=False)))
    unnamed, noise, *effects = rng.standard_normal((5, 2, SAMPLES))
    every = [
        estimated(
            members,
            noise
            + left * unnamed
            + sum((sizes[k] * effects[k] for k in range(3) if k not in members), np.zeros(1)),
        )
        for count in range(1, 4)
        for members in combinations(range(3), count)
    ]
    chosen = fewest(every[-1], arena(), every[:-1])
    gained = sum(size**2 for k, size in enumerate(sizes) if k not in chosen.members)
    assert gained < 1.1 * left**2
    if len(chosen.members) > 1:  # without the smallest of them, too little
        least = min(sizes[k] for k in chosen.members)
        assert gained + least**2 > 0.9 * left**2
    assert set(chosen.members) == set(range(3 - len(chosen.members), 3))


@pytest.mark.parametrize("more", [1.0, 12.0])
@pytest.mark.parametrize("time", [True, False])
def test_the_law_inside_a_richer_one_is_estimated_before_that_is_named(
    more: float, time: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    null, plain, richer = sets(np.random.default_rng(2), 4.0, (more, more))
    monkeypatch.setattr(nesting, "enter", lambda *_, **__: plain)
    monkeypatch.setattr(
        nesting,
        "simplified",
        lambda _, members, theta: [((FRICTION,), theta)] * (DRIFT in members),
    )
    entries, chosen = nesting.plainest(arena(), richer, [null, richer], lambda: not time)
    assert chosen is (plain if time and more < 4.0 else richer)
    assert entries == ([null, richer, plain] if time else [null, richer])
