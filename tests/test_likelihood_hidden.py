"""Search by evidence: hidden states, memories, clipped sensors, many equations."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.hidden_plants import CART, MOTOR, TANKS, Missing, Plant, chain
from jaxsr.diagnosis.likelihood import loop, support
from jaxsr.diagnosis.likelihood.course import followed
from jaxsr.diagnosis.likelihood.offered import offered
from jaxsr.diagnosis.likelihood.posterior import Posterior, posterior
from jaxsr.diagnosis.likelihood.support import MOST
from jaxsr.diagnosis.mechanisms import sites_of
from jaxsr.diagnosis.mechanisms.dissipative import dissipative
from jaxsr.diagnosis.thinning import prepare_search
from jaxsr.models import Model, Simulator, parse_model
from jaxsr.models.segments import Prepared

LOOP = {"hysteresis_kz": 15.0, "hysteresis_b": 6.0, "hysteresis_g": 3.0}


def recorded(
    plant: Plant, sensors: tuple[str, ...], missing: Missing, samples: int, seed: int = 1
) -> tuple[Model, tuple[Prepared, ...]]:
    rng = np.random.default_rng(seed)
    recordings = plant.records(rng, sensors, missing, samples)
    model = Simulator(parse_model(plant.model(sensors))).model
    return model, tuple(prepare_search(model, recordings, seconds=np.inf)[0])


def searched(plant: Plant, sensors: tuple[str, ...], missing: Missing, samples: int) -> Posterior:
    found = posterior(*recorded(plant, sensors, missing, samples))
    assert found is not None
    return found


def alone(found: Posterior) -> tuple[str, dict[str, tuple[float, float]]]:
    """The only member of the leading set, and its constants by their own names."""
    (number,) = found.leader.members
    constants, names = found.leader.constants, found.leader.names[number]
    known = {own: constants[full] for own, full in names.items() if full in constants}
    return found.candidates[number].label, known


def close(known: dict[str, tuple[float, float]], **wanted: float) -> None:
    for name, value in wanted.items():
        estimate, deviation = known[name]
        assert abs(estimate - value) < 4.0 * deviation, name


@pytest.mark.long
def test_drag_is_found_on_a_motor_of_which_the_current_alone_is_read() -> None:
    missing = Missing({"drag": 0.02})
    label, known = alone(searched(MOTOR, ("current",), missing, 200))
    assert label == "quadratic_drag@equation:w"
    close(known, kd=0.02)


@pytest.mark.long
def test_a_hysteresis_is_found_by_an_accelerometer() -> None:
    label, known = alone(searched(CART, ("a",), Missing(LOOP), 200))
    assert label == "hysteresis@equation:v"
    close(known, kz=15.0, b=6.0, g=3.0)


@pytest.mark.long
def test_a_memory_that_promised_nothing_is_asked_before_the_search_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Another law imitates part of it, and leads, and leaves a force."""
    additions = loop.additions
    monkeypatch.setattr(loop, "additions", lambda *args: (additions(*args)[0], []))
    label, known = alone(searched(CART, ("y",), Missing(LOOP), 200))
    assert label == "hysteresis@equation:v"
    close(known, kz=15.0, b=6.0, g=3.0)


@pytest.mark.long
def test_a_sensor_at_its_limit_is_clipped_and_no_gain() -> None:
    found = searched(CART, ("y",), Missing(fault={"clip": 1.2}), 200)
    label, _ = alone(found)
    assert label == "clipping@output:y"
    assert found.of_labels()[label] > 0.95


@pytest.mark.long
def test_a_tank_that_no_sensor_reads_overflows() -> None:
    label, known = alone(searched(TANKS, ("second",), Missing(level=2.3), 200))
    assert label == "overflow@equation:h1"
    close(known, ko=2.0, xo=2.3)


@pytest.mark.long
def test_a_model_of_ten_masses_offers_what_its_readings_speak_for() -> None:
    sensors = tuple(f"y{i}" for i in range(10))
    model, prepared = recorded(chain(10, 5), sensors, Missing({"cubic": 60.0}), 60)
    course = followed(model, prepared)
    assert course is not None
    candidates = offered(model, course)
    labels = {c.label for c in candidates}
    assert "cubic_stiffness@equation:v5" in labels
    assert len(candidates) <= MOST + MOST // 2  # half of it for forces, whatever sensors there are
    assert {f"constant_force@equation:v{i}" for i in range(10)} <= labels


@pytest.mark.long
def test_no_mechanism_makes_room_for_variants_of_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is offered once before any with other inner constants, however little it removes."""
    sensors = tuple(f"y{i}" for i in range(3))
    model, prepared = recorded(chain(3, 1, True), sensors, Missing({"viscous": 6.0}), 60)
    course = followed(model, prepared)
    assert course is not None
    few = offered(model, course)
    monkeypatch.setattr(support, "MOST", 10**6)
    every = offered(model, course)
    assert len(every) > MOST == len(few)
    assert {c.label for c in few} == {c.label for c in every}


@pytest.mark.slow
def test_a_damper_at_one_mass_is_offered_beside_one_damping_of_all() -> None:
    """What the shared constant does to one equation it does to all: it can not stand for that."""
    sensors = tuple(f"y{i}" for i in range(10))
    for axis in (2, 5, 8):
        model, prepared = recorded(chain(10, axis, True), sensors, Missing({"viscous": 6.0}), 60)
        course = followed(model, prepared)
        assert course is not None
        candidates = offered(model, course)
        assert f"viscous_damping@equation:v{axis}" in {c.label for c in candidates}


def test_friction_is_offered_along_speeds_and_not_along_levels() -> None:
    """A speed is one by its unit, else by going both ways; tanks hold levels."""
    both_ways, one_way = np.linspace(-2.0, 2.0, 21), np.linspace(1.0, 2.0, 21)

    def offers(model: Model, scale: dict[str, np.ndarray]) -> set[str]:
        return {c.label for s in sites_of(model, scale) for c in dissipative(s)}

    motor = parse_model(MOTOR.model(("current",)))
    assert "coulomb_friction@equation:w" in offers(motor, {"w": both_ways, "i": both_ways})
    units = '[units]\nw = "rad/s"\ni = "A"\n'
    named = offers(parse_model(MOTOR.model(("current",)) + units), {"w": one_way, "i": both_ways})
    assert "coulomb_friction@equation:w" in named
    assert "coulomb_friction@equation:i" not in named
    tanks = parse_model(TANKS.model(("second",)))
    assert not offers(tanks, {"h1": one_way, "h2": one_way})


@pytest.mark.slow
def test_nothing_is_claimed_on_a_motor_of_which_the_current_alone_is_read() -> None:
    """At most one of ten: more have a probability below 0.02 if each is wrong at 2 %."""
    claimed = 0
    for seed in range(10):
        found = posterior(*recorded(MOTOR, ("current",), Missing(), 200, seed))
        claimed += found is None or bool(found.leader.members)
    assert claimed <= 1


@pytest.mark.slow
def test_a_cubic_spring_amid_ten_masses_is_found() -> None:
    sensors = tuple(f"y{i}" for i in range(10))
    missing = Missing({"cubic": 40.0})
    label, known = alone(searched(chain(10, 5), sensors, missing, 300))
    assert label == "cubic_stiffness@equation:v5"
    close(known, k3=40.0)
