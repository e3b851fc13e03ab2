"""Driven states, margins around segments, and delayed inputs of every hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jaxsr.models import Simulator, driven, parse_model
from jaxsr.models.directions import Stages
from jaxsr.models.driven import driven_states, known_states
from jaxsr.models.field import Field
from jaxsr.models.following import stepped
from jaxsr.models.model import DRIVEN
from jaxsr.models.parts import Part
from jaxsr.models.rollout import Stepping, linearise, outputs
from jaxsr.models.segments import Prepared, build_segments
from jaxsr.recordings import Recording

PLAIN = parse_model(
    """
[model]
states = ["q"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "u - q"
[readings]
y = "q"
[parameters]
d = { value = 0.0, bounds = [0.0, 1.0] }
tau = { value = 0.3, bounds = [0.1, 1.0] }
"""
)
LAGGED = replace(
    PLAIN,
    states=("q", "w"),
    equations={"q": "w - q", "w": "(u - w)/tau"},
    initial={"q": "free", "w": DRIVEN},
)
TIME = np.arange(200) * 0.05


def forget() -> None:
    """Let go of the latest paths."""
    driven._course.cache_clear()  # pyright: ignore[reportPrivateUsage]
    driven._path.cache_clear()  # pyright: ignore[reportPrivateUsage]


def prepared(u: np.ndarray, y: np.ndarray | None = None) -> Prepared:
    y = np.zeros_like(u) if y is None else y
    return Prepared.build(PLAIN, Recording("a.csv", TIME, {"u": u, "y": y}))


def test_a_lag_follows_its_input_from_rest():
    """w' = (u - w)/tau with u = 1 + t: w = 1 + t - tau + tau*exp(-t/tau) from w(0) = 1."""
    path = known_states(LAGGED, prepared(1.0 + TIME))
    expected = 1.0 + TIME - 0.3 * (1.0 - np.exp(-TIME / 0.3))
    np.testing.assert_allclose(path[:, 1], expected, atol=1e-6)
    assert path.shape == (200, 2)
    slower = known_states(LAGGED, prepared(1.0 + TIME), np.array([0.0, 1.0]))
    np.testing.assert_allclose(slower[:, 1], TIME + np.exp(-TIME), atol=1e-6)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("fading", [1.5, 4.0, 15.0])
def test_a_lag_that_fades_within_a_sample_is_followed_to_a_hundredth_of_it(
    compiled: bool, fading: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The closed form above, and its derivative by tau; behind a step of 1/e of what fades."""
    if not compiled:
        monkeypatch.setattr(driven, "program_of", lambda *_: None)
    forget()
    tau = (TIME[1] - TIME[0]) / fading
    item, values = prepared(1.0 + TIME), np.array([0.0, tau])
    path = known_states(LAGGED, item, values)[:, 1]
    expected = 1.0 + TIME - tau * (1.0 - np.exp(-TIME / tau))
    assert np.abs(path - expected).max() < 0.01 * tau
    _, by, _ = driven_states(Simulator(LAGGED), item, values, ("tau",))
    wanted = np.exp(-TIME / tau) * (1.0 + TIME / tau) - 1.0
    assert np.abs(by[:, 0, 0] - wanted).max() < 0.05


def test_how_a_memory_follows_its_constants():
    """Against differences of two courses; the known states are held."""
    item, theta, chosen = prepared(np.sin(3.0 * TIME)), np.array([0.0, 0.3]), ("tau",)
    path, slopes, _ = driven_states(Simulator(LAGGED), item, theta, chosen)
    assert slopes.shape == (200, 1, 1)
    np.testing.assert_array_equal(path, known_states(LAGGED, item, theta)[:, 1:])
    apart = [
        known_states(LAGGED, item, theta + d * np.array([0.0, 1.0]))[:, 1] for d in (1e-4, -1e-4)
    ]
    np.testing.assert_allclose(slopes[:, 0, 0], (apart[0] - apart[1]) / 2e-4, atol=1e-5)


CHAINED = replace(
    PLAIN,
    states=("q", "w", "x", "z"),
    equations={"q": "-q", "w": "(u - w)/tau", "x": "(q*u - x)/0.01", "z": "(w - z**3)/0.02"},
    initial={"q": "free", "w": DRIVEN, "x": DRIVEN, "z": DRIVEN},
)


@pytest.mark.parametrize("most_parts", [0, 16], ids=["implicit", "explicit in parts"])
def test_memories_that_do_not_act_on_each_other_are_followed_apart(
    most_parts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As all of them together are: x fades by itself, z follows w; all within a sample."""
    monkeypatch.setattr(driven, "MOST_PARTS", most_parts)
    monkeypatch.setattr(driven, "program_of", lambda *_: None)  # the machine takes all together
    asked = list[bool]()
    item = prepared(1.0 + np.sin(3.0 * TIME))
    theta, chosen = np.array([0.0, 0.3]), ("tau",)
    found, independent = [], driven._independent  # pyright: ignore[reportPrivateUsage]
    for apart in (True, False):

        def groups(*args, apart: bool = apart) -> list[tuple[int, ...]] | None:
            known = independent(*args)
            asked.append(apart)
            assert known == [(1, 3), (2,)]
            return known if apart else None

        monkeypatch.setattr(driven, "_independent", groups)
        forget()  # else the second is the first, kept
        found.append(driven_states(Simulator(CHAINED), item, theta, chosen))
    assert {*asked} == {True, False}
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)
    path, slopes, by_start = found[0]
    assert np.abs(path).min(axis=0).max() > 0.0 and np.abs(slopes[:, 2]).max() > 1e-3
    assert not by_start[:, 1, [0, 2]].any()


def test_a_memory_that_acts_on_what_is_known_is_followed_with_it() -> None:
    """Inside a step it acts back on itself by that."""
    model = replace(CHAINED, equations={**CHAINED.equations, "q": "x - q"})
    simulator, item = Simulator(model), prepared(1.0 + np.sin(3.0 * TIME))
    field, x = Field(simulator, simulator.values()), [np.ones((3, 1))] * 4
    stages = Stages(np.ones((3, 1, 3, 1)), {})
    part = Part(stages, np.zeros((3, 1)), np.full((3, 1), 0.05))
    _, taken = stepped(field, "rodas3", x, [part])
    assert driven._independent(taken, model.states, 1) is None  # pyright: ignore[reportPrivateUsage]
    assert np.isfinite(known_states(model, item)).all()


def test_driven_starts_are_given_and_not_estimated():
    item = prepared(np.sin(TIME))
    segments = build_segments(LAGGED, [item], [(0, 0, 100), (0, 100, 200)], 1)
    assert not segments.free_start[1].any()
    assert segments.guess[1, 1] == known_states(LAGGED, item)[100, 1]
    simulator, theta = Simulator(LAGGED), np.array([0.0, 0.3])
    _, _, by_start = linearise(
        simulator, Stepping(), segments, theta, segments.guess, np.array([1])
    )
    assert by_start.shape[0] == 2
    assert (by_start[1] == 0.0).all() and (by_start[0] != 0.0).any()
    assert LAGGED.driven == ("w",) and LAGGED.dynamic_states == ("q",)


def test_margins_are_simulated_and_not_measured():
    item = prepared(np.sin(TIME), np.cos(TIME))
    segments = build_segments(PLAIN, [item], [(0, 0, 100), (0, 100, 200)], 1, margin=10)
    np.testing.assert_array_equal(segments.start, [0, 90])
    np.testing.assert_array_equal(segments.count, [110, 110])
    seen = np.isfinite(segments.outputs[0])
    assert not seen[:10].any()  # beyond a beginning nothing is known that could come late
    assert seen[10:100, 0].all() and not seen[100:, 0].any()
    assert seen[10:110, 1].all()
    np.testing.assert_array_equal(segments.outputs[0, 10:110, 1], np.cos(TIME[100:]))


@pytest.mark.parametrize("hold", ["linear", "zero", "bandlimited"])
def test_a_delay_of_nothing_changes_nothing(hold):
    u = np.random.default_rng(0).standard_normal(200)
    plain, item = replace(PLAIN, input_hold=hold), prepared(u)
    delayed = replace(plain, delays={"u": "d"})
    segments = build_segments(plain, [item], [(0, 0, 90), (0, 90, 200)], 2)
    theta = np.array([0.0, 0.3])
    first, second = (
        outputs(Simulator(m), Stepping("rk4", 2), segments, theta, segments.guess)
        for m in (plain, delayed)
    )
    np.testing.assert_allclose(second, first, rtol=0, atol=1e-11)


@pytest.mark.parametrize("hold", ["linear", "zero", "bandlimited"])
def test_a_delay_of_three_samples_shifts_the_input(hold):
    u = np.concatenate([np.zeros(20), np.sin(0.5 * TIME[:-20] ** 2)])
    model = replace(PLAIN, input_hold=hold)
    late = np.concatenate([np.zeros(3), u[:-3]])
    rows, theta = [(0, 0, 200)], np.array([3 * 0.05, 0.3])
    expected, found = (
        outputs(
            Simulator(m),
            Stepping("rk4", 2),
            (s := build_segments(m, [prepared(v)], rows, 2)),
            theta,
            0.0 * s.guess,
        )
        for m, v in ((model, late), (replace(model, delays={"u": "d"}), u))
    )
    # The records of a band-limited input end elsewhere, and ends ring.
    np.testing.assert_allclose(found, expected, atol=2e-3 if hold == "bandlimited" else 1e-10)


@pytest.mark.parametrize("hold", ["linear", "zero"])
def test_the_derivative_by_a_delay_is_that_of_differences(hold):
    u = np.random.default_rng(1).standard_normal(200)
    model = replace(PLAIN, input_hold=hold, delays={"u": "d"})
    segments = build_segments(model, [prepared(u)], [(0, 0, 200)], 1)
    simulator, h = Simulator(model), 1e-6

    def run(delay: float) -> np.ndarray:
        theta = np.array([delay, 0.3])
        return outputs(simulator, Stepping(), segments, theta, segments.guess)

    slope = linearise(
        simulator, Stepping(), segments, np.array([0.07, 0.3]), segments.guess, np.array([0])
    )[1][0]
    np.testing.assert_allclose(slope, (run(0.07 + h) - run(0.07 - h)) / (2 * h), atol=1e-6)
