"""What breaks on the way costs its own step alone."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from jaxsr._progress import Silent
from jaxsr._result import InputError
from jaxsr.diagnosis import diagnose
from jaxsr.diagnosis.failures import Failures, unsimulable
from jaxsr.diagnosis.setup import prepare_data
from jaxsr.diagnosis.shooting.tangent import _finite
from jaxsr.models import Simulator, parse_model
from jaxsr.recordings import Recording

DRAIN = """
[model]
states = ["h"]
inputs = ["u"]
outputs = ["y"]
[equations]
h = "u - k*sqrt(h)"
[readings]
y = "h"
[parameters]
k = { value = 0.5, bounds = [0.1, 2.0] }
"""


def broken() -> None:
    raise np.linalg.LinAlgError("SVD did not converge\nat all")


def test_a_broken_step_leaves_what_was_found_and_one_line():
    failures = Failures(Silent())
    assert failures.attempt("growing sets", broken, "before") == "before"
    assert failures.attempt("growing sets", lambda: "after", "before") == "after"
    (line,) = failures.lines
    assert line.startswith("growing sets broke off (LinAlgError: SVD did not converge at all)")


@pytest.mark.parametrize("error", [InputError("bad file"), KeyboardInterrupt()])
def test_bad_input_and_interrupts_are_no_failures(error):
    def job() -> None:
        raise error

    with pytest.raises(type(error)):
        Failures(Silent()).attempt("reading", job, None)


def recording(low: float) -> Recording:
    time = 0.05 * np.arange(200)
    return Recording("tank.csv", time, {"u": np.ones(200), "y": low + np.sin(time)})


def test_a_law_that_has_no_value_on_the_data_is_named_with_its_row():
    simulator = Simulator(parse_model(DRAIN))
    item = recording(-2.0)
    (prepared,) = prepare_data(simulator.model, [item])
    found = str(unsimulable(simulator, [prepared]))
    assert "tank.csv" in found and "d(h)/dt is not a number at row 1 " in found
    with pytest.raises(InputError, match=r"equation h, on tank\.csv"):
        diagnose(simulator, [item], budget=5.0)


def test_a_law_that_has_a_value_everywhere_is_not_blamed():
    simulator = Simulator(parse_model(DRAIN))
    (prepared,) = prepare_data(simulator.model, [recording(2.0)])
    assert "no simulation along the recordings stays finite" in str(
        unsimulable(simulator, [prepared])
    )


@pytest.mark.parametrize(
    ("module", "name", "stage"),
    [
        ("settled", "posterior", "weighing mechanisms"),
        ("diagnose", "decided_by_evidence", "estimating what the evidence says"),
    ],
)
def test_broken_stages_of_the_search_still_end_in_an_answer(monkeypatch, module, name, stage):
    """Whatever breaks, re-calibration is reported, and the line says what was not asked."""
    job = sys.modules[f"jaxsr.diagnosis.{module}"]
    monkeypatch.setattr(job, name, lambda *_: broken())
    found = diagnose(Simulator(parse_model(DRAIN)), [recording(2.0)], budget=8.0)
    rows = [r["message"] for r in found.document["data_checks"] if r["check"] == "search"]
    assert any(row.startswith(f"{stage} broke off (LinAlgError") for row in rows)
    assert found.verdict == "undecided" and found.fit["train"]["recalibrated"][-1] < np.inf


def test_directions_that_overflow_promise_nothing():
    slopes = np.ones((4, 1, 3, 2))
    slopes[1, 0, 2, 0] = np.nan
    slopes[2, 0, 0, 1] = np.inf
    slopes[3, 0, 0, 1] = 1e80
    kept = _finite(slopes)
    assert np.array_equal(kept[0], slopes[0]) and not kept[1:].any()
