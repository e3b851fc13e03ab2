"""Criteria: which of several sets the recordings speak for, with the price of their constants."""

from __future__ import annotations

from jaxsr.diagnosis.shooting.converters import independent_samples
from jaxsr.diagnosis.shooting.entry import Entry


def independent_residuals(entry: Entry) -> float:
    """How many independent residuals the recordings hold, by their correlation and their steps."""
    return max(independent_samples(entry.fit.residual, entry.converters), 10.0)
