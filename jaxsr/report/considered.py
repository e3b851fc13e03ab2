"""The sets of mechanisms that were weighed against one another, as rows of a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from jaxsr.report.evidence import Considered, Evidence
from jaxsr.report.exploring import rival_keys
from jaxsr.report.formatting import is_number, number, percent, sureness
from jaxsr.report.words import capital, mechanism_at

_LEAST = 1e-300


def considered_rows(
    evidence: Evidence, findings: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Return a row for each set: its error, how probable it is, why it was taken or lost.

    First what was taken, then by falling probability where that is told, then by the error.
    """
    keys, likely = rival_keys(evidence), _of_sets(findings)
    told = [
        (row, likely.get(frozenset(row.mechanisms)) if row.probability is None else row.probability)
        for row in evidence.considered
    ]
    told.sort(key=lambda pair: (not pair[0].chosen, pair[1] is None, -(pair[1] or 0.0)))
    return [_row(row, keys, probability) for row, probability in told]


def _of_sets(findings: Sequence[Mapping[str, Any]]) -> dict[frozenset[str], float]:
    """Return what findings tell of sets of mechanisms: of sets with one of them exchanged.

    That of the set itself is told where there is one finding.
    """
    own = frozenset(_label(finding) for finding in findings)
    found: dict[frozenset[str], float] = {}
    for finding in findings:
        for row in (finding, *(finding.get("alternatives") or [])):
            if is_number(row.get("probability")) and (row is not finding or len(findings) == 1):
                exchanged = own - {_label(finding)} | {_label(row)}
                found.setdefault(exchanged, float(row["probability"]))
    return found


def _label(row: Mapping[str, Any]) -> str:
    return f"{row.get('mechanism')}@{row.get('site')}"


def _row(
    row: Considered,
    rivals: Mapping[tuple[str, ...], tuple[str, str]],
    probability: float | None,
) -> dict[str, Any]:
    names = [mechanism_at(mechanism) for mechanism in row.mechanisms]
    return {
        "names": [capital(name) for name in names] or ["Nothing added (re-calibrated only)"],
        "error": number(row.error, 3),
        "relative": percent(row.relative, 3),
        # Bars end at the re-calibrated model's error, which is 100 %.
        "bar": round(100 * min(max(row.relative, 0.0), 1.0), 1) if is_number(row.relative) else 0,
        # What the data make improbable beyond the digits of a number is not impossible.
        "probability": sureness(max(probability, _LEAST)) if is_number(probability) else "",
        "chosen": row.chosen,
        "reason": row.reason,
        "models": _models(row, rivals),
    }


def _models(row: Considered, rivals: Mapping[tuple[str, ...], tuple[str, str]]) -> str:
    """Return which models a set's button shows, where a report carries its runs."""
    if row.chosen:
        return "explained"
    if not row.mechanisms:
        return "recalibrated"
    return rivals[row.mechanisms][0] if row.mechanisms in rivals else ""
