"""Every form of model and recording ends in an answer: a diagnosis, or one clear line.

The slow test runs ``JAXSR_FORMS`` forms (500) from number ``JAXSR_FORMS_FROM`` (0) on, each in a
process of its own with a budget of ``JAXSR_FORMS_BUDGET`` seconds of processor time (5), and
writes what went wrong, by kind, to the folder ``JAXSR_FORMS_OUT`` if it is given.
"""

from __future__ import annotations

import os
from pathlib import Path

import form_models
import form_recordings
import numpy as np
import pytest
from form_running import diagnose_here, run_form
from form_summary import write_summary
from forms import form, forms
from hypothesis import given, settings

COUNT = int(os.environ.get("JAXSR_FORMS", "500"))
FIRST = int(os.environ.get("JAXSR_FORMS_FROM", "0"))
BUDGET = float(os.environ.get("JAXSR_FORMS_BUDGET", "5"))
QUICK = 40
"""Every kind of model comes up once in 40 numbers, every kind of recording in 39."""
QUICK_BUDGET = 0.6


def test_forty_numbers_hold_every_kind() -> None:
    some = [form(number, small=True) for number in range(QUICK)]
    assert len({f.model for f in some}) == len(form_models.KINDS) == QUICK
    assert {f.recording for f in some} == set(form_recordings.KINDS)
    assert np.gcd(len(form_models.KINDS), len(form_recordings.KINDS)) == 1
    assert sum(f.sound for f in some) > QUICK // 2
    assert {bool(f.missing) for f in some} == {True, False}


@settings(max_examples=10)
@given(forms(small=True))
def test_a_form_is_its_number(drawn) -> None:
    again = form(drawn.number, small=True)
    assert again.files == drawn.files and again.arguments() == drawn.arguments()
    rows = [text.count("\n") for name, text in drawn.files.items() if name.endswith(".csv")]
    assert rows and min(rows) > 2 and max(rows) <= 1001
    assert not any(f"{word}\n" in text for text in drawn.files.values() for word in ("nan", "inf"))


@pytest.mark.parametrize("number", range(QUICK))
def test_a_form_ends_in_an_answer(number: int, tmp_path: Path) -> None:
    outcome = diagnose_here(form(number, small=True), tmp_path, QUICK_BUDGET)
    assert not outcome.problems, f"{outcome.label}: {'; '.join(outcome.problems)}"


@pytest.mark.slow
def test_every_form_ends_in_an_answer(tmp_path: Path) -> None:
    folder = Path(os.environ.get("JAXSR_FORMS_OUT", tmp_path))
    outcomes = []
    for number in range(FIRST, FIRST + COUNT):
        outcomes.append(run_form(form(number), tmp_path / f"{number}", BUDGET))
        failures = write_summary(outcomes, folder)
    assert not failures, "\n".join(failures)
