"""Findings that a sensor reads absolute values."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.judging.refine import Estimate
from jaxsr.models import Edit


def rectified_rows(
    case: Case, estimate: Estimate, given_cost: float, where: dict[str, Any]
) -> tuple[list[dict[str, Any]], list[Edit]]:
    """Return findings, and edits of the estimate's model.

    Without a sign a reading is off by twice its size wherever it is negative; that, beside what the
    given model leaves of the signed readings, is the share.
    """
    rows, edits = [], []
    problem, given = estimate.arena.problem, case.simulator.model
    for sensor in case.rectified:
        k = list(given.outputs).index(sensor.output)
        readings = problem.segments.outputs[k]
        lost = np.where(readings < 0.0, 2.0 * readings, 0.0) / problem.scale[k]
        power = float(np.sum(problem.segments.weights[k] * lost**2))
        edit = sensor.edit(given)
        edits.append(sensor.edit(estimate.model))
        rows.append(
            {
                "site": f"output:{sensor.output}",
                "mechanism": "rectified",
                "family": "measurement",
                "probability": sensor.probability,
                "alternatives": [],
                "edit": edit.as_json(),
                "term": edit.changes[f"readings.{sensor.output}"],
                "parameters": {},
                "where": where,
                "share": power / max(power + given_cost, 1e-300),
                "explanation": f"Sensor {sensor.output} reads the absolute value of what the model "
                "says: its readings turn at zero in corners that no motion has.",
            }
        )
    return rows, edits
