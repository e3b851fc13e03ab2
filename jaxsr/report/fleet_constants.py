"""Constants over the machines of a fleet, as its page shows them."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from jaxsr.report.formatting import estimate, is_number, number, sureness, unit_text
from jaxsr.report.words import capital, mechanism_words, site_words

_YEAR = 365.25  # days


@dataclass(frozen=True)
class Measured:
    """What one case says of a constant.

    Attributes
    ----------
    case, machine : str
    row : mapping
        Its ``value`` and ``ci95``.
    probability : float or None
        Of its mechanism.
    date : datetime or None
    """

    case: str
    machine: str
    row: Mapping[str, Any] = field(repr=False)
    probability: Any = None
    date: datetime | None = None

    @property
    def known(self) -> bool:
        """Whether there is a value."""
        return is_number(self.row.get("value"))

    @property
    def value(self) -> float:
        """The value."""
        return float(self.row["value"])

    @property
    def low(self) -> float:
        """Lower end of the interval; the value where there is none."""
        return self._ends()[0]

    @property
    def high(self) -> float:
        """Upper end of the interval; the value where there is none."""
        return self._ends()[1]

    def _ends(self) -> tuple[float, float]:
        ends = self.row.get("ci95") or ()
        if len(ends) == 2 and all(is_number(end) for end in ends):
            return float(ends[0]), float(ends[1])
        return self.value, self.value


@dataclass(frozen=True)
class FleetConstant:
    """A constant over the machines.

    Attributes
    ----------
    mechanism : str
        Empty for a value that was re-calibrated.
    site, name, unit : str
    rows : tuple of Measured
    outliers : mapping of str to (float, float)
        Machines that stand out, and the intervals in which the others predict them.
    drifts : mapping of str to (float, float, float)
        Machines whose constant changes: per day, with the ends of its 95 % interval.
    """

    mechanism: str
    site: str
    name: str
    unit: str
    rows: tuple[Measured, ...] = field(repr=False)
    outliers: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    drifts: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """What it is, for a heading."""
        if not self.mechanism:
            return f"Re-calibrated: {self.name}"
        return f"{capital(mechanism_words(self.mechanism))}, {site_words(self.site)}: {self.name}"

    def card(self) -> dict[str, Any]:
        """Return what the page shows, the greatest value first."""
        known = sorted((row for row in self.rows if row.known), key=lambda row: -row.value)
        low = min((row.low for row in known), default=0.0)
        span = max((row.high for row in known), default=1.0) - low or 1.0
        middle = statistics.median(row.value for row in known) if known else None
        return {
            "title": self.title,
            "unit": unit_text(self.unit),
            "median": number(middle),
            "rows": [self._shown(row, low, span) for row in known],
            "dated": any(row.date for row in known),
        }

    def _shown(self, row: Measured, low: float, span: float) -> dict[str, Any]:
        value, interval = estimate(row.value, row.row.get("ci95"))
        own = "" if row.machine == row.case else row.machine
        return {
            **{"case": row.case, "machine": own, "value": value, "interval": interval},
            "date": row.date.date().isoformat() if row.date is not None else "",
            "probability": sureness(row.probability) if row.probability is not None else "",
            "outlier": row.machine in self.outliers,
            "left": round(100.0 * (row.low - low) / span, 2),
            "width": round(max(100.0 * (row.high - row.low) / span, 0.8), 2),
        }

    def remarks(self) -> list[tuple[str, str]]:
        """Return what stands out and what drifts: the machine, and a sentence."""
        unit = f" {unit_text(self.unit)}" if unit_text(self.unit) else ""
        told: list[tuple[str, str]] = []
        for machine, (low, high) in self.outliers.items():
            values = [row.value for row in self.rows if row.known and row.machine == machine]
            value = number(statistics.fmean(values), 3)
            reach = f"{number(low, 3)} to {number(high, 3)}{unit}"
            told.append((machine, f"{self.title} is {value}{unit}; the others predict {reach}"))
        for machine, slope in self.drifts.items():
            factor, per = _unit_of_time([row for row in self.rows if row.machine == machine])
            middle, low, high = (factor * x for x in slope)
            change, interval = estimate(middle, (low, high))
            word = "grows" if middle > 0.0 else "falls"
            what = f"{self.title} {word}: {change}{unit} per {per}, 95 % interval {interval}"
            told.append((machine, what))
        return told


def _unit_of_time(rows: Sequence[Measured]) -> tuple[float, str]:
    """Return days in the unit that suits the span of the dates, and its name."""
    dates = [row.date for row in rows if row.date is not None]
    days = (max(dates) - min(dates)).days if dates else 0
    return (_YEAR, "year") if days >= 0.5 * _YEAR else (1.0, "day")
