"""Constants over the machines of a fleet: their values, what stands out, what drifts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from typing import Any

import numpy as np

from jaxsr._saved import SavedDiagnosis
from jaxsr.batch.cases import Case
from jaxsr.batch.islands import Islands
from jaxsr.batch.scatter import FEWEST, outliers, trend
from jaxsr.report.fleet_constants import FleetConstant, Measured

ALARM = 0.05
"""Rate at which a fleet of machines that are alike shows an outlier, and one of machines that stay
as they are a drift: each shared over all comparisons of a page."""
_NORMAL = 1.959964  # standard errors from the middle to the end of a 95 % interval


def constants_of(
    diagnoses: Mapping[str, SavedDiagnosis], cases: Mapping[str, Case | Islands]
) -> list[FleetConstant]:
    """Return every constant that was found or re-calibrated, over the machines.

    Parameters
    ----------
    diagnoses : mapping of str to SavedDiagnosis
        By case.
    cases : mapping of str to Case or Islands
        They name the machine and the date.
    """
    groups: dict[tuple[str, str, str, str], list[Measured]] = {}
    for name, found in diagnoses.items():
        case = cases.get(name)
        machine = (case.machine if isinstance(case, Case) else None) or name
        moment = case.date if isinstance(case, Case) else None
        for key, row, probability in _rows(found):
            value = Measured(name, machine, row, probability, moment)
            groups.setdefault(key, []).append(value)
    constants = [FleetConstant(*key, tuple(rows)) for key, rows in groups.items()]
    known = [replace(c, rows=tuple(row for row in c.rows if row.known)) for c in constants]
    compared = sum(len(by) for by in map(_by_machine, known) if len(by) > FEWEST)
    followed = sum(len(rows) >= FEWEST for c in known for rows in _dated(c).values())
    return [
        replace(
            constant,
            outliers=_outliers(own, ALARM / max(compared, 1)),
            drifts=_drifts(own, ALARM / max(followed, 1)),
        )
        for constant, own in zip(constants, known, strict=True)
    ]


def _rows(found: SavedDiagnosis) -> list[tuple[tuple[str, str, str, str], Any, Any]]:
    """Return the constants of a diagnosis: those of findings, then re-calibrated ones.

    A wrong value is one of the latter wherever the parameter is free.
    """
    document = found.document
    calibrated: Mapping[str, Any] = document.get("calibration") or {}
    rows: list[tuple[tuple[str, str, str, str], Any, Any]] = []
    sure: dict[str, Any] = {}
    findings: list[Mapping[str, Any]] = document.get("findings") or []
    for finding in findings:
        parameters: Mapping[str, Any] = finding.get("parameters") or {}
        mechanism, site = str(finding.get("mechanism")), str(finding.get("site"))
        for name, row in parameters.items():
            if mechanism == "wrong_value" and name in calibrated:
                sure[name] = finding.get("probability")
                continue
            key = (mechanism, site, str(name), str(row.get("unit") or ""))
            rows.append((key, row, finding.get("probability")))
    for name, row in calibrated.items():
        parameter = found.model.parameters.get(name)
        unit = str(parameter.unit or "") if parameter is not None else ""
        rows.append((("", f"parameter:{name}", name, unit), row, sure.get(name)))
    return rows


def _by_machine(constant: FleetConstant) -> dict[str, list[Measured]]:
    groups: dict[str, list[Measured]] = {}
    for row in constant.rows:
        groups.setdefault(row.machine, []).append(row)
    return groups


def _dated(constant: FleetConstant) -> dict[str, list[Measured]]:
    by = _by_machine(constant)
    return {machine: [r for r in rows if r.date is not None] for machine, rows in by.items()}


def _errors(rows: Sequence[Measured]) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([(row.high - row.low) / (2.0 * _NORMAL) for row in rows])


def _values(rows: Sequence[Measured]) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([row.value for row in rows])


def _outliers(constant: FleetConstant, rate: float) -> dict[str, tuple[float, float]]:
    """Return the machines that stand out, and the intervals in which the others predict them.

    Several cases of one machine are one value, their mean.
    """
    by = _by_machine(constant)
    machines, values, errors = list(by), list[float](), list[float]()
    for rows in by.values():
        own, several = _values(rows), len(rows)
        variance = max(float(np.mean(_errors(rows) ** 2)), float(own.var(ddof=several > 1)))
        values.append(float(own.mean()))
        errors.append(float(np.sqrt(variance / several)))
    found = outliers(np.array(values), np.array(errors), rate)
    return {machines[out.place]: (out.low, out.high) for out in found}


def _drifts(constant: FleetConstant, rate: float) -> dict[str, tuple[float, float, float]]:
    """Return the machines whose constant changes over their dates: slope per day, its interval."""
    found: dict[str, tuple[float, float, float]] = {}
    for machine, rows in _dated(constant).items():
        days = np.array([_days(row.date) for row in rows])
        slope = trend(days, _values(rows), _errors(rows), rate)
        if slope is not None:
            found[machine] = (slope.slope, slope.low, slope.high)
    return found


def _days(moment: datetime | None) -> float:
    return moment.timestamp() / 86_400.0 if moment is not None else float("nan")
