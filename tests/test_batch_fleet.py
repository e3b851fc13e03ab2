"""Constants over machines: outliers and drifts at the rates that are stated, and the page."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

import jaxsr
from jaxsr._saved import SavedDiagnosis
from jaxsr.batch import Case
from jaxsr.batch.constants import ALARM, constants_of
from jaxsr.batch.scatter import outliers, regression, trend
from jaxsr.models import parse_model
from jaxsr.report.batch_report import Shown, batch_page

MODEL = """
[model]
states = ["v"]
inputs = ["u"]
outputs = ["v"]
[equations]
v = "u - Fv*v"
[readings]
v = "v"
[parameters]
Fv = { value = 1.0, unit = "N*s/m", bounds = [0.1, 5.0] }
"""


def saved(fc: float, fv: float, error: float = 0.01) -> SavedDiagnosis:
    """Return a diagnosis that found Coulomb friction and re-calibrated viscous friction."""
    ends = [fc - 1.96 * error, fc + 1.96 * error]
    friction = {
        **{"site": "equation:v", "mechanism": "coulomb_friction", "probability": 0.97},
        **{"family": "dissipative", "share": 1.0, "term": "-Fc*sign(v)", "alternatives": []},
        **{"parameters": {"Fc": {"value": fc, "ci95": ends, "unit": "N"}}, "edit": {}},
    }
    document: dict[str, Any] = {
        **{"schema": "jaxsr.diagnosis/1", "verdict": "structure", "findings": [friction]},
        **{"calibration": {"Fv": {"value": fv, "ci95": [fv - 0.1, fv + 0.1]}}, "fit": {}},
        **{"provenance": {}},
    }
    return SavedDiagnosis(Path("."), document, parse_model(MODEL, "m.toml"))


def test_one_value_is_predicted_by_the_others_as_for_a_normal_sample() -> None:
    """Without errors of their own: Student's prediction interval of the other n - 1."""
    values = np.array([1.0, 1.3, 0.9, 1.1, 2.0])
    others = values[:4]
    (found,) = outliers(values, np.zeros(5), 0.05)
    reach = stats.t.isf(0.025, 3) * others.std(ddof=1) * np.sqrt(1.0 + 0.25)
    assert found.place == 4
    assert (found.low, found.high) == pytest.approx((1.075 - reach, 1.075 + reach))
    assert not outliers(values, np.full(5, 5.0), 0.05)  # its own error covers it


def test_the_line_is_that_of_least_squares() -> None:
    rng = np.random.default_rng(5)
    days = np.array([0.0, 10.0, 35.0, 50.0, 90.0])
    values = 3.0 + 0.2 * days + 0.1 * rng.standard_normal(5)
    plain = stats.linregress(days, values)
    found = trend(days, values, np.zeros(5), 0.01)
    assert found is not None
    reach = stats.t.isf(0.025, 3) * plain.stderr
    expected = (plain.slope, plain.slope - reach, plain.slope + reach)
    assert (found.slope, found.low, found.high) == pytest.approx(expected)
    # Errors that explain all scatter: the weights are theirs, the covariance as well.
    design, errors = np.column_stack([np.ones(5), days]), np.array([1.0, 2.0, 1.0, 3.0, 1.0])
    fit = regression(design, 3.0 + 0.2 * days, errors)
    assert fit.variance == 0.0
    known = np.linalg.inv(design.T @ np.diag(errors**-2.0) @ design)
    assert fit.covariance == pytest.approx(known, rel=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("own", [0.0, 0.5, 3.0])
def test_alarms_are_false_as_rarely_as_stated(own: float) -> None:
    """Machines that are alike, errors that differ up to threefold, beside a scatter of one."""
    rng, fleets, rate = np.random.default_rng(37), 250, 0.05
    alarms = drifts = 0
    for _ in range(fleets):
        errors = own * rng.uniform(0.5, 1.5, 8)
        values = 10.0 + rng.standard_normal(8) + errors * rng.standard_normal(8)
        alarms += len(outliers(values, errors, rate))
        drifts += trend(rng.uniform(0.0, 300.0, 8), values, errors, rate) is not None
    assert alarms <= stats.binom.isf(1e-3, 8 * fleets, rate)
    assert drifts <= stats.binom.isf(1e-3, fleets, rate)


def test_the_page_tells_which_machine_stands_out_and_which_drifts() -> None:
    rng = np.random.default_rng(8)
    diagnoses, cases = dict[str, SavedDiagnosis](), dict[str, Any]()
    for k in range(10):
        fc = 20.0 if k == 3 else 5.0 + 0.2 * rng.standard_normal()
        for month in range(5):
            name = f"m{k}_{month}"
            fv = 1.0 + 0.05 * rng.standard_normal() + (0.5 * month if k == 6 else 0.0)
            diagnoses[name] = saved(fc + 0.02 * rng.standard_normal(), fv)
            date = datetime(2024, 1, 1) + timedelta(days=91 * month)
            cases[name] = Case("m.toml", "a.csv", machine=f"m{k}", date=date)
    friction, viscous = constants_of(diagnoses, cases)
    assert list(friction.outliers) == ["m3"] and not friction.drifts
    assert list(viscous.drifts) == ["m6"]
    slope, low, high = viscous.drifts["m6"]
    assert low < 0.5 / 91.0 < high and slope == pytest.approx(0.5 / 91.0, rel=0.2)
    low, high = friction.outliers["m3"]
    assert 3.5 < low < 5.0 < high < 6.5

    documents = {name: found.document for name, found in diagnoses.items()}
    page = batch_page(Shown(documents, [friction, viscous], {}, (), ALARM))
    assert "What stands out, and what drifts" in page and "at most 5 % show a drift" in page
    assert "the others predict" in page and "per year, 95 % interval" in page
    assert page.count("stands out</b>") == 5 and "2024-04-01" in page


def test_a_machine_of_many_cases_is_one_machine() -> None:
    """Ten cases of one machine among few others are no evidence of how machines spread."""
    diagnoses, cases = dict[str, SavedDiagnosis](), dict[str, Any]()
    for k in range(10):
        diagnoses[f"a{k}"] = saved(5.0 + 0.001 * k, 1.0)
        cases[f"a{k}"] = Case("m.toml", "a.csv", machine="a")
    for k, fc in enumerate((5.4, 4.7, 5.2)):
        diagnoses[f"b{k}"] = saved(fc, 1.0)
        cases[f"b{k}"] = Case("m.toml", "a.csv")
    assert not constants_of(diagnoses, cases)[0].outliers


@pytest.mark.parametrize("date", ["2024-13-01", 20240101, "May"])
def test_dates_are_refused_in_a_line(date: Any) -> None:
    with pytest.raises(jaxsr.InputError, match="2024-05-31"):
        Case("m.toml", "a.csv", date=date)
