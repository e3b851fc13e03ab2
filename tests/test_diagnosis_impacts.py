"""What is missing beside impacts: paths that jump as the model does, and their evidence."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from impact_plants import BALL, CART, HAMMER, PENDULUM, dropped, pushed, struck, swung

from jaxsr.diagnosis import diagnose
from jaxsr.diagnosis.likelihood.course import followed
from jaxsr.diagnosis.likelihood.walk import through_jumps
from jaxsr.diagnosis.likelihood.workspace import first_noise
from jaxsr.models import Simulator, parse_model
from jaxsr.models.least_squares import Problem
from jaxsr.models.lifting import closed, one_step, through_events
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, Segments, build_segments
from jaxsr.recordings import Recording

MODEL = parse_model(BALL)
SIMULATOR, STEPS = Simulator(MODEL), Stepping("rk4", 1)
THETA = np.array([9.81, 0.75])


def prepared(recordings: list[Recording]) -> list[Prepared]:
    return [Prepared.build(MODEL, r) for r in recordings]


def segments_of(count: int = 400) -> tuple[list[Prepared], Segments]:
    items = prepared(dropped(np.random.default_rng(0)))
    return items, build_segments(MODEL, items, [(r, 0, count) for r in range(3)], 1)


def simulated(segments: Segments, height: float, theta: np.ndarray = THETA) -> np.ndarray:
    path = segments.course.copy()
    path[:, 0] = np.array([[height], [0.0]])
    found = closed(SIMULATOR, STEPS, segments, theta, path, near=False)
    assert found is not None
    return found


def defects(segments: Segments, theta: np.ndarray, path: np.ndarray) -> np.ndarray:
    return one_step(SIMULATOR, STEPS, segments, theta, path)[0] - path[:, 1:]


def test_a_walk_jumps_at_the_samples_where_the_motion_does() -> None:
    """With a restitution that is off by a fifteenth; savitzky-golay paths have no jump at all."""
    items, segments = segments_of(450)
    truth = simulated(segments, 0.0)
    for k, height in enumerate((2.0, 1.2, 3.0)):
        truth[:, :, k] = simulated(segments, height)[:, :, k]
    given, noise = np.array([9.81, 0.7]), first_noise(MODEL, items)
    problem = Problem(SIMULATOR, STEPS, segments, np.ones(1))
    start = np.var(segments.course, axis=(1, 2))
    walk = through_jumps(MODEL, problem, given, noise, start, (1,)).segments.course
    true, walked, smoothed = (np.diff(p[1], axis=0) > 2.0 for p in (truth, walk, segments.course))
    assert true.sum() >= 6
    np.testing.assert_array_equal(walked, true)
    assert not np.array_equal(smoothed, true)
    assert np.sqrt(np.mean((walk[0] - truth[0]) ** 2)) < 1.5e-3  # noise of 1 mm
    far = np.abs(defects(segments, given, walk)[1])
    assert np.median(far) < 0.05 and np.abs(defects(segments, given, segments.course)[1]).max() > 2


def test_samples_about_an_event_that_comes_later_are_led_there() -> None:
    """A path is moved by its derivative by the height: impacts move by a sample and less."""
    _, segments = segments_of(200)
    begun, other = simulated(segments, 1.2), simulated(segments, 1.23)
    direction = (simulated(segments, 1.2 + 1e-5) - begun) / 1e-5
    moved = begun + 0.03 * direction
    assert np.abs(defects(segments, THETA, moved)[1]).max() > 2.0  # beyond the surface
    led = through_events(SIMULATOR, STEPS, segments, (THETA, begun), (THETA, moved))
    assert np.abs(defects(segments, THETA, led)[1]).max() < 0.3
    np.testing.assert_allclose(led[0], other[0], atol=5e-3)
    flat = through_events(SIMULATOR, STEPS, segments, (THETA, begun), (THETA, begun))
    np.testing.assert_allclose(flat, begun, atol=1e-9)


def test_recalibration_finds_the_restitution_in_free_fall() -> None:
    course = followed(MODEL, prepared(dropped(np.random.default_rng(1))))
    assert course is not None and course.null.settled and course.null.share == 0.0
    value, deviation = course.null.constants["e"]
    assert abs(value - 0.75) < 4.0 * deviation < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("model", "plant", "wanted"),
    [
        (BALL, dropped, None),
        (BALL, lambda rng: dropped(rng, drag=0.05), "quadratic_drag@equation:v"),
        (HAMMER, struck, None),
        (HAMMER, lambda rng: struck(rng, friction=0.5), "coulomb_friction@equation:v"),
        (HAMMER, lambda rng: struck(rng, cubic=600.0), "cubic_stiffness@equation:v"),
        (PENDULUM, swung, None),
        (PENDULUM, lambda rng: swung(rng, friction=0.15), "coulomb_friction@equation:w"),
        (PENDULUM, lambda rng: swung(rng, drag=0.06), "quadratic_drag@equation:w"),
        (CART, lambda rng: pushed(rng, friction=1.0), "coulomb_friction@equation:v"),
        (CART, lambda rng: pushed(rng, drag=0.7), "quadratic_drag@equation:v"),
    ],
    ids=(
        "ball, ball drag, hammer, hammer friction, hammer cubic, pendulum, pendulum friction, "
        "pendulum drag, cart friction, cart drag"
    ).split(", "),
)
def test_what_is_missing_beside_impacts_is_named(
    model: str,
    plant: Callable[[np.random.Generator], list[Recording]],
    wanted: str | None,
    seed: int,
) -> None:
    found = diagnose(
        Simulator(parse_model(model)), plant(np.random.default_rng(seed)), budget=60.0
    ).to_dict()
    labels = {f"{f['mechanism']}@{f['site']}" for f in found["findings"]}
    if wanted is None:
        assert found["verdict"] == "parameter"  # the given values are off
        assert all(label.startswith("wrong_value@") for label in labels)
    else:
        assert found["verdict"] == "structure"
        assert wanted in labels
