"""The page over the diagnoses of a batch."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from jaxsr.report.formatting import estimate, is_number, number, percent, sureness, unit_text
from jaxsr.report.page import rendered
from jaxsr.report.words import (
    capital,
    errors_at,
    headline_index,
    mechanism_words,
    site_words,
    verdict_sentence,
    verdict_title,
    whole_sentence,
)


def batch_page(
    documents: Mapping[str, Mapping[str, Any]],
    failures: Mapping[str, str],
    waiting: Sequence[str],
) -> str:
    """Return a page over many diagnoses: which machines lack what, and how they compare.

    Parameters
    ----------
    documents : mapping of str to mapping
        What each ``diagnosis.json`` holds, by case; the report of a case is ``CASE/report.html``.
    failures : mapping of str to str
        Why cases failed.
    waiting : sequence of str
        Cases that did not run.
    """
    verdicts = Counter(str(document.get("verdict")) for document in documents.values())
    cases = [_case(name, document) for name, document in documents.items()]
    cases.sort(key=lambda row: -row["order"])
    context = {
        "title": f"{len(documents)} diagnoses",
        "verdicts": [(verdict_title(v), count) for v, count in verdicts.most_common()],
        "cases": cases,
        "constants": _constants(documents),
        "failures": list(failures.items()),
        "waiting": list(waiting),
    }
    return rendered("batch.html.j2", context)


def _case(name: str, document: Mapping[str, Any]) -> dict[str, Any]:
    fit = document.get("fit") or {}
    errors = errors_at(fit, headline_index(fit))
    role, before, after = errors[0] if errors else ("", None, None)
    return {
        "name": name,
        "verdict": str(document.get("verdict")),
        "sentence": whole_sentence(document),
        "short": verdict_sentence(document),
        "role": role,
        "before": percent(before),
        "after": percent(after),
        "order": after if is_number(after) else 0.0,
    }


def _constants(documents: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return every constant that was found, its values over the machines, the greatest first."""
    groups: dict[tuple[str, str, str, str], list[dict[str, Any]]] = {}
    for case, document in documents.items():
        for finding in document.get("findings") or []:
            for name, row in (finding.get("parameters") or {}).items():
                unit = str(row.get("unit") or "")
                key = (str(finding.get("mechanism")), str(finding.get("site")), name, unit)
                entry = {"case": case, "row": row, "probability": finding.get("probability")}
                groups.setdefault(key, []).append(entry)
    return [_constant(key, entries) for key, entries in groups.items()]


def _constant(
    key: tuple[str, str, str, str], entries: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    mechanism, site, name, unit = key
    known = [entry for entry in entries if is_number(entry["row"].get("value"))]
    known.sort(key=lambda entry: -entry["row"]["value"])
    ends = [_interval(entry["row"]) for entry in known]
    low, high = min((e[0] for e in ends), default=0.0), max((e[1] for e in ends), default=1.0)
    span = high - low or 1.0
    rows = []
    for entry, (start, end) in zip(known, ends, strict=True):
        value, interval = estimate(entry["row"]["value"], entry["row"].get("ci95"))
        rows.append(
            {
                **{"case": entry["case"], "value": value, "interval": interval},
                "probability": sureness(entry["probability"]),
                "left": round(100.0 * (start - low) / span, 2),
                "width": round(max(100.0 * (end - start) / span, 0.8), 2),
            }
        )
    middle = statistics.median(entry["row"]["value"] for entry in known) if known else None
    return {
        "title": f"{capital(mechanism_words(mechanism))}, {site_words(site)}: {name}",
        "unit": unit_text(unit),
        "median": number(middle),
        "rows": rows,
    }


def _interval(row: Mapping[str, Any]) -> tuple[float, float]:
    ends = row.get("ci95") or ()
    if len(ends) == 2 and all(is_number(end) for end in ends):
        return float(ends[0]), float(ends[1])
    return float(row["value"]), float(row["value"])
