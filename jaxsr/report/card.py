"""Results as a card for notebooks: the first screen of the report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jaxsr.report.formatting import estimate, is_number, percent, seconds, unit_text
from jaxsr.report.page import rendered
from jaxsr.report.words import (
    capital,
    errors_at,
    headline_index,
    left_open,
    mechanism_words,
    site_words,
    verdict_sentence,
    verdict_title,
)


def diagnosis_card(document: Mapping[str, Any]) -> str:
    """Return the verdict, the findings and the errors of a diagnosis as HTML."""
    fit = document.get("fit") or {}
    errors = errors_at(fit, headline_index(fit))
    context = {
        "kind": str(document.get("verdict")),
        "title": verdict_title(document.get("verdict")),
        "lines": [verdict_sentence(document), *filter(None, [left_open(document)])],
        "findings": [_finding(row) for row in document.get("findings") or []],
        "errors": [(words, percent(before), percent(after)) for words, before, after in errors],
        "over": seconds(fit.get("headline_s")),
        "equations": [],
    }
    return rendered("card.html.j2", context)


def _finding(row: Mapping[str, Any]) -> dict[str, Any]:
    constants = []
    for name, fields in (row.get("parameters") or {}).items():
        value, interval = estimate(fields.get("value"), fields.get("ci95"))
        constants.append((name, value, interval, unit_text(fields.get("unit"))))
    return {
        "name": capital(mechanism_words(row.get("mechanism"))),
        "site": site_words(row.get("site")),
        "probability": row.get("probability"),
        "term": row.get("term"),
        "constants": constants,
    }


def discovery_card(document: Mapping[str, Any]) -> str:
    """Return the verdict and the equations of a discovery as HTML."""
    verdict, reason = str(document.get("verdict")), str(document.get("reason") or "")
    error = document.get("free_run_nrmse")
    lines = [f"{capital(reason)}." if reason else ""]
    if is_number(error):
        lines.append(f"Free run over data held back: {percent(error)}.")
    titles = {"law": "A law", "several": "Several laws fit", "undecided": "No law is claimed"}
    context = {
        "kind": verdict,
        "title": titles.get(verdict, verdict),
        "lines": [line for line in lines if line],
        "findings": [],
        "errors": [],
        "over": "",
        "equations": [
            (str(row.get("state")), str(row.get("expression")))
            for row in document.get("equations") or []
        ],
    }
    return rendered("card.html.j2", context)
