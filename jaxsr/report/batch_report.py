"""The page over the diagnoses of a batch."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from jaxsr.report.fleet_constants import FleetConstant
from jaxsr.report.formatting import is_number, percent
from jaxsr.report.page import rendered
from jaxsr.report.words import (
    errors_at,
    headline_index,
    verdict_sentence,
    verdict_title,
    whole_sentence,
)


@dataclass(frozen=True)
class Shown:
    """What the page over a batch shows.

    Attributes
    ----------
    documents : mapping of str to mapping
        What each ``diagnosis.json`` or ``discovery.json`` holds, by case; the report of a case is
        ``CASE/report.html``.
    constants : sequence of FleetConstant
    failures : mapping of str to str
        Why cases failed.
    waiting : sequence of str
        Cases that did not run.
    alarm : float
        Rate of false alarms, of outliers and of drifts, each over the whole page.
    """

    documents: Mapping[str, Mapping[str, Any]]
    constants: Sequence[FleetConstant]
    failures: Mapping[str, str]
    waiting: Sequence[str]
    alarm: float


def batch_page(shown: Shown) -> str:
    """Return a page over many diagnoses: which machines lack what, and how they compare."""
    found = {n: d for n, d in shown.documents.items() if "equations" not in d}
    laws = {n: d for n, d in shown.documents.items() if "equations" in d}
    verdicts = Counter(str(document.get("verdict")) for document in found.values())
    searches = Counter(str(document.get("verdict")) for document in laws.values())
    cases = [_case(name, document) for name, document in found.items()]
    cases.sort(key=lambda row: -row["order"])
    counts = [(len(found), "diagnosis", "diagnoses"), (len(laws), "search", "searches")]
    words = [f"{n} {one if n == 1 else more}" for n, one, more in counts if n]
    context = {
        "title": ", ".join(words) or "Nothing done yet",
        "verdicts": [(verdict_title(v), count) for v, count in verdicts.most_common()],
        "searches": searches.most_common(),
        "cases": cases,
        "laws": [_law(name, document) for name, document in laws.items()],
        "remarks": [remark for constant in shown.constants for remark in constant.remarks()],
        "alarm": f"{100.0 * shown.alarm:g} %",
        "constants": [constant.card() for constant in shown.constants],
        "failures": list(shown.failures.items()),
        "waiting": list(shown.waiting),
    }
    return rendered("batch.html.j2", context)


def _law(name: str, document: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "name": name,
        "verdict": str(document.get("verdict")),
        "equations": [f"d({e['state']})/dt = {e['expression']}" for e in document["equations"]],
        "reason": str(document.get("reason") or ""),
        "error": percent(document.get("free_run_nrmse")),
        "seed": (document.get("provenance") or {}).get("seed"),
    }


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
