"""Free runs over recordings held out, put together from windows and pieces."""

from __future__ import annotations

import base64
import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxsr._progress import Budget
from jaxsr.discovery.forecast import Forecast, Readings
from jaxsr.discovery.held_out import held_out_runs
from jaxsr.models import parse_model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording
from jaxsr.report.exploring import packed_runs
from jaxsr.report.model_runs import MOST_RUNS, run_figures
from jaxsr.report.style import Pace

MODEL = parse_model("""
[model]
name = "lag"
states = ["x"]
inputs = ["u"]
outputs = ["x_out"]
[equations]
x = "u - x"
[readings]
x_out = "x"
[units]
x = "m"
[columns]
x_out = "x"
""")


def pieces(*spans: tuple[str, float, float]) -> list[Recording]:
    """Return recordings of ten samples by name, first and last instant."""
    found = []
    for name, first, last in spans:
        time = np.linspace(first, last, 10)
        found.append(Recording(name, time, {"u": 0.0 * time, "x": np.sin(time)}))
    return found


def runs_of(recordings: list[Recording], errors: list[float], origin: float = 0.0) -> Any:
    """Return the runs where the model is off by so much in each recording, in one window each."""
    items = tuple(Prepared.build(MODEL, r) for r in recordings)
    shape = 10, len(items)
    law = np.tile(np.array(errors) / 2.0, (10, 1))
    law[:3] = np.nan
    course = np.stack([i.outputs[:, 0] + e for i, e in zip(items, errors, strict=True)], axis=1)
    nothing, rows = np.zeros(shape), tuple((k, 0, 10) for k in range(len(items)))
    forecast = Forecast(law, nothing, nothing, nothing, rows, course)
    readings = Readings(items, tuple(i.outputs for i in items), np.array([2.0]))
    bench: Any = SimpleNamespace(over=lambda *_: (readings, [forecast]))
    return held_out_runs(bench, MODEL, recordings, origin)


def test_pieces_of_a_recording_are_one_run_with_a_gap():
    recordings = pieces(("a.csv", 0.0, 1.0), ("a.csv", 2.0, 3.0), ("b.csv", 0.0, 1.0))
    found = runs_of(recordings, [0.1, 0.3, 0.4], origin=5.0)
    first, second = found.runs
    assert (first.recording, second.recording) == ("a.csv", "b.csv")
    assert first.time[[0, 9, 10, 11]] == pytest.approx([5.0, 6.0, 6.5, 7.0])
    assert (np.diff(first.time) > 0.0).all() and len(first.time) == 21
    assert np.isnan(first.measured[10]) and np.isnan(first.simulated[10])
    error = (first.simulated - first.measured)[np.isfinite(first.measured)]
    assert error == pytest.approx([0.1] * 10 + [0.3] * 10)
    assert first.nrmse == pytest.approx(np.sqrt((0.1**2 + 0.3**2) / 2.0) / 2.0)
    assert second.nrmse == pytest.approx(0.2)
    assert found.errors["x"] == pytest.approx(np.sqrt(np.mean(np.square([0.1, 0.3, 0.4]))) / 2.0)
    assert first.starts == pytest.approx([5.0, 7.0]) and first.unit == "m"


def test_recordings_of_one_name_stay_apart():
    runs = runs_of(pieces(("a.csv", 0.0, 1.0), ("a.csv", 0.0, 2.0)), [0.1, 0.2]).runs
    assert [run.recording for run in runs] == ["a.csv (1)", "a.csv (2)"]


@pytest.mark.long
def test_recordings_take_turns_and_time_ends_the_figures():
    spans = [(f"r{k}.csv", 0.0, 1.0) for k in range(MOST_RUNS + 2)]
    runs = runs_of(pieces(*spans), [0.1] * len(spans)).runs
    drawings = run_figures(runs, Pace())
    assert [d.caption.split(" (")[0] for d in drawings] == [
        f"x, r{k}.csv" for k in range(MOST_RUNS)
    ]
    assert "error 0.05" in drawings[0].caption
    assert run_figures(runs, Pace(Budget(1e-9))) == []


def test_the_script_is_given_the_runs_and_what_they_are_called():
    told = json.loads(packed_runs(runs_of(pieces(("<a>", 0.0, 1.0)), [0.25]).runs))
    (row,) = told["series"]
    assert row["recording"] == "<a>" and row["unit"] == "m"
    values = [np.frombuffer(base64.b64decode(row[k]["data"]), "<f4") for k in row if k in SHOWN]
    assert values[1] - values[0] == pytest.approx([0.25] * 10, rel=1e-5)
    assert [key for key, _ in told["models"]] == list(SHOWN)


SHOWN = ("measured", "explained")
