"""What a report says beside its figures: lengths, places, digits, and rivals that are left."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnosis_systems import CART

from jaxsr.diagnosis.explaining import experiment
from jaxsr.diagnosis.explaining.experiment import next_experiment
from jaxsr.diagnosis.explaining.explain import Weight, confusable_rows, in_figures, sentence_of
from jaxsr.diagnosis.judging.weights import Alternative
from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.uncertainty import Sensitivities
from jaxsr.models import Simulator, parse_model
from jaxsr.report.evidence import Trajectory
from jaxsr.report.fit_tables import Role, figures_at_a_glance, fit_groups
from jaxsr.report.trajectories import caption
from jaxsr.report.words import figures_of, mechanism_at, region_words

FIT = {
    "horizons_s": [2.0, 12.0, 20.0],
    "headline_s": 20.0,
    "train": {name: [0.1, 0.2, 0.3] for name in ("given", "recalibrated", "explained")},
    "held_out": {
        **{name: [0.1, 0.2, 0.3] for name in ("given", "recalibrated", "explained")},
        "files": ["b.csv"],
    },
}


def test_a_held_out_run_is_labelled_by_its_own_length() -> None:
    about = {"train": Role((20.0,)), "held_out": Role((10.0,), 0.01)}
    titles = {t["role"]: t["title"] for t in figures_at_a_glance(FIT, about)}
    assert titles["held-out recordings"] == "Free run over the whole recording, 10 s"
    assert titles["training recordings"] == "Free run over the whole recording, 20 s"
    table = fit_groups(FIT, about)
    assert [c["text"] for c in table["columns"]] == ["2 s", "12 s", "whole recording"]
    held = next(g for g in table["groups"] if g["role"] == "Held out")
    assert held["note"] == "10 s long: runs of 12 s are whole ones too"
    assert held["rows"][-1]["model"] == "Sensor noise alone"
    assert held["rows"][-1]["cells"] == ["1.0 %"] * 3


def test_the_force_error_is_that_of_the_finding() -> None:
    pair = {"train": {"recalibrated": 0.2, "explained": 0.1}}
    fit = {**FIT, "force": {"equation:w1": pair, "equation:w2": pair}}
    titles = [tile["title"] for tile in figures_at_a_glance(fit, site="equation:w2")]
    assert titles[-1] == "Force, equation of w2"


def test_recordings_of_several_lengths_name_the_shortest_and_the_longest() -> None:
    role = Role((8.0, 12.0))
    assert role.run_words(20.0, whole=True) == "whole recordings, 8 s to 12 s"
    assert role.run_words(2.0, whole=False) == "2 s"
    assert Role().run_words(20.0, whole=True) == "20 s"


def test_a_caption_tells_one_whole_run_from_many() -> None:
    time = np.linspace(0.0, 10.0, 11)
    run = Trajectory("b.csv", "held_out", "y", "m", 20.0, time, time, None, time, time, whole=True)
    assert caption(run) == "y, b.csv (held out), one free run of 10 s"


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (
            [{"variable": "v", "from": -1.123, "to": 0.4234, "everywhere": True}],
            ["at every v recorded (−1.12 to 0.423 m/s)"],
        ),
        (
            [
                {"variable": "v", "from": -2.0, "to": -0.5},
                {"variable": "v", "from": 0.5, "to": 2.0},
            ],
            ["−2 < v < −0.5 m/s and 0.5 < v < 2 m/s"],
        ),
        ([{"variable": "q", "from": 0.1, "to": 0.2}], ["0.1 < q < 0.2"]),
    ],
)
def test_regions_in_words(rows: list[dict[str, Any]], words: list[str]) -> None:
    assert region_words(rows, {"v": "m/s"}) == words


def test_signals_stand_in_the_words_of_a_mechanism() -> None:
    assert mechanism_at("input_gain@input:tau1") == "wrong gain of input tau1"
    assert mechanism_at("coulomb_friction@equation:v") == "Coulomb friction, equation of v"
    assert mechanism_at("coulomb_friction") == "Coulomb friction"


def test_a_finding_in_a_line_has_interval_unit_and_how_sure() -> None:
    row = {"value": 20.3974, "ci95": [20.1142, 20.6931], "unit": "N*m"}
    finding = {"parameters": {"Fc": row}, "probability": 0.93}
    assert figures_of(finding) == "Fc = 20.40 N·m (20.11 … 20.69), 93 % probable"
    assert figures_of({"probability": 1.0}) == "> 99 % probable"
    assert in_figures(row) == "20.40 N·m (95 % interval 20.11 to 20.69)"
    assert in_figures({"value": 1 / 3, "ci95": [1 / 3, 1 / 3], "unit": None}) == "0.3333"


def test_shares_add_up_in_words() -> None:
    """What comes back, and what other values make good, are all of the given model's mismatch."""
    words = Weight.of(given=101.0, without=15.0, explained=1.0).in_words()
    assert "14 % of the given model's mismatch would come back (15 times" in words
    assert "make good the other 86 %" in words
    assert "all of the given model's mismatch" in Weight.of(101.0, 101.0, 1.0).in_words()
    assert "3.2 times the squared error would be left" in Weight(2e-4, 3.21).in_words()
    assert Weight.of(101.0, math.inf, 1.0) == Weight(1.0, math.inf)
    assert Weight.of(101.0, 0.5, 1.0).share == 0.0  # clipped


def force(mechanism: str, term: str, *names: str) -> Candidate:
    specs = tuple(ParameterSpec(name, None) for name in names)
    sentence = "It acts along {site}."
    return Candidate(
        mechanism, "elastic", "equation:v", specs, sentence, terms=(("v", f"+ {term}"),)
    )


def test_sentences_name_signals_and_no_sites() -> None:
    found = force("cubic_stiffness", "{k3}*q**3", "k3")
    assert sentence_of(found) == "It acts along v."


def sensitivities(gram: np.ndarray, angles: list[float]) -> Sensitivities:
    count = len(gram)
    ones = np.ones(count)
    return Sensitivities(tuple(range(count)), gram, ones, np.array(angles), ones, 1.0)


def parts_of(*candidates: Candidate) -> Any:
    given = parse_model(CART)
    super_model = SuperModel.build(given, candidates)
    case = SimpleNamespace(simulator=Simulator(given))
    return SimpleNamespace(arena=SimpleNamespace(super_model=super_model), case=case)


def test_a_mechanism_at_two_sites_is_told_with_its_site() -> None:
    one = force("cubic_stiffness", "{k3}*q**3", "k3")
    two = Candidate(**{**vars(one), "site": "equation:q", "terms": (("q", "+ {k3}*q**3"),)})
    other = force("quadratic_drag", "{kd}*v*Abs(v)", "kd")
    gram = np.array([[1.0, 0.99, 0.98], [0.99, 1.0, 0.97], [0.98, 0.97, 1.0]])
    rows = confusable_rows(parts_of(one, two, other), sensitivities(gram, [60.0] * 3))
    assert [row[:2] for row in rows] == [
        ["cubic_stiffness@equation:v", "cubic_stiffness@equation:q"],
        ["cubic_stiffness@equation:v", "quadratic_drag"],
        ["cubic_stiffness@equation:q", "quadratic_drag"],
    ]
    np.testing.assert_allclose(
        [row[2] for row in rows], np.degrees(np.arccos([0.99, 0.98, 0.97])), atol=0.006
    )


def test_what_the_parameters_take_and_what_contains_the_other_are_not_compared() -> None:
    one = force("cubic_stiffness", "{k3}*q**3", "k3")
    wider = force("piecewise_stiffness", "{a}*q**3 + {b}*q**5", "a", "b")
    other = force("quadratic_drag", "{kd}*v*Abs(v)", "kd")
    gram = np.array([[1.0, 1.0, 0.99], [1.0, 1.0, 0.99], [0.99, 0.99, 1.0]])
    rows = confusable_rows(parts_of(one, wider, other), sensitivities(gram, [60.0, 60.0, 1e-7]))
    assert rows == []


def test_the_next_experiment_is_among_the_rivals_that_are_left(monkeypatch) -> None:
    candidates = (
        force("cubic_stiffness", "{k3}*q**3", "k3"),
        force("quadratic_stiffness", "{k2}*q**2", "k2"),
        force("linear_stiffness", "{k1}*q", "k1"),
    )
    parts, asked = parts_of(*candidates), []

    def best(parts: Any, rival: Any, leader: Any) -> experiment.Experiment:
        asked.append((rival, leader))
        return experiment.Experiment("a step", 2.0)

    monkeypatch.setattr(experiment, "best_experiment", best)
    leader: Any = "leader"
    entries: tuple[Any, Any] = ("rejected", "left")
    rejected, left = (
        Alternative(k, p, e) for k, p, e in zip((1, 2), (1e-6, 0.2), entries, strict=True)
    )
    text = next_experiment(parts, [(0, [rejected, left])], leader)
    assert text is not None and "a linear spring" in text and "uadratic" not in text
    assert asked == [("left", "leader")]
    assert next_experiment(parts, [(0, [rejected])], leader) is None
    assert next_experiment(parts, [], leader) is None
