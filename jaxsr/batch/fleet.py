"""What a batch found: the diagnoses by case, their table, their page."""

# pyright: reportMissingTypeStubs=false
from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pandas as pd

from jaxsr._files import atomic_write_text
from jaxsr._result import InputError
from jaxsr._saved import SavedDiagnosis, load
from jaxsr.batch.task import Outcome
from jaxsr.report.batch_report import batch_page
from jaxsr.report.summary import columns
from jaxsr.report.words import errors_at, headline_index

COLUMNS = (
    *("case", "status", "verdict", "mechanism", "site", "probability", "share", "parameter"),
    *("value", "low", "high", "unit", "error_recalibrated", "error_explained", "message"),
)


@dataclass(frozen=True, eq=False)
class Fleet:
    """The diagnoses of a batch.

    Attributes
    ----------
    directory : Path
        Holds a folder for each case.
    names : tuple of str
        Of all cases, in their order.
    outcomes : mapping of str to Outcome
        How those that ended did.
    diagnoses : mapping of str to SavedDiagnosis
        Of the cases that are done.
    """

    directory: Path
    names: tuple[str, ...]
    outcomes: Mapping[str, Outcome] = field(repr=False)
    diagnoses: Mapping[str, SavedDiagnosis] = field(repr=False)

    def with_outcome(self, outcome: Outcome) -> Fleet:
        """Return the batch with one more case that ended, its results read."""
        name, diagnoses = outcome.name, dict(self.diagnoses)
        if outcome.done:
            saved = load(self.directory / name)
            assert isinstance(saved, SavedDiagnosis)  # a batch writes nothing else there
            diagnoses[name] = saved
        return replace(self, outcomes={**self.outcomes, name: outcome}, diagnoses=diagnoses)

    @property
    def failures(self) -> dict[str, str]:
        """Why cases failed, by name."""
        ended = ((name, self.outcomes.get(name)) for name in self.names)
        return {name: o.message for name, o in ended if o is not None and not o.done}

    @property
    def waiting(self) -> tuple[str, ...]:
        """Names of the cases that did not run."""
        return tuple(name for name in self.names if name not in self.outcomes)

    def __getitem__(self, name: str) -> SavedDiagnosis:
        """Return the diagnosis of a case.

        Raises
        ------
        InputError
            There is none.
        """
        if name not in self.diagnoses:
            why = self.failures.get(name, "it is no case, or did not run")
            raise InputError(f"no diagnosis of {name!r:.80}: {why}", str(self.directory))
        return self.diagnoses[name]

    def __iter__(self) -> Iterator[str]:
        return (name for name in self.names if name in self.diagnoses)

    def __len__(self) -> int:
        return len(self.diagnoses)

    @property
    def table(self) -> pd.DataFrame:
        """Return a row for every constant of every finding, and one for a case without any."""
        rows = [row for name in self.names for row in self._rows(name)]
        return pd.DataFrame(rows, columns=list(COLUMNS))

    def _rows(self, name: str) -> list[dict[str, Any]]:
        if name not in self.diagnoses:
            status = "failed" if name in self.outcomes else "waiting"
            return [{"case": name, "status": status, "message": self.failures.get(name, "")}]
        found = self.diagnoses[name]
        before, after = headline_errors(found.document)
        common = {
            **{"case": name, "status": "done", "verdict": found.verdict},
            **{"error_recalibrated": before, "error_explained": after},
        }
        rows: list[dict[str, Any]] = []
        for finding in found.findings:
            head = {
                **common,
                **{"mechanism": finding.mechanism, "site": finding.site},
                **{"probability": finding.probability, "share": finding.share},
            }
            constants = [
                {
                    **{"parameter": key, "value": constant.value, "unit": constant.unit},
                    "low": constant.interval.low if constant.interval else None,
                    "high": constant.interval.high if constant.interval else None,
                }
                for key, constant in finding.parameters.items()
            ]
            rows += [{**head, **constant} for constant in constants or [{}]]
        return rows or [common]

    def write(self) -> None:
        """Write ``batch.csv`` and ``batch.html``."""
        table: Any = self.table
        text = str(table.to_csv(index=False, lineterminator="\n"))
        atomic_write_text(self.directory / "batch.csv", text)
        documents = {name: self.diagnoses[name].document for name in self}
        page = batch_page(documents, self.failures, self.waiting)
        atomic_write_text(self.directory / "batch.html", page)

    def __str__(self) -> str:
        """Return a line for every case."""
        rows = [("case", "verdict", "says")]
        for name in self.names:
            if name in self.diagnoses:
                found = self.diagnoses[name]
                rows.append((name, found.verdict, found.sentence))
            else:
                rows.append((name, "-", self.failures.get(name, "did not run")))
        return "\n".join(columns(rows))


def headline_errors(document: Mapping[str, Any]) -> tuple[float | None, float | None]:
    """Return the free-run errors, re-calibrated and explained, held-out ones where there are."""
    fit: Mapping[str, Any] = document.get("fit") or {}
    for _, before, after in errors_at(fit, headline_index(fit)):
        return before, after
    return None, None
