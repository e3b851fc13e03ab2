"""Results read back from the folder that a command or `save` wrote."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import jaxsr

FALL = """
[model]
name = "fall"
states = ["x", "v"]
outputs = ["height"]
[equations]
x = "v"
v = "-9.81 - k*v"
[readings]
height = "x"
[parameters]
k = { value = 0.5, unit = "1/s", bounds = [0.0, 2.0] }
"""


def diagnosed(folder: Path) -> Path:
    folder.mkdir()
    document = {
        "schema": "jaxsr.diagnosis/1",
        "verdict": "structure",
        "findings": [{"mechanism": "viscous_damping", "site": "equation:v"}],
        "fit": {"headline_s": 1.0},
        "provenance": {},
    }
    (folder / "diagnosis.json").write_text(json.dumps(document))
    (folder / "explained.toml").write_text(FALL)
    return folder


def test_a_diagnosis_reads_back_and_its_model_runs(tmp_path: Path) -> None:
    found = jaxsr.load(diagnosed(tmp_path / "results"))
    assert found.verdict == "structure" and found.fit == {"headline_s": 1.0}
    assert found.sentence == "The model leaves out viscous damping in the equation of v."
    assert found.model.parameters["k"].value == 0.5
    assert jaxsr.Simulator(found.model).model is found.model


def test_a_discovery_reads_back(tmp_path: Path) -> None:
    t = np.linspace(0.0, 3.0, 60)
    decay = jaxsr.Recording("decay", t, {"x": np.exp(-t), "dx": -np.exp(-t)})
    options = {"states": ["x"], "derivatives": ["dx"], "autonomous": True, "modes": 1}
    found = jaxsr.discover([decay], seed=0, budget=10.0, **options)
    found.save(tmp_path / "equations")
    again = jaxsr.load(tmp_path / "equations")
    assert again.verdict == found.verdict and again.reason == found.reason
    assert again.equations == json.loads(json.dumps(found.to_dict()["equations"]))
    assert again.model.equations == found.model.equations
    assert repr(found) == f"<Discovery {found.verdict}: rates of x>"
    assert repr(again) == repr(found).replace("Discovery", "SavedDiscovery")
    assert found._repr_html_() == again._repr_html_() and "<math" in found._repr_html_()
    (term,) = found["x"].terms
    assert term.interval == term.ci95 and term.coefficient in term.interval
    assert found.export("c") == again.export("c") and "dx[0] = " in again.export("c")
    (same,) = again["x"].terms
    for name in ("term", "expression", "coefficient", "ci95", "interval"):
        assert getattr(same, name) == getattr(term, name), name
    for name in ("state", "expression", "term", "complexity", "operators", "train_mse"):
        assert getattr(again["x"], name) == getattr(found["x"], name), name
    assert again["x"].sympy() == found["x"].sympy() == found.sympy("x") == again.sympy("x")
    assert again.latex("x", 2) == found.latex("x", 2) and again.latex() == found.latex()
    assert again.sympy() == found.sympy() and list(again.sympy()) == ["x"]
    assert again.free_run_nrmse == found.free_run_nrmse
    shared = ["state", "complexity", "mse", "expression"]
    pd.testing.assert_frame_equal(again.pareto, found.pareto[shared].reset_index(drop=True))
    for rates in (found.to_numpy(), again.to_numpy(), found.simulator.to_numpy()):
        np.testing.assert_allclose(rates({"t": t, "x": np.exp(-t)})["x"], -np.exp(-t), rtol=1e-3)
        np.testing.assert_allclose(rates(t, [np.exp(-t)]), [-np.exp(-t)], rtol=1e-3)
    by_jax = again.to_jax()({"t": 0.0, "x": 2.0})["x"], again.to_jax()(0.0, [2.0])[0]
    assert by_jax == pytest.approx((-2.0, -2.0), rel=1e-3)
    for result in (found, again, again.simulator):
        with pytest.raises(jaxsr.InputError, match=r"no (equation of|state) 'y'"):
            result.latex("y")
    run = jaxsr.Recording.from_arrays(t, {"x": np.exp(-t)})
    np.testing.assert_allclose(again.simulator.simulate(run).channels["x"], np.exp(-t), atol=1e-4)


@pytest.mark.parametrize("damage", ["empty", "both", "cut", "other form", "list"])
def test_a_folder_of_something_else_is_refused_in_a_line(tmp_path: Path, damage: str) -> None:
    folder = diagnosed(tmp_path / "results")
    path = folder / "diagnosis.json"
    if damage == "empty":
        path.unlink()
    elif damage == "both":
        (folder / "discovery.json").write_text("{}")
    else:
        texts = {"cut": '{"schema": ', "other form": '{"schema": "x/2"}', "list": "[]"}
        path.write_text(texts[damage])
    with pytest.raises(jaxsr.InputError, match="results") as caught:
        jaxsr.load(folder)
    assert "\n" not in str(caught.value)
