"""What time or the user left untried is not excluded: its mass, and what is said of it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from diagnosis_systems import RAIL, SPRUNG, simulator_of, sprung_recording

from jaxsr._progress import Budget
from jaxsr._result import StoppedBy, Verdict
from jaxsr.diagnosis import diagnose
from jaxsr.diagnosis.compared import UNNAMED, Compared
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.open_mass import NOT_BORNE_OUT, Proposal, open_mass, priors
from jaxsr.models import parse_model
from jaxsr.report.words import left_open, whole_sentence
from jaxsr.report.words import verdict_sentence as first_screen


def proposals(compared: int, left: int, family: str = "elastic") -> list[Proposal]:
    named = [(f"spring_{k}@equation:v", k < compared) for k in range(compared + left)]
    return [Proposal(name, family, Verdict.STRUCTURE, told) for name, told in named]


def test_priors_are_shared_by_families_and_inside_them() -> None:
    table = [*proposals(2, 1), Proposal("M", "parameter", Verdict.PARAMETER, True)]
    assert priors(table) == pytest.approx([1 / 6, 1 / 6, 1 / 6, 1 / 2])
    assert sum(priors(table)) == pytest.approx(1.0)


@pytest.mark.parametrize(("told", "left"), [(1, 9), (9, 1), (5, 5)])
def test_the_best_is_among_the_uncompared_as_often_as_is_said(told: int, left: int) -> None:
    """Of exchangeable evidences, heavy tails or not: 4000 draws, four standard errors."""
    mass = open_mass(proposals(told, left)).probability
    evidence = np.random.default_rng(0).standard_cauchy((4000, told + left))
    share = np.mean(np.argmax(evidence, axis=1) >= told)
    assert abs(share - mass) < 4.0 * np.sqrt(mass * (1.0 - mass) / 4000)


def test_what_is_left_counts_against_other_answers_only() -> None:
    mass = open_mass([*proposals(1, 1), Proposal("M", "parameter", Verdict.PARAMETER, True)])
    assert mass.against(Verdict.STRUCTURE) == 0.0
    assert mass.against(Verdict.PARAMETER) == pytest.approx(0.25)
    assert mass.factor == pytest.approx(0.75)


def test_nothing_is_open_where_everything_was_compared() -> None:
    mass = open_mass(proposals(4, 0))
    assert mass.factor == 1.0 and mass.in_words(StoppedBy.BUDGET) == ""


def test_what_free_runs_do_not_bear_out_is_no_likelier_than_none() -> None:
    mass = open_mass([], borne_out=False)
    assert mass.factor == 1.0 - NOT_BORNE_OUT
    assert "do not bear out" in mass.in_words(StoppedBy.CONVERGED)


@pytest.mark.parametrize(
    ("stopped", "who"), [(StoppedBy.BUDGET, "time budget"), (StoppedBy.INTERRUPTED, "user")]
)
def test_words_say_who_ended_the_search_and_what_was_left(stopped: StoppedBy, who: str) -> None:
    words = open_mass(proposals(1, 4)).in_words(stopped)
    assert who in words and "4 of 5" in words and "80%" in words
    assert "spring 1 at equation:v" in words and "and 1 more" in words


def test_sentences_of_an_open_search_do_not_blame_the_recordings() -> None:
    said = open_mass(proposals(1, 4)).in_words(StoppedBy.INTERRUPTED)
    document = {"verdict": "undecided", "findings": [], "provenance": {"open": {"message": said}}}
    terminal = whole_sentence(document)
    assert said in terminal and "no mechanism tried explains" not in terminal
    assert left_open(document) == said
    assert "cannot tell" not in first_screen(document)


def test_what_was_not_asked_about_stays_open() -> None:
    model = parse_model(RAIL)
    scale = {"q": np.linspace(-1.0, 1.0, 21), "v": np.linspace(-2.0, 2.0, 21)}
    super_model = SuperModel.build(model, force_candidates(model, scale)[:6])
    labels = list(dict.fromkeys(c.label for c in super_model.candidates))
    null, record = SimpleNamespace(members=(), fit=SimpleNamespace(usable=True)), Compared()
    record.tell(labels[1:])
    table = {p.name: p for p in record.proposals(super_model.candidates, [null])}
    assert not table[labels[0]].compared
    assert all(table[name].compared for name in labels[1:])
    # stages that were not reached are open as well
    assert not table[UNNAMED].compared
    record.reach(UNNAMED)
    again = record.proposals(super_model.candidates, [null])
    assert {p.name: p.compared for p in again}[UNNAMED]


def test_a_search_that_ended_at_once_claims_nothing() -> None:
    """Coulomb friction and wrong values; the user ends the search before it compares them."""
    rng = np.random.default_rng(0)

    def force(q: float, v: float, u: float) -> float:
        return u - 40.0 * q - 1.5 * v - 3.0 * float(np.tanh(v / 1e-3))

    budget = Budget(600.0)
    budget.interrupt()
    found = diagnose(
        simulator_of(parse_model(SPRUNG)), [sprung_recording(force, rng, 1e-4)], budget=budget
    )
    assert found.verdict == "undecided"
    assert max((f["probability"] for f in found.findings), default=0.0) < 0.5
    assert "The user ended the search" in found.sentence
    assert "no mechanism tried explains" not in found.sentence
    left = found.document["provenance"]["open"]
    assert left["probability"] > 0.5 and "coulomb_friction@equation:v" in left["not_tried"]
    remarks = [row["message"] for row in found.document["data_checks"]]
    assert any("The user ended the search" in remark for remark in remarks)
