"""Results and inputs as Python shows them: names, tables, cards, figures, old keys."""

from __future__ import annotations

import copy
import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
import pytest
import sympy
from sympy.physics.mechanics import dynamicsymbols

import jaxsr
from jaxsr import cli
from jaxsr._job import verdict_line
from jaxsr.diagnosis import Diagnosis, Estimate, Rival
from jaxsr.models import Simulator, parse_model
from jaxsr.report import Evidence, ForceResidual, Trajectory
from jaxsr.report.words import verdict_sentence

matplotlib.use("Agg")

DRIVE = """
[model]
name = "drive"
states = ["q", "v"]
inputs = ["force"]
outputs = ["y"]
[equations]
q = "v"
v = "force - Fc*sign(v)"
[inertia]
v = { v = "M" }
[readings]
y = "q"
[parameters]
M = { value = 95.0, unit = "kg", bounds = [50.0, 150.0] }
Fc = { value = 20.4, unit = "N" }
[initial]
q = 0.0
v = 0.0
[columns]
t = "time_s"
force = "force_N"
y = "position_m"
"""
FINDING: dict[str, Any] = {
    "site": "equation:v",
    "mechanism": "coulomb_friction",
    "family": "dissipative",
    "probability": 0.97,
    "alternatives": [
        {
            "mechanism": "stribeck_friction",
            "site": "equation:v",
            "probability": 0.03,
            "parameters": {},
        }
    ],
    "edit": {"equations.v": "force - Fc*sign(v)"},
    "term": "-Fc*sign(v)",
    "parameters": {
        "Fc": {"value": 20.4, "ci95": [20.1, 20.7], "unit": "N"},
        "w": {"value": 1.5, "ci95": None},
    },
    "where": {"region": [], "recordings": ["a.csv"], "times": [[0.0, 24.8]]},
    "share": 0.81,
    "explanation": "Dry friction acts along v.",
}
DOCUMENT: dict[str, Any] = {
    "schema": "jaxsr.diagnosis/1",
    "verdict": "structure",
    "findings": [FINDING],
    "calibration": {"M": {"value": 95.1, "ci95": [94.9, 95.3]}},
    "fit": {
        "measure": "free-run NRMSE",
        "horizons_s": [0.25, 2.5, 24.8],
        "headline_s": 2.5,
        "train": {
            "given": [0.02, 0.14, 0.41],
            "recalibrated": [0.02, 0.10, 0.30],
            "explained": [0.001, 0.01, float("nan")],
        },
        "held_out": None,
        "force": None,
    },
    "provenance": {"seconds": 1.0},
}


def diagnosis(**changes: Any) -> Diagnosis:
    """Return a diagnosis of a drive whose simulator lacks friction."""
    time = np.linspace(0.0, 5.0, 400)
    y = np.sin(time)
    runs = [
        Trajectory("a.csv", "train", "y", "m", 2.5, time, y, y + 0.2, y + 0.1, y + 0.01),
        Trajectory("b.csv", "held_out", "y", "m", 2.5, time, y, y + 0.2, y + 0.1, y + 0.01),
    ]
    force = ForceResidual(
        "equation:v", "a.csv", "N", time, np.sign(y), 0.1 * y, "v", np.cos(time), "m/s"
    )
    evidence = Evidence("drive", trajectories=runs, residuals=[force])
    model = parse_model(DRIVE)
    document = {**copy.deepcopy(DOCUMENT), **changes}
    return Diagnosis(model, model, document, evidence)


def test_everything_that_is_promised_is_there_and_nothing_is_loaded_for_it() -> None:
    for name in jaxsr.__all__:
        assert getattr(jaxsr, name) is not None
    wanted = "Diagnosis Discovery Finding Interval InputError SearchConfig Treatment"
    assert {*wanted.split(), "register_mechanism", "diagnose_many"} <= set(jaxsr.__all__)
    heavy = ("jax", "numpy", "pandas", "sympy", "matplotlib", "typing")
    code = f"import jaxsr, sys; print([m for m in {heavy[:-1]} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "[]\n", done.stderr


def test_findings_have_names_and_keep_their_keys() -> None:
    found = diagnosis()
    (finding,) = found.findings
    assert isinstance(finding, jaxsr.Finding)
    assert (finding.mechanism, finding.site, finding.family) == (
        "coulomb_friction",
        "equation:v",
        "dissipative",
    )
    assert finding.probability == 0.97 and finding.share == 0.81 and finding.term == "-Fc*sign(v)"
    constant = finding.parameters["Fc"]
    assert isinstance(constant, Estimate)
    low, high = constant.interval or (0.0, 0.0)
    assert (constant.value, low, high, constant.unit) == (20.4, 20.1, 20.7, "N")
    assert constant.interval == jaxsr.Interval(20.1, 20.7) and 20.4 in jaxsr.Interval(20.1, 20.7)
    assert 20.8 not in jaxsr.Interval(20.1, 20.7)
    assert finding.parameters["w"].interval is None and finding.parameters["w"].unit is None
    (rival,) = finding.alternatives
    assert isinstance(rival, Rival)
    assert (rival.mechanism, rival.site, rival.probability) == (
        "stribeck_friction",
        "equation:v",
        0.03,
    )
    # The keys of the document, as before.
    assert finding["parameters"]["Fc"]["ci95"] == [20.1, 20.7] and finding == FINDING
    assert found.findings == [FINDING] and json.loads(json.dumps(found.findings)) == [FINDING]
    assert finding.to_dict() == FINDING and type(finding.to_dict()) is dict
    assert found.calibration["M"].interval == (94.9, 95.3)
    for part in (finding, constant, rival, found):
        assert "\n" not in repr(part)
    assert repr(finding) == "<Finding coulomb_friction at equation:v, probability 0.97>"
    assert str(finding).startswith("Coulomb friction, equation of v: Fc = 20.4")


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        (9.819206, 0.012746, "9.819"),
        (-0.12125, 0.00017, "-0.12125"),
        (20.4, 0.13, "20.40"),  # a zero is a digit
        (9.9996, 0.013, "10.000"),
        (49.9412, 0.0997, "49.94"),  # the half width is 0.10
        (123456.0, 3000.0, "1.235e+05"),
        (0.05, 3.0, "0.050"),  # wider than the value
        (0.0, 0.1, "0.0"),
        (20.0, 1e-12, "20"),
        (20.0, 0.0, None),
        (20.0, math.inf, None),
        (20.0, math.nan, None),
    ],
)
def test_a_value_has_the_digits_that_its_interval_justifies(
    value: float, half: float, text: str | None
) -> None:
    assert jaxsr.Interval(value - half, value + half).text(value) == text


def test_the_document_is_that_of_the_file(tmp_path: Path) -> None:
    found = diagnosis()
    found.save(tmp_path / "out")
    again = jaxsr.load(tmp_path / "out")
    written = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert found.to_dict() == again.to_dict() == written
    assert written["fit"]["train"]["explained"][2] is None  # no NaN leaves the house
    assert isinstance(again, jaxsr.Diagnosis) is False and again.findings == found.findings
    assert str(again) == str(found) and again.sentence == found.sentence
    assert repr(again) == repr(found).replace("Diagnosis", "SavedDiagnosis")


@pytest.mark.parametrize(
    "verdict", ["nothing", "parameter", "structure", "measurement", "external_input", "undecided"]
)
@pytest.mark.parametrize("left", ["", "The time budget ended the search."])
def test_one_verdict_is_said_in_one_sentence(verdict: str, left: str, tmp_path: Path) -> None:
    finding = {**FINDING, "mechanism": "wrong_value", "site": "parameter:Fc"}
    findings = [] if verdict == "nothing" else [finding if verdict == "parameter" else FINDING]
    open_ = {"open": {"message": left}} if left else {}
    found = diagnosis(verdict=verdict, findings=findings, provenance=open_)
    found = replace(found, evidence=Evidence("drive"))  # no figures
    sentence = verdict_sentence(found.document)
    assert found.sentence == f"{sentence} {left}".strip() and found.sentence.isascii()
    assert verdict_line(found) == f"Verdict: {verdict}. {found.sentence}"
    assert str(found).splitlines()[0] == f"{verdict}: {found.sentence}"
    found.save(tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    for shown in (page, found._repr_html_()):
        assert sentence in shown and left in shown
    if verdict == "parameter":
        assert "Fc is 20.40 N (20.10 to 20.70)" in sentence


def test_a_table_a_card_and_a_line() -> None:
    found = diagnosis()
    assert repr(found) == "<Diagnosis structure: coulomb_friction at equation:v>"
    lines = str(found).splitlines()
    assert lines[2].split() == ["finding", "site", "probability", "share", "constants"]
    assert "Fc = 20.40 N [20.10, 20.70], w = 1.5" in lines[3]
    assert lines[-1] == "error over 2.5 s, training recordings: 10 % re-calibrated, 1.0 % explained"
    assert str(found).isascii()
    card = found._repr_html_()
    for text in ("Physics is missing", "Coulomb friction", "20.10 … 20.70", "97 %", "-Fc*sign(v)"):
        assert text in card
    assert "<script" not in card and card.count("<div") == card.count("</div")
    hostile = {**FINDING, "term": "<script>alert(1)</script>"}
    assert "<script" not in diagnosis(findings=[hostile])._repr_html_()


def test_figures_of_free_runs_residuals_and_the_posterior() -> None:
    found = diagnosis()
    for kind, axes in (("free_runs", 4), ("residuals", 2), ("posterior", 1)):
        figure = found.plot(kind)  # type: ignore[arg-type]
        figure.canvas.draw()
        assert len(figure.axes) == axes, kind
    bars = [bar.get_width() for bar in found.plot("posterior").axes[0].patches]
    assert bars == [0.97, 0.03]
    given = matplotlib.figure.Figure()
    assert found.plot("posterior", given) is given and given.axes
    with pytest.raises(jaxsr.InputError, match="cannot plot 'residual'"):
        found.plot("residual")  # type: ignore[arg-type]
    with pytest.raises(jaxsr.InputError, match="no finding to draw"):
        diagnosis(findings=[]).plot("posterior")
    matplotlib.pyplot.close("all")


def test_results_read_back_draw_what_they_hold(tmp_path: Path) -> None:
    replace(diagnosis(), evidence=None).save(tmp_path / "out")
    again: Any = jaxsr.load(tmp_path / "out")
    assert again.plot("posterior", matplotlib.figure.Figure()).axes
    with pytest.raises(jaxsr.InputError, match="free_runs are not among the results"):
        again.plot()


def test_what_is_explained_runs() -> None:
    t = np.linspace(0.0, 1.0, 101)
    pushed = jaxsr.Recording.from_arrays(t, {"force_N": np.full(t.size, 115.4)}, "push")
    run = diagnosis().explained.simulate(pushed)
    assert run.name == "simulated push" and set(run.channels) >= {"force_N", "position_m", "v"}
    np.testing.assert_allclose(run.channels["position_m"], 0.5 * t**2, atol=2e-3)


def test_a_command_exports_results_and_models(tmp_path: Path, capsys: Any) -> None:
    replace(diagnosis(), evidence=None).save(tmp_path / "out")
    assert cli.main(["export", str(tmp_path / "out"), "--to", "c", "--name", "drive"]) == 0
    text = capsys.readouterr().out
    assert "void drive_rates(" in text and text == diagnosis().export("c", "drive")
    target = tmp_path / "m.mo"
    explained = str(tmp_path / "out" / "explained.toml")
    assert cli.main(["export", explained, "--to", "modelica", "--out", str(target)]) == 0
    assert target.read_text().startswith("model drive ")
    assert cli.main(["export", explained, "--to", "c", "--out", explained]) == 2
    assert cli.main(["export", explained, "--to", "fortran"]) == 2
    assert cli.main(["export", str(tmp_path), "--to", "c"]) == 2
    assert "holds no results" in capsys.readouterr().err


def test_a_diagnosis_begins_with_a_simulator_a_model_or_its_file(tmp_path: Path) -> None:
    """The refusal of a recording without the model's columns comes from the diagnosis itself."""
    text = '[model]\nstates = ["x"]\noutputs = ["y"]\n[equations]\nx = "-x"\n[readings]\ny = "x"\n'
    path = tmp_path / "model.toml"
    path.write_text(text)
    model = parse_model(text)
    other = jaxsr.Recording("other", np.arange(50.0), {"z": np.ones(50)})
    for given in (Simulator(model), model, path, str(path)):
        with pytest.raises(jaxsr.InputError, match="y"):
            jaxsr.diagnose(given, [other])
    with pytest.raises(jaxsr.InputError, match="absent"):
        jaxsr.diagnose(tmp_path / "absent.toml", [other])


def test_recordings_from_arrays_and_pandas() -> None:
    t = np.arange(5) * 0.1
    run = jaxsr.Recording.from_arrays(list(t), {"y": [1, 2, np.nan, 4, 5]}, "bench")
    assert repr(run) == "<Recording bench: 5 samples over 0.4 s, 0.1 s apart; y>"
    assert str(run).splitlines()[1] == "  y: 1 to 5, 1 missing"
    pd.testing.assert_frame_equal(
        run.to_pandas(), jaxsr.Recording.from_pandas(run.to_pandas()).to_pandas()
    )
    frames = {
        "column": pd.DataFrame({"time": t, "y": t, "label": list("abcde")}),
        "milliseconds": pd.DataFrame({"time_ms": 1e3 * t, "y": t}),
        "index": pd.DataFrame({"y": t}, index=t),
        "dates": pd.DataFrame({"y": t}, index=pd.date_range("2024-01-01", periods=5, freq="100ms")),
        "zone": pd.DataFrame(
            {"y": t}, index=pd.date_range("2024-01-01", periods=5, freq="100ms", tz="Asia/Tokyo")
        ),
        "deltas": pd.DataFrame({"y": t}, index=pd.to_timedelta(t, unit="s")),
        "nullable": pd.DataFrame({"t": t, "y": pd.array([0, 1, None, 3, 4], dtype="Int64")}),
    }
    for name, frame in frames.items():
        found = jaxsr.Recording.from_pandas(frame, name=name)
        np.testing.assert_allclose(found.time - found.time[0], t, atol=1e-9, err_msg=name)
        assert list(found.channels) == ["y"], name
    assert "label" in jaxsr.Recording.from_pandas(frames["column"]).set_aside
    assert np.isnan(jaxsr.Recording.from_pandas(frames["nullable"]).channels["y"][2])
    counted = jaxsr.Recording.from_pandas(pd.DataFrame({"y": t}), sample_time=0.1)
    np.testing.assert_allclose(counted.time, t)
    with pytest.raises(jaxsr.InputError, match="no time"):
        jaxsr.Recording.from_pandas(pd.DataFrame({"y": t}))
    with pytest.raises(jaxsr.InputError, match="two columns are named 'y'"):
        jaxsr.Recording.from_pandas(pd.DataFrame(np.ones((5, 2)), columns=["y", "y"]))
    figure = run.plot(figure=matplotlib.figure.Figure())
    assert [axes.get_ylabel() for axes in figure.axes] == ["y"]
    with pytest.raises(jaxsr.InputError, match="no column 'z'"):
        run.plot(["z"], matplotlib.figure.Figure())


def test_simulators_from_sympy_are_those_of_the_same_model_file() -> None:
    q, v, u, c, m = sympy.symbols("q v u c m")
    made = Simulator.from_sympy(
        {q: v, v: u - c * v * sympy.Abs(v)},
        {m: 2.0, c: (0.5, 0.0, 3.0)},
        inputs=[u],
        inertia={v: {v: m}},
        readings={"y": 2 * q},
        initial={q: 0.0},
        units={"q": "m"},
        name="cart",
    ).model
    text = """
[model]
name = "cart"
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u - c*v*Abs(v)"
[inertia]
v = { v = "m" }
[readings]
y = "2.0*q"
[parameters]
m = 2.0
c = { value = 0.5, bounds = [0.0, 3.0] }
[initial]
q = 0.0
[units]
q = "m"
"""
    given = parse_model(text)
    for table in ("states", "inputs", "outputs", "parameters", "initial", "units", "name"):
        assert getattr(made, table) == getattr(given, table), table
    values = {"q": 0.3, "v": -1.2, "u": 0.7, "m": 2.0, "c": 0.5, "t": 0.0}
    for ours, theirs in zip(
        Simulator(made).sympy().values(), Simulator(given).sympy().values(), strict=True
    ):
        numbers = [
            float(e.subs({s: values[str(s)] for s in e.free_symbols})) for e in (ours, theirs)
        ]
        assert numbers[0] == pytest.approx(numbers[1], rel=1e-14)


def test_the_mass_matrix_of_mechanics_comes_over() -> None:
    a, w = dynamicsymbols("a w")
    t = sympy.Symbol("t")
    matrix = sympy.Matrix([[1, 0], [0, 2 + sympy.cos(a)]])
    swing = Simulator.from_sympy({a: w, w: -9.81 * sympy.sin(a) + sympy.sin(t)}, inertia=matrix)
    assert swing.model.states == ("a", "w") and set(swing.model.inertia) == {"w"}
    rate = swing.to_numpy()(0.5, [0.3, 0.0])[1]
    assert rate == pytest.approx((-9.81 * np.sin(0.3) + np.sin(0.5)) / (2 + np.cos(0.3)))
    with pytest.raises(jaxsr.InputError, match="is a derivative"):
        Simulator.from_sympy({a: w, w: -a.diff(t)})
    with pytest.raises(jaxsr.InputError, match="mass matrix of shape"):
        Simulator.from_sympy({a: w, w: -a}, inertia=sympy.eye(3))
    with pytest.raises(jaxsr.InputError, match="not part of the model grammar"):
        Simulator.from_sympy({a: sympy.gamma(a)})
    with pytest.raises(jaxsr.InputError, match="unknown symbol 'k'"):
        Simulator.from_sympy({a: -sympy.Symbol("k") * a})
