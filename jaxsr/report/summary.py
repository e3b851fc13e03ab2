"""Results as a short table of plain text, for terminals and for ``print``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from jaxsr.report.formatting import DASH, estimate, in_ascii, odds, percent, seconds, sureness
from jaxsr.report.words import errors_at, headline_index, whole_sentence


def diagnosis_table(document: Mapping[str, Any]) -> str:
    """Return verdict, findings and errors of a diagnosis, a line each."""
    lines = [f"{document.get('verdict')}: {whole_sentence(document)}"]
    findings: Sequence[Mapping[str, Any]] = document.get("findings") or []
    if findings:
        rows = [("finding", "site", "probability", "share", "constants")]
        rows += [_finding(row) for row in findings]
        lines += ["", *columns(rows)]
    fit = document.get("fit") or {}
    at = headline_index(fit)
    errors = errors_at(fit, at)
    if errors:
        lines.append("")
    for words, before, after in errors:
        over = in_ascii(seconds(fit["headline_s"]))
        shown = f"{in_ascii(percent(before))} re-calibrated, {in_ascii(percent(after))} explained"
        lines.append(f"error over {over}, {words}: {shown}")
    return "\n".join(lines)


def _finding(row: Mapping[str, Any]) -> tuple[str, ...]:
    shares = sureness(row.get("probability")), odds(row.get("share"))
    constants = [constant(name, fields) for name, fields in (row.get("parameters") or {}).items()]
    words = (in_ascii(share) for share in shares)
    return (str(row.get("mechanism")), str(row.get("site")), *words, ", ".join(constants))


def constant(name: str, row: Mapping[str, Any]) -> str:
    """Return a constant with interval and unit in ASCII: ``Fc = 20.4 N [20.1, 20.7]``."""
    value, interval = estimate(row.get("value"), row.get("ci95"))
    unit = str(row.get("unit") or "")
    shown = f"{name} = {in_ascii(value)}{f' {unit}' if unit not in ('', '1') else ''}"
    return shown if interval == DASH else f"{shown} [{in_ascii(interval).replace(' to ', ', ')}]"


def columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows of cells as lines of aligned columns."""
    widths = [max(len(cell) for cell in cells) for cells in zip(*rows, strict=True)]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
