"""Dry friction switched exactly, against a simulation that follows its modes one by one."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from benchmarks.evidence_plants import CART, TWO_MASS, Dry, Plant, cart, drive, two_mass
from jaxsr.models import Simulator, parse_model
from jaxsr.models.lifting import closed, one_step
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, Segments, build_segments
from jaxsr.models.switching import _Walk, switchable  # pyright: ignore[reportPrivateUsage]
from jaxsr.recordings import Recording

RUBBED_CART = CART.replace("- d*v", "- d*v - Fc*sign(v)") + "\nFc = { value = 2.0 }\n"
RUBBED_PAIR = (
    TWO_MASS.replace("- d*v", "- d*v - Fa*sign(v)").replace(
        'c*(v - w)"\n[', 'c*(v - w) - Fb*sign(w)"\n['
    )
    + "\nFa = { value = 0.9 }\nFb = { value = 0.8 }\n"
)
SAMPLES = 120


Case = tuple[str, Recording, np.ndarray]


@functools.cache
def stuck_cart() -> Case:
    plant = cart(dry={0: Dry(2.0 / 1.3, 2.0 / 1.3)})
    force = drive(np.random.default_rng(3), SAMPLES, 0.03, 3.0, (1.1, 2.3, 4.7))
    return recorded(RUBBED_CART, plant, force, 0.03)


@functools.cache
def stuck_pair() -> Case:
    plant = two_mass(dry={0: Dry(0.9 / 0.8, 0.9 / 0.8), 1: Dry(0.8 / 1.5, 0.8 / 1.5)})
    force = drive(np.random.default_rng(3), SAMPLES, 0.02, 6.0, (0.9, 2.1, 3.7))
    return recorded(RUBBED_PAIR, plant, force, 0.02)


def recorded(text: str, plant: Plant, force: np.ndarray, interval: float) -> Case:
    """The model with friction, a recording without noise, and the true states as a path."""
    states = plant.states(force, interval)
    outputs = {f"y{j}": states[:, j] for j in range(len(plant.start))}
    record = Recording("run", interval * np.arange(SAMPLES), {"u": force, **outputs})
    return text, record, states.T[:, :, None]


def along(
    text: str, record: Recording, path: np.ndarray, substeps: int
) -> tuple[Simulator, Stepping, Segments, np.ndarray, np.ndarray]:
    """What steps are asked with."""
    simulator = Simulator(parse_model(text))
    prepared = [Prepared.build(simulator.model, record)]
    segments = build_segments(simulator.model, prepared, [(0, 0, SAMPLES)], substeps)
    stepping = Stepping("rk4", substeps, (0.0,) * len(simulator.smoothed_arguments))
    theta = np.array([p.value for p in simulator.model.parameters.values()])
    return simulator, stepping, segments, theta, path


@pytest.mark.parametrize("make", [stuck_cart, stuck_pair])
def test_steps_are_those_of_the_modes(make: Callable[[], Case]) -> None:
    """RK4 errors alone, crossings included: they fall by 4**4 with a quarter of the step."""
    errors = []
    for substeps in (1, 4):
        setting = along(*make(), substeps)
        ends, _ = one_step(*setting, (), tangents=False)
        errors.append(np.abs(ends - setting[-1][:, 1:]).max())
    assert errors[1] < 1e-7
    assert errors[1] < errors[0] / 100.0
    speeds = setting[-1][len(setting[-1]) // 2 :, :, 0]
    assert (np.abs(speeds) < 1e-12).sum() > 10  # it does stick


@pytest.mark.long
@pytest.mark.parametrize("make", [stuck_cart, stuck_pair])
def test_derivatives_go_through_crossings_and_sticking(make: Callable[[], Case]) -> None:
    """Against differences; where a sample's own speed is zero there is one on one side alone."""
    simulator, stepping, segments, theta, path = along(*make(), 2)
    setting = simulator, stepping, segments
    ends, slopes = one_step(*setting, theta, path, list(range(len(theta))))
    n = len(path)
    for j in range(n + len(theta)):
        ends = []
        for way in (1.0, -1.0):
            at, other = theta.copy(), path.copy()
            if j < n:
                step = 1e-7 * np.abs(path[j]).max()
                other[j] += way * step
            else:
                step = 1e-6 * theta[j - n]
                at[j - n] += way * step
            ends.append(one_step(*setting, at, other, (), tangents=False)[0])
        wanted = (ends[0] - ends[1]) / (2.0 * step)
        far = np.abs(wanted - slopes[:, j])[:, :, 0].max(axis=0) / np.abs(wanted).max()
        assert (far > 1e-4).sum() <= (3 if j >= n // 2 and j < n else 0)


def test_a_simulation_closes_on_the_switched_motion() -> None:
    setting = along(*stuck_cart(), 4)
    path = closed(*setting)
    assert path is not None
    np.testing.assert_allclose(path, setting[-1], atol=1e-6)


def test_what_has_no_slope_at_standstill_does_no_harm() -> None:
    """A power below one, of no strength yet, beside friction that sticks: all slopes finite."""
    _, record, path = stuck_cart()
    text = RUBBED_CART.replace("sign(v)", "sign(v) - kd*sign(v)*Abs(v)**p")
    text += "kd = { value = 0.0, bounds = [0.0, 1.0] }\np = { value = 0.5, bounds = [0.2, 3.0] }\n"
    setting = along(text, record, path, 1)
    chosen = range(len(setting[3]))
    with np.errstate(all="ignore"):
        _, slopes = one_step(*setting, list(chosen))
    assert np.isfinite(slopes).all()


def test_only_surfaces_of_states_alone_are_switched() -> None:
    def found(term: str, reading: str = "q") -> tuple[int, ...]:
        text = CART.replace("- d*v", f"- d*v - {term}").replace('y0 = "q"', f'y0 = "{reading}"')
        return switchable(Simulator(parse_model(text)))

    assert found("sign(v - 0.3*q + 1)") == (0,)
    assert found("sign(v*q)") == ()  # curved
    assert found("sign(v - d*q)") == ()  # its slope is estimated
    assert found("sign(v - u)") == ()  # it moves with the input
    assert found("sign(v)", "d(v)") == ()  # the sensor shows the jump
    assert found("sign(v) - sign(v - u)") == (0,)


def test_a_drag_whose_slope_is_infinite_at_rest_does_not_chatter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Steps that cross v = 0 to and fro are not located for ever, and end near shorter ones."""
    text = CART.replace("- d*v", "- d*v - Fc*sign(v) - kd*sign(v)*Abs(v)**0.4")
    text += "\nFc = { value = 0.2 }\nkd = { value = 6.0 }\n"
    rng = np.random.default_rng(7)
    force = np.linspace(-4.0, 4.0, SAMPLES)
    path = np.stack([np.zeros(SAMPLES), 1e-3 * rng.normal(size=SAMPLES)])
    record = Recording("run", 0.03 * np.arange(SAMPLES), {"u": force, "y0": path[0]})
    rounds, located = [], _Walk._located  # pyright: ignore[reportPrivateUsage]

    def counted(self: _Walk, *args: Any) -> Any:
        rounds.append(1)
        return located(self, *args)

    monkeypatch.setattr(_Walk, "_located", counted)
    ends = []
    for substeps in (4, 64):
        rounds.clear()
        found, _ = one_step(*along(text, record, path[:, :, None], substeps), (), tangents=False)
        assert len(rounds) <= 3 * substeps
        ends.append(found)
    assert len(rounds) > 0
    moved = np.abs(ends[1][1] - path[1, :-1, None]).max()
    assert np.abs(ends[0] - ends[1]).max() < 0.05 * moved
