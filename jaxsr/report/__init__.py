"""Reports: one HTML file that an engineer reads in a minute, figures inside and beside it.

What draws is loaded on first use: diagnoses know the values that a report shows, and Matplotlib
takes long to load.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from jaxsr.report.evidence import (
    Considered,
    DiffRow,
    EquationFit,
    Evidence,
    ForceResidual,
    ModelRun,
    Trajectory,
)

if TYPE_CHECKING:
    from jaxsr.report.diagnosis_report import write_diagnosis_report
    from jaxsr.report.discovery_report import write_discovery_report

__all__ = [
    "Considered",
    "DiffRow",
    "EquationFit",
    "Evidence",
    "ForceResidual",
    "ModelRun",
    "Trajectory",
    "write_diagnosis_report",
    "write_discovery_report",
]

_HOMES = {
    "write_diagnosis_report": "jaxsr.report.diagnosis_report",
    "write_discovery_report": "jaxsr.report.discovery_report",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'jaxsr.report' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)
