"""The validator of diagnosis.json finds what it is there to find."""

from __future__ import annotations

import copy
from typing import Any

import diagnosis_schema
import form_running
import pytest

NAMES = {
    **{"states": ("q", "v"), "inputs": ("u",), "outputs": ("y",), "parameters": ("m", "Fv")},
    "files": ("a.csv",),
}
FINDING: dict[str, Any] = {
    "site": "equation:v",
    "mechanism": "coulomb_friction",
    "family": "dissipative",
    "probability": 0.9,
    "alternatives": [
        {
            **{"mechanism": "stribeck_friction", "site": "equation:v", "probability": 0.1},
            "parameters": {},
        }
    ],
    "edit": {"equations.v": "u - Fc*sign(v)", "parameters.Fc": {"value": 2.0, "unit": None}},
    "term": "-Fc*sign(v)",
    "parameters": {"Fc": {"value": 2.0, "ci95": [1.9, 2.1], "unit": "N"}},
    "where": {"region": [], "recordings": ["a.csv"], "times": [[0.0, 1.0]]},
    "share": 0.8,
    "explanation": "Dry friction.",
}
ERRORS = {key: [0.1, 0.2, 0.3] for key in ("given", "recalibrated", "explained")}
DOCUMENT: dict[str, Any] = {
    "schema": "jaxsr.diagnosis/1",
    "verdict": "structure",
    "findings": [FINDING],
    "calibration": {"m": {"value": 1.0, "ci95": [0.9, 1.1]}},
    "fit": {
        **{"measure": "free-run NRMSE", "horizons_s": [0.1, 1.0, 5.0], "headline_s": 1.0},
        **{"train": ERRORS, "held_out": None, "force": {}},
    },
    "confusable": [["coulomb_friction", "stribeck_friction", 12.0]],
    "smallest_detectable": {
        "coulomb_friction@equation:v": {"parameter": "Fc", "value": 0.4, "unit": "N"}
    },
    "next_experiment": None,
    "data_checks": [],
    "provenance": {
        **{"version": "0", "seed": 0, "command": None, "seconds": 1.0, "stopped_by": "converged"},
        "data_sha256": {"a.csv": "0"},
    },
}


def test_a_right_document_has_no_problem() -> None:
    assert diagnosis_schema.problems(DOCUMENT, NAMES) == []


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("verdict",), "wrong", "verdict is"),
        (("verdict",), "nothing", "has findings"),
        (("verdict",), "parameter", "largest share"),
        (("findings", 0, "site"), "equation:w", "names none"),
        (("findings", 0, "site"), "v", "site is"),
        (("findings", 0, "mechanism"), "magic", "mechanism is"),
        (("findings", 0, "family"), "elastic", "family is"),
        (("findings", 0, "probability"), 0.95, "sum to"),
        (("findings", 0, "share"), 1.2, "share is"),
        (("findings", 0, "share"), float("nan"), "is nan"),
        (("findings", 0, "edit"), {}, "no edit"),
        (("findings", 0, "edit"), {"model.name": "x"}, "edit has"),
        (("findings", 0, "parameters", "Fc", "ci95"), [2.1, 2.2], "outside its interval"),
        (("findings", 0, "where", "recordings"), ["b.csv"], "none of DATA"),
        (("fit", "headline_s"), 2.0, "none of the horizons"),
        (("fit", "train", "given"), [0.1], "fit.train.given"),
        (("confusable", 0, 2), 91.0, "confusable"),
        (("provenance", "stopped_by"), "luck", "stopped_by"),
    ],
)
def test_what_breaks_the_contract_is_told(path: tuple, value: Any, said: str) -> None:
    document = copy.deepcopy(DOCUMENT)
    place = document
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    assert any(said in line for line in diagnosis_schema.problems(document, NAMES))


def test_nan_is_no_json() -> None:
    with pytest.raises(ValueError, match="NaN"):
        diagnosis_schema.strict_json('{"a": NaN}')


def test_an_edit_is_applied_to_the_tables_of_the_file() -> None:
    given = {"model": {"states": ["v"]}, "equations": {"v": "u"}, "events": [{"when": "v"}]}
    after = form_running.edited(given, FINDING["edit"])
    assert after["equations"]["v"] == "u - Fc*sign(v)" and given["equations"]["v"] == "u"
    assert after["parameters"]["Fc"] == {"value": 2.0}
    import tomllib

    assert tomllib.loads(form_running.toml_text(after)) == after


def test_the_place_of_a_crash_is_the_last_frame_inside_the_package() -> None:
    text = (
        'Traceback (most recent call last):\n  File "/a/jaxsr/cli.py", line 3, in main\n'
        '  File "/a/jaxsr/views/weak.py", line 215, in _weights\n'
        '  File "/b/numpy/linalg.py", line 9, in svd\nnumpy.linalg.LinAlgError: no\n'
    )
    told = "traceback: numpy.linalg.LinAlgError views/weak.py:215 _weights: "
    assert form_running.crash(text).startswith(told)
