"""What docs/files.md promises of ``diagnosis.json``, as a list of what is wrong."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

VERDICTS = frozenset("nothing parameter structure measurement external_input undecided".split())
FAMILIES: Mapping[str, tuple[str, ...]] = {
    "parameter": ("wrong_value",),
    "dissipative": (
        *("viscous_damping", "coulomb_friction", "asymmetric_friction", "stribeck_friction"),
        *("position_dependent_friction", "quadratic_drag", "power_law_drag"),
        *("load_dependent_friction", "coupled_friction"),
    ),
    "elastic": (
        *("linear_stiffness", "quadratic_stiffness", "cubic_stiffness", "piecewise_stiffness"),
        *("end_stop", "backlash"),
    ),
    "inertial": ("added_mass", "gravity", "constant_force", "centrifugal_coupling"),
    "coupling": ("coupling_stiffness", "coupling_damping"),
    "periodic": ("harmonic_force", "position_ripple", "parametric_excitation"),
    "memory": ("hysteresis", "actuator_lag", "hidden_mode", "drift", "overflow"),
    "actuator": (
        *("input_saturation", "input_deadzone", "input_curve", "input_gain_by_state"),
        *("input_gain", "input_delay"),
    ),
    "measurement": (
        *("sensor_gain", "sensor_bias", "sensor_delay", "clipping", "rectified", "quantisation"),
        "clock_skew",
    ),
    "external": ("transient_force",),
    "unnamed": ("unnamed",),
}
MECHANISMS = frozenset(name for names in FAMILIES.values() for name in names)
STOPPED = frozenset(("converged", "budget", "interrupted", "target"))
SITE = re.compile(r"(equation|input|output|parameter|external):(\w+)")
EDITED = re.compile(
    r"(equations|readings|parameters|initial|delays|clock|inertia|additions|definitions"
    r"|per_recording|noise|resolution|units)\.\w+(\.\w+)?|model\.(states|outputs)"
)
KEYS = (
    *("schema", "verdict", "findings", "calibration", "fit", "confusable", "smallest_detectable"),
    *("next_experiment", "data_checks", "provenance"),
)
FINDING = (
    *("site", "mechanism", "family", "probability", "alternatives", "edit", "term", "parameters"),
    *("where", "share", "explanation"),
)
SLACK = 1e-9


def strict_json(text: str) -> Any:
    """Parse JSON as the standard has it: NaN and Infinity are errors."""

    def refuse(word: str) -> Any:
        raise ValueError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


def problems(document: Any, names: Mapping[str, tuple[str, ...]]) -> list[str]:
    """List what a diagnosis breaks of docs/files.md.

    Parameters
    ----------
    document : parsed JSON
    names : dict of str to tuple of str
        ``states``, ``inputs``, ``outputs``, ``parameters`` of the given model and ``files``, the
        recordings.
    """
    if not isinstance(document, dict):
        return ["the document is no object"]
    found = [f"no key {key!r}" for key in KEYS if key not in document]
    if found:
        return found
    return [
        *_not_finite(document, ""),
        *_head(document),
        *(line for f in document["findings"] for line in _finding(f, names)),
        *_findings(document["findings"]),
        *_calibration(document["calibration"]),
        *_fit(document["fit"]),
        *_rest(document, names["files"]),
    ]


def _not_finite(value: Any, path: str) -> Iterator[str]:
    if isinstance(value, float) and not math.isfinite(value):
        yield f"{path} is {value}"
    items = value.items() if isinstance(value, dict) else ()
    rows = enumerate(value) if isinstance(value, list) else items
    for key, inner in rows:
        yield from _not_finite(inner, f"{path}.{key}")


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _head(document: dict[str, Any]) -> Iterator[str]:
    if document["schema"] != "jaxsr.diagnosis/1":
        yield f"schema is {document['schema']!r}"
    verdict = document["verdict"]
    if verdict not in VERDICTS:
        yield f"verdict is {verdict!r}"
    if verdict == "nothing" and document["findings"]:
        yield "verdict nothing has findings"
    if verdict not in ("nothing", "undecided") and not document["findings"]:
        yield f"verdict {verdict} has no findings"
    if verdict not in ("nothing", "undecided") and document["findings"]:
        first = document["findings"][0]
        told = verdict_of(str(first.get("mechanism")), str(first.get("family")))
        if told != verdict:
            yield f"verdict {verdict} where the largest share is {first.get('mechanism')}"


def verdict_of(mechanism: str, family: str) -> str:
    """Return the verdict of a finding."""
    special = {"input_gain": "parameter", "input_delay": "measurement"}
    families = {"parameter": "parameter", "measurement": "measurement"}
    families["external"] = "external_input"
    return special.get(mechanism, families.get(family, "structure"))


def _site(site: Any, names: Mapping[str, tuple[str, ...]]) -> Iterator[str]:
    match = SITE.fullmatch(str(site))
    if match is None:
        yield f"site is {site!r}"
        return
    kind, name = match.groups()
    known = {
        **{"equation": "states", "external": "states", "input": "inputs"},
        **{"output": "outputs", "parameter": "parameters"},
    }[kind]
    if name not in names[known]:
        yield f"site {site!r} names none of the given {known}"


def _finding(finding: Any, names: Mapping[str, tuple[str, ...]]) -> Iterator[str]:
    missing = [key for key in FINDING if key not in finding]
    if missing:
        yield f"a finding has no {', '.join(missing)}"
        return
    label = f"finding {finding['mechanism']}@{finding['site']}"
    yield from _site(finding["site"], names)
    if finding["mechanism"] not in MECHANISMS:
        yield f"mechanism is {finding['mechanism']!r}"
    elif finding["mechanism"] not in FAMILIES.get(finding["family"], ()):
        yield f"{label}: family is {finding['family']!r}"
    for key in ("probability", "share"):
        value = finding[key]
        if not (_number(value) and -SLACK <= value <= 1 + SLACK):
            yield f"{label}: {key} is {value!r}"
    yield from _alternatives(finding, label, names)
    wrong = [key for key in finding["edit"] if EDITED.fullmatch(key) is None]
    if wrong:
        yield f"{label}: edit has {wrong[0]!r}"
    if not finding["edit"] and finding["mechanism"] != "transient_force":
        yield f"{label}: no edit"
    if not str(finding["explanation"]).strip():
        yield f"{label}: no explanation"
    for name, row in finding["parameters"].items():
        yield from _interval(f"{label}: {name}", row)
    yield from _where(finding["where"], label, names["files"])


def _alternatives(
    finding: dict[str, Any], label: str, names: Mapping[str, tuple[str, ...]]
) -> Iterator[str]:
    total = finding["probability"]
    for row in finding["alternatives"]:
        absent = [k for k in ("mechanism", "site", "probability", "parameters") if k not in row]
        if absent:
            yield f"{label}: an alternative has no {', '.join(absent)}"
            return
        total += row["probability"]
        yield from _site(row["site"], names)
        if row["mechanism"] not in MECHANISMS:
            yield f"{label}: alternative {row['mechanism']!r}"
    if total > 1 + 1e-6:
        yield f"{label}: probabilities sum to {total:.6f}"


def _interval(label: str, row: Any) -> Iterator[str]:
    if not (isinstance(row, dict) and "value" in row and "ci95" in row):
        yield f"{label} has no value and ci95"
        return
    value, interval = row["value"], row["ci95"]
    if value is not None and not _number(value):
        yield f"{label} is {value!r}"
    if interval is None:
        return
    if not (isinstance(interval, list) and len(interval) == 2):
        yield f"{label}: ci95 is {interval!r}"
    elif None not in interval and value is not None:
        low, high = interval
        size = SLACK * max(abs(low), abs(high), abs(value))
        if not low - size <= value <= high + size:
            yield f"{label}: {value} lies outside its interval [{low}, {high}]"


def _where(where: Any, label: str, files: tuple[str, ...]) -> Iterator[str]:
    for row in where.get("region") or []:
        if not {"variable", "from", "to"} <= set(row) or not row["from"] <= row["to"]:
            yield f"{label}: region {row}"
    unknown = [name for name in where.get("recordings") or [] if name not in files]
    if unknown:
        yield f"{label}: recording {unknown[0]!r} is none of DATA"
    for pair in where.get("times") or []:
        if not (len(pair) == 2 and pair[0] <= pair[1]):
            yield f"{label}: times {pair}"


def _findings(findings: list[dict[str, Any]]) -> Iterator[str]:
    shares = [f.get("share") for f in findings]
    numbers = [s for s in shares if _number(s)]
    if numbers != sorted(numbers, reverse=True):
        yield f"shares are not sorted: {numbers}"
    places = [(f.get("site"), f.get("mechanism"), f.get("term")) for f in findings]
    if len(set(places)) != len(places):
        yield "one finding twice"


def _calibration(calibration: dict[str, Any]) -> Iterator[str]:
    for name, row in calibration.items():
        yield from _interval(f"calibration of {name}", row)


def _fit(fit: dict[str, Any]) -> Iterator[str]:
    horizons = fit.get("horizons_s") or []
    if len(horizons) < 3 or horizons != sorted(horizons):
        yield f"horizons are {horizons}"
    if fit.get("headline_s") not in horizons:
        yield f"the headline {fit.get('headline_s')} is none of the horizons"
    for role in ("train", "held_out"):
        rows = fit.get(role)
        if rows is None:
            if role == "train":
                yield "no fit on the training recordings"
            continue
        for key in ("given", "recalibrated", "explained"):
            values = rows.get(key)
            if not isinstance(values, list) or len(values) != len(horizons):
                yield f"fit.{role}.{key} is {values!r}"
            elif any(v is not None and not (_number(v) and v >= 0) for v in values):
                yield f"fit.{role}.{key} has {values!r}"


def _rest(document: dict[str, Any], files: tuple[str, ...]) -> Iterator[str]:
    for row in document["confusable"]:
        if not (len(row) == 3 and _number(row[2]) and 0 <= row[2] <= 90 + SLACK):
            yield f"confusable has {row!r}"
    for name, row in document["smallest_detectable"].items():
        if "@" not in name or not {"parameter", "value", "unit"} <= set(row):
            yield f"smallest_detectable has {name!r}: {row!r}"
    if document["next_experiment"] is not None and not isinstance(document["next_experiment"], str):
        yield f"next_experiment is {document['next_experiment']!r}"
    for row in document["data_checks"]:
        if not {"file", "channel", "check", "message"} <= set(row):
            yield f"data_checks has {row!r}"
    provenance = document["provenance"]
    for key in ("version", "seed", "command", "seconds", "stopped_by", "data_sha256"):
        if key not in provenance:
            yield f"no provenance.{key}"
    if provenance.get("stopped_by") not in STOPPED:
        yield f"stopped_by is {provenance.get('stopped_by')!r}"
    if not set(files) <= set(provenance.get("data_sha256") or {}):
        yield "data_sha256 lacks a file of DATA"
