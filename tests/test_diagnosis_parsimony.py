"""A set is no richer than what it leaves allows."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxsr.diagnosis.explaining import parsimony
from jaxsr.diagnosis.explaining.parsimony import simpler, without_given, worth_their_constants

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
    fit = SimpleNamespace(residual=residual, usable=True, cost=float(np.sum(residual**2)))
    return SimpleNamespace(members=members, constants=constants or len(members), fit=fit)


def simulated(
    rng: np.random.Generator, sizes: dict[int, tuple[float, float]], left: float
) -> list[Any]:
    """Return all sets of two effects, each of which leaves what it has not as member.

    Every effect, and one that nobody names, has rms values in noise in two sensors.
    """
    waves, noise = rng.standard_normal((3, SAMPLES)), rng.standard_normal((2, SAMPLES))
    unnamed = noise + np.outer([left, left], waves[-1])

    def of(*members: int) -> Any:
        rest = [
            np.outer(sizes[i], w) for i, w in zip(sizes, waves, strict=False) if i not in members
        ]
        return estimated(members, unnamed + sum(rest))

    return [of(), of(FRICTION), of(DRIFT), of(FRICTION, DRIFT)]


@pytest.fixture(autouse=True)
def known_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the ratio to the noise be that of the residuals, whose noise is 1."""
    monkeypatch.setattr(
        parsimony, "ratios_to_noise", lambda _, e: [float(np.std(r)) for r in e.fit.residual]
    )


@pytest.mark.parametrize("seed", range(20))
def test_a_mechanism_stands_where_it_explains_more_than_is_left(seed: int) -> None:
    rng = np.random.default_rng(seed)
    left, drift = 10.0 ** rng.uniform(-0.5, 1.5, 2)
    entries = simulated(rng, {FRICTION: (90.0, 90.0), DRIFT: (drift, drift)}, left)
    found = simpler(entries[-1], arena(), entries)
    if abs(np.log(drift / left)) > 0.3:  # waves and noise are not quite orthogonal
        assert found is (entries[1] if left > drift else None)


def test_one_sensor_that_tells_it_is_enough() -> None:
    rng = np.random.default_rng(0)
    entries = simulated(rng, {FRICTION: (90.0, 90.0), DRIFT: (9.0, 0.0)}, 5.0)
    assert simpler(entries[-1], arena(), entries) is None


def test_nothing_is_left_out_of_what_leaves_noise_alone() -> None:
    rng = np.random.default_rng(0)
    entries = simulated(rng, {FRICTION: (90.0, 90.0), DRIFT: (0.3, 0.3)}, 0.0)
    assert simpler(entries[-1], arena(), entries) is None


def test_a_mechanism_alone_stays() -> None:
    rng = np.random.default_rng(0)
    entries = simulated(rng, {FRICTION: (2.0, 2.0), DRIFT: (0.0, 0.0)}, 30.0)
    assert simpler(entries[1], arena(), entries) is None


@pytest.mark.parametrize("more", [1.0, 12.0])
def test_a_richer_law_takes_the_place_of_a_simpler_one_for_more_than_it_leaves(more: float) -> None:
    """Friction that depends on the position, beside friction: what else it says is `more`."""
    rng = np.random.default_rng(1)
    left, extra, noise = rng.standard_normal((3, 2, SAMPLES))
    unnamed = noise + 4.0 * left
    plain = estimated((FRICTION,), unnamed + more * extra)
    richer = estimated((DRIFT,), unnamed, constants=2)
    entries = [estimated((), 90.0 * noise), plain, richer]
    assert simpler(richer, arena(), entries) is (plain if more < 4.0 else None)
    assert (richer in worth_their_constants(plain, arena(), entries)) == (more > 4.0)
