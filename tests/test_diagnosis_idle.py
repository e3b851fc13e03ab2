"""What is no finding beside others: a value that may be the given one, and less than is left."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxsr.diagnosis.explaining import idle
from jaxsr.diagnosis.explaining.idle import without_given, without_minor

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


def simulated(rng: np.random.Generator, effects: dict[int, tuple[float, float]], left: float):
    """Return entries whose residuals are what they leave of effects in two sensors, and an arena.

    Every effect and the one that nobody names have rms values in noise; each set leaves those
    effects that are not its members.
    """
    waves = rng.standard_normal((len(effects) + 1, SAMPLES))
    noise = rng.standard_normal((2, SAMPLES))

    def of(*members: int) -> Any:
        rest = [np.outer(effects[i], w) for i, w in zip(effects, waves, strict=False)]
        rest = [w for i, w in zip(effects, rest, strict=True) if i not in members]
        residual = noise + sum(rest) + np.outer([left, left], waves[-1])
        return SimpleNamespace(members=members, fit=SimpleNamespace(residual=residual))

    sets = [(), (FRICTION,), (DRIFT,), (FRICTION, DRIFT)]
    return [of(*s) for s in sets], arena()


@pytest.fixture(autouse=True)
def known_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the ratio to the noise be that of the residuals, whose noise is 1."""
    monkeypatch.setattr(
        idle, "ratios_to_noise", lambda _, e: [float(np.std(r)) for r in e.fit.residual]
    )


@pytest.mark.parametrize("seed", range(20))
def test_a_mechanism_stands_where_it_explains_more_than_is_left(seed: int) -> None:
    rng = np.random.default_rng(seed)
    left, drift = 10.0 ** rng.uniform(-0.5, 1.5, 2)
    entries, place = simulated(rng, {FRICTION: (90.0, 90.0), DRIFT: (drift, drift)}, left)
    smaller = without_minor(entries[-1], place, entries)
    if abs(np.log(drift / left)) > 0.3:  # waves and noise are not quite orthogonal
        assert smaller is (entries[1] if left > drift else None)


def test_one_sensor_that_tells_it_is_enough() -> None:
    rng = np.random.default_rng(0)
    entries, place = simulated(rng, {FRICTION: (90.0, 90.0), DRIFT: (9.0, 0.0)}, 5.0)
    assert without_minor(entries[-1], place, entries) is None


def test_nothing_is_left_out_of_what_leaves_noise_alone() -> None:
    rng = np.random.default_rng(0)
    entries, place = simulated(rng, {FRICTION: (90.0, 90.0), DRIFT: (0.3, 0.3)}, 0.0)
    assert without_minor(entries[-1], place, entries) is None


def test_the_only_mechanism_stays() -> None:
    rng = np.random.default_rng(0)
    entries, place = simulated(rng, {FRICTION: (2.0, 2.0), DRIFT: (0.0, 0.0)}, 30.0)
    assert without_minor(entries[1], place, entries) is None
