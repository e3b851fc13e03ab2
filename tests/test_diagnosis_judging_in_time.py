"""Where no time is left to refine what was found, findings are told as the search left them."""

from __future__ import annotations

import importlib
from typing import Any

import pytest
from diagnosis_systems import RAIL
from test_diagnosis_end_to_end import rail_recording

from jaxsr._deadline import OutOfTime
from jaxsr.diagnosis import diagnose
from jaxsr.models import Simulator, parse_model

judging = importlib.import_module("jaxsr.diagnosis.explaining.judge")


def late(*_: Any, **__: Any) -> None:
    raise OutOfTime


def found() -> Any:
    data = [rail_recording("a.csv", 4.0, 1)]
    return diagnose(Simulator(parse_model(RAIL)), data, seed=3, budget=60.0)


def test_findings_stand_where_time_ends_their_refinement(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = found()
    monkeypatch.setattr(judging, "refine", late)
    left = found()
    assert left.verdict == whole.verdict
    assert [f["mechanism"] for f in left.findings] == [f["mechanism"] for f in whole.findings]
    (refined,), (plain,) = ([f["parameters"]["Fc"] for f in d.findings] for d in (whole, left))
    # Its corner is rounded: its interval is that of its residuals alone.
    assert plain["value"] == pytest.approx(refined["value"], rel=0.05)


def test_nothing_is_said_where_time_ends_that_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(judging, "_judged_by_compared", late)
    monkeypatch.setattr(judging, "_judged_as_left", late)
    assert found().verdict == "undecided"
