"""The report of a diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from jaxsr.report.considered import considered_rows
from jaxsr.report.copies import edit_text, python_text
from jaxsr.report.diff import diff_tables, given_parameters
from jaxsr.report.evidence import Evidence
from jaxsr.report.exploring import packed, script, script_hash
from jaxsr.report.fit_sentences import horizon_sentence, noise_sentence
from jaxsr.report.fit_tables import Role, figures_at_a_glance, fit_groups, force_rows
from jaxsr.report.formatting import (
    estimate,
    is_number,
    listing,
    number,
    odds,
    seconds,
    unit_text,
)
from jaxsr.report.mismatch import mismatches
from jaxsr.report.page import write_page
from jaxsr.report.trajectories import free_runs
from jaxsr.report.whiteness import left_over
from jaxsr.report.words import (
    capital,
    figures_of,
    left_open,
    mechanism_at,
    mechanism_words,
    region_words,
    site_words,
    verdict_sentence,
    verdict_title,
)

_REJECTED = 0.005  # probability that is printed as less than 1 %
_FIRST_CONSIDERED, _FIRST_DETECTABLE = 8, 12  # rows that stand open; the rest unfolds


def write_diagnosis_report(
    document: Mapping[str, Any],
    evidence: Evidence,
    directory: Path,
    stop: Callable[[], bool] = lambda: False,
) -> None:
    """Write ``report.html``, one file with its figures inside, and the figures as PNG.

    Parameters
    ----------
    document : mapping
        What ``diagnosis.json`` holds.
    evidence : Evidence
        What is drawn and listed beside it.
    directory : Path
        Where to write; made when absent.
    stop : callable
        Whether to leave out the figures that are not drawn yet.

    Raises
    ------
    InputError
        If `directory` cannot be written.
    ValueError
        If the verdict is unknown.
    """
    fit = document.get("fit") or {}
    findings = document.get("findings") or []
    runs = free_runs(evidence.trajectories, fit.get("headline_s"), stop)
    sites = mismatches(evidence.residuals, findings, stop)
    units = _units(evidence)
    about = {
        role: Role(evidence.lengths.get(role, ()), evidence.noise.get(role))
        for role in ("train", "held_out")
    }
    drawn = left_over(evidence, stop)
    considered = considered_rows(evidence, findings)
    detectable = _detectable(document)
    context = {
        "title": f"Diagnosis of {evidence.model_name}",
        "model_name": evidence.model_name,
        "verdict": str(document.get("verdict")),
        "verdict_title": verdict_title(document.get("verdict")),
        "verdict_sentence": verdict_sentence(document),
        "found": [
            (capital(mechanism_words(f.get("mechanism"))), figures_of(f)) for f in findings[:4]
        ],
        "glance": figures_at_a_glance(fit, about, findings[0].get("site") if findings else None),
        "noise_sentence": noise_sentence(fit, about),
        "horizon_sentence": horizon_sentence(fit),
        "left_open": left_open(document),
        "cards": [_card(finding, units) for finding in findings],
        "explorable": bool(evidence.trajectories or evidence.residuals),
        "left_over": drawn,
        "python": python_text(document),
        "evidence": Markup(packed(evidence)),
        "script": Markup(script()),
        "script_hash": script_hash(),
        "diff": diff_tables(evidence.diff),
        "fit": fit,
        "fit_groups": fit_groups(fit, about),
        "force_rows": force_rows(fit),
        "free_runs": runs,
        "undrawn": len(evidence.trajectories) - len(runs),
        "mismatches": sites,
        "considered": considered[:_FIRST_CONSIDERED],
        "considered_rest": considered[_FIRST_CONSIDERED:],
        "told_probable": any(row["probability"] for row in considered),
        "calibration": _calibration(document, evidence),
        "confusable": [_confusable(row) for row in document.get("confusable") or []],
        "detectable": detectable[:_FIRST_DETECTABLE],
        "detectable_rest": detectable[_FIRST_DETECTABLE:],
        "next_experiment": document.get("next_experiment"),
        "ladder": evidence.ladder,
        "data_checks": document.get("data_checks") or [],
        "provenance": document.get("provenance") or {},
    }
    write_page(Path(directory), "diagnosis.html.j2", context, [*runs, *sites, *drawn])


def _card(finding: Mapping[str, Any], units: Mapping[str, str]) -> dict[str, Any]:
    """Return what a finding's card shows, in words and printed numbers."""
    where = finding.get("where") or {}
    regions = where.get("region") or []
    alternatives = finding.get("alternatives") or []
    return {
        "name": capital(mechanism_words(finding.get("mechanism"))),
        "mechanism": finding.get("mechanism"),
        "family": finding.get("family"),
        "site": site_words(finding.get("site")),
        "explanation": finding.get("explanation"),
        "term": finding.get("term"),
        "edit": edit_text(finding.get("edit") or {}),
        "parameters": [
            parameter_row(name, entry) for name, entry in _items(finding.get("parameters"))
        ],
        "probability": finding.get("probability"),
        "share": finding.get("share"),
        "part": part_words(finding.get("part")),
        "alternatives": [
            {
                "name": mechanism_words(other.get("mechanism")),
                "site": site_words(other.get("site")),
                "probability": other.get("probability"),
            }
            for other in alternatives
            if not is_number(other.get("probability")) or other["probability"] >= _REJECTED
        ],
        "rejected": bool(alternatives),
        "regions": region_words(regions, units),
        "recordings": listing(where.get("recordings") or []),
        "times": listing(
            [
                f"{number(t[0], 3)} to {seconds(t[1])}"
                for t in where.get("times") or []
                if len(t) > 1
            ]
        ),
    }


def part_words(part: Mapping[str, Any] | None) -> str:
    """Say what part of an explanation a finding is, of what it is a part, and how it was told."""
    if not part or not is_number(part.get("value")):
        return ""
    whole = "what re-calibration could not explain and the findings do (squared error)"
    if part["value"] == 1.0:
        return f"all of {whole}"
    told = (
        "a finding's part is what it adds, on average over the orders in which all can be added"
        if part.get("by") == "all orders"
        else "parts are what comes back without each finding, scaled"
    )
    return f"{odds(part['value'])} of {whole}; {told}, and the parts of all add up to 100 %"


def parameter_row(name: str, entry: Any) -> dict[str, str]:
    """Return a parameter's name, value, interval and unit, printed."""
    fields: Mapping[str, Any] = entry if isinstance(entry, Mapping) else {"value": entry}
    value, interval = estimate(fields.get("value"), fields.get("ci95"))
    return {
        "name": name,
        "value": value,
        "interval": interval,
        "unit": unit_text(fields.get("unit")),
    }


def _units(evidence: Evidence) -> dict[str, str]:
    """Return the units that the evidence knows, by state and output."""
    known = {name: unit_text(unit) for name, unit in evidence.units.items()}
    known |= {t.output: unit_text(t.unit) for t in evidence.trajectories}
    return known | {r.state_name: unit_text(r.state_unit) for r in evidence.residuals}


def _items(table: object) -> list[tuple[str, Any]]:
    return list(table.items()) if isinstance(table, Mapping) else []


def _calibration(document: Mapping[str, Any], evidence: Evidence) -> list[dict[str, str]]:
    given = given_parameters(evidence.diff)
    rows = []
    for name, entry in _items(document.get("calibration")):
        before = given.get(name, {})
        row = parameter_row(name, entry) | {"given": number(before.get("value"))}
        row["unit"] = row["unit"] or unit_text(before.get("unit"))
        rows.append(row)
    return rows


def _confusable(row: list[Any]) -> dict[str, str]:
    first, second, angle = (*row, None)[:3]
    return {
        "pair": f"{capital(mechanism_at(str(first)))} and {mechanism_at(str(second))}",
        "angle": f"{number(angle, 2)}°" if is_number(angle) else "",
    }


def _detectable(document: Mapping[str, Any]) -> list[dict[str, str]]:
    rows = []
    for effect, entry in _items(document.get("smallest_detectable")):
        fields = entry if isinstance(entry, Mapping) else {"value": entry}
        unit = unit_text(fields.get("unit"))
        size = f"{number(fields.get('value'), 2)}{' ' + unit if unit else ''}"
        name = str(fields.get("parameter") or "")
        text = f"{name} = {size}"
        if fields.get("limit"):
            text = f"{name} below {size}"
        elif is_number(fields.get("beside")):
            text = f"{name} {size} off {number(fields['beside'])}"
        rows.append({"effect": capital(mechanism_at(effect)), "text": text})
    return rows
