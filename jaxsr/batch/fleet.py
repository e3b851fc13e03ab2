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
from jaxsr.batch.constants import ALARM, constants_of
from jaxsr.batch.listing import AnyCase
from jaxsr.batch.task import Outcome
from jaxsr.discovery.saved import SavedDiscovery
from jaxsr.report.batch_report import Shown, batch_page
from jaxsr.report.summary import columns
from jaxsr.report.words import errors_at, headline_index

COLUMNS = (
    *("case", "status", "verdict", "mechanism", "site", "probability", "share", "parameter"),
    *("value", "low", "high", "unit", "error_recalibrated", "error_explained", "message"),
    "expression",
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
    discoveries : mapping of str to SavedDiscovery
        The same of searches for equations.
    parts : mapping of str to Outcome
        Single seeds of searches that failed.
    cases : mapping of str to Case or Islands
        As they were given.
    """

    directory: Path
    names: tuple[str, ...]
    outcomes: Mapping[str, Outcome] = field(repr=False)
    diagnoses: Mapping[str, SavedDiagnosis] = field(repr=False)
    discoveries: Mapping[str, SavedDiscovery] = field(
        repr=False, default_factory=dict[str, SavedDiscovery]
    )
    parts: Mapping[str, Outcome] = field(repr=False, default_factory=dict[str, Outcome])
    cases: Mapping[str, AnyCase] = field(repr=False, default_factory=dict[str, AnyCase])

    def with_outcome(self, outcome: Outcome) -> Fleet:
        """Return the batch with one more case that ended, its results read."""
        name, outcomes = outcome.name, {**self.outcomes, outcome.name: outcome}
        if not outcome.done:
            return replace(self, outcomes=outcomes)
        saved = load(self.directory / name)
        if isinstance(saved, SavedDiagnosis):
            return replace(self, outcomes=outcomes, diagnoses={**self.diagnoses, name: saved})
        return replace(self, outcomes=outcomes, discoveries={**self.discoveries, name: saved})

    def with_part(self, outcome: Outcome) -> Fleet:
        """Return the batch with one more seed of a search that ended."""
        parts = {name: part for name, part in self.parts.items() if name != outcome.name}
        return replace(self, parts=parts if outcome.done else {**parts, outcome.name: outcome})

    @property
    def failures(self) -> dict[str, str]:
        """Why cases failed, by name; and single seeds of searches, where others did not."""
        failed = [outcome for outcome in self._ended if not outcome.done]
        single = [o for name, o in self.parts.items() if name.rpartition("/")[0] in self]
        return {outcome.name: outcome.message for outcome in [*failed, *single]}

    @property
    def _ended(self) -> list[Outcome]:
        return [self.outcomes[name] for name in self.names if name in self.outcomes]

    @property
    def waiting(self) -> tuple[str, ...]:
        """Names of the cases that did not run."""
        return tuple(name for name in self.names if name not in self.outcomes)

    def __getitem__(self, name: str) -> SavedDiagnosis | SavedDiscovery:
        """Return the diagnosis, or the discovery, of a case.

        Raises
        ------
        InputError
            There is none.
        """
        if name not in self:
            why = self.failures.get(name, "it is no case, or did not run")
            raise InputError(f"no diagnosis of {name!r:.80}: {why}", str(self.directory))
        return self._found[name]

    @property
    def _found(self) -> dict[str, SavedDiagnosis | SavedDiscovery]:
        return {**self.diagnoses, **self.discoveries}

    def __contains__(self, name: str) -> bool:
        return name in self.diagnoses or name in self.discoveries

    def __iter__(self) -> Iterator[str]:
        return (name for name in self.names if name in self)

    def __len__(self) -> int:
        return len(self.diagnoses) + len(self.discoveries)

    @property
    def table(self) -> pd.DataFrame:
        """Return a row for every constant of every finding, and one for a case without any.

        Of a search, a row for every equation.
        """
        rows = [row for name in self.names for row in self._rows(name)]
        return pd.DataFrame(rows, columns=list(COLUMNS))

    def _rows(self, name: str) -> list[dict[str, Any]]:
        if name in self.discoveries:
            return _equation_rows(name, self.discoveries[name])
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
        shown = Shown(
            {name: self._found[name].document for name in self},
            constants_of(self.diagnoses, self.cases),
            self.failures,
            self.waiting,
            ALARM,
        )
        atomic_write_text(self.directory / "batch.html", batch_page(shown))

    def __str__(self) -> str:
        """Return a line for every case."""
        rows = [("case", "verdict", "says")]
        for name in self.names:
            if name in self.diagnoses:
                found = self.diagnoses[name]
                rows.append((name, found.verdict, found.sentence))
            elif name in self.discoveries:
                law = self.discoveries[name]
                rows.append((name, law.verdict, "; ".join(str(law).splitlines())))
            else:
                rows.append((name, "-", self.failures.get(name, "did not run")))
        return "\n".join(columns(rows))


def _equation_rows(name: str, found: SavedDiscovery) -> list[dict[str, Any]]:
    head = {"case": name, "status": "done", "verdict": found.verdict}
    return [
        {
            **{**head, "site": f"equation:{row['state']}", "expression": row["expression"]},
            "error_explained": row.get("free_run_nrmse"),
        }
        for row in found.equations
    ]


def headline_errors(document: Mapping[str, Any]) -> tuple[float | None, float | None]:
    """Return the free-run errors, re-calibrated and explained, held-out ones where there are."""
    fit: Mapping[str, Any] = document.get("fit") or {}
    for _, before, after in errors_at(fit, headline_index(fit)):
        return before, after
    return None, None
