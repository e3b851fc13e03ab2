"""Reports: one HTML file that an engineer reads in a minute, figures inside and beside it."""

from jaxsr.report.diagnosis_report import write_diagnosis_report
from jaxsr.report.discovery_report import write_discovery_report
from jaxsr.report.evidence import (
    Considered,
    DiffRow,
    EquationFit,
    Evidence,
    ForceResidual,
    Trajectory,
)

__all__ = [
    "Considered",
    "DiffRow",
    "EquationFit",
    "Evidence",
    "ForceResidual",
    "Trajectory",
    "write_diagnosis_report",
    "write_discovery_report",
]
