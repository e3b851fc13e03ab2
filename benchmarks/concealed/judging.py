"""Judging one answer against the truth of its case."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.concealed.equivalence import equivalent, right_verdicts, same_site

POSITIVE = ("parameter", "structure", "measurement", "external_input")
PHYSICS = ("structure", "external_input")
WORTH = 0.9
"""The gap counts where the oracle's held-out error is below this share of the re-calibrated."""


@dataclass(frozen=True)
class Mark:
    """What is right and wrong in an answer; absent (None) where it does not apply.

    Attributes
    ----------
    false_discovery : bool or None
        On cases without physics left out: structure or external_input claimed, or anything at all
        where there is nothing.
    site_1, site_3, mechanism_1, mechanism_3 : bool or None
        Over detectable cases: the leading answer, or one of the first three.
    found : int
        How many planted effects some finding names.
    covered : tuple of bool
        Whether each 95 % interval of the leading finding holds the truth; only where it is right.
    probability : float or None
        Of the leading finding.
    leading_right : bool or None
    findings, wrong_findings : int
        Wrong values found beside physics are calibration and not counted.
    """

    case: str
    kind: str
    family: str
    detectable: bool
    answered: bool
    verdict: str
    expected: tuple[str, ...]
    verdict_right: bool
    detected: bool
    false_discovery: bool | None
    site_1: bool | None
    site_3: bool | None
    mechanism_1: bool | None
    mechanism_3: bool | None
    planted: int
    found: int
    covered: tuple[bool, ...]
    probability: float | None
    leading_right: bool | None
    findings: int
    wrong_findings: int
    gain: float | None
    gap: float | None
    size: float
    seconds: float | None
    truth: str
    answer: str


def judge(case_id: str, case: Mapping[str, Any], answer: Mapping[str, Any] | None) -> Mark:
    """Judge an answer (a ``diagnosis.json``, or None where there is none)."""
    effects = case["effects"]
    detectable = bool(effects) and case["evidence"]["detectable"]
    expected = right_verdicts(case)
    given = answer or {"verdict": "", "findings": []}
    verdict, findings = given.get("verdict") or "", list(given.get("findings") or [])
    named = [f for f in findings if isinstance(f, Mapping)]
    leaders = list(_leading(named))[:3]
    hits = [_right(m, s, case) for m, s in leaders]
    sites = [_site_right(m, s, case) for m, s in leaders]
    leading_right = (hits[0] if hits else None) if named else None
    largest = max(effects, key=lambda e: e["size"], default=None)
    gain, gap = _gains(case, given) if detectable else (None, None)
    counted = [f for f in named if f.get("mechanism") != "wrong_value" or not _physics(case)]
    wrong = [f for f in counted if not _right(str(f.get("mechanism")), str(f.get("site")), case)]
    return Mark(
        case=case_id,
        kind=case["kind"],
        family=largest["family"] if largest else "none",
        detectable=detectable,
        answered=answer is not None,
        verdict=verdict,
        expected=tuple(sorted(expected)),
        verdict_right=verdict in expected,
        detected=verdict in POSITIVE or verdict == "undecided",
        false_discovery=_false(case, verdict, expected),
        site_1=bool(sites[:1] and sites[0]) if detectable else None,
        site_3=any(sites) if detectable else None,
        mechanism_1=bool(hits[:1] and hits[0]) if detectable else None,
        mechanism_3=any(hits) if detectable else None,
        planted=len(effects) if detectable else 0,
        found=sum(_named(e, named, case) for e in effects) if detectable else 0,
        covered=_coverage(case, named[0]) if named and leading_right and detectable else (),
        probability=_number(named[0].get("probability")) if named else None,
        leading_right=leading_right,
        findings=len(counted),
        wrong_findings=len(wrong),
        gain=gain,
        gap=gap,
        size=largest["size"] if largest else 0.0,
        seconds=_number((given.get("provenance") or {}).get("seconds")),
        truth=" + ".join(f"{e['mechanism']} at {e['site']}" for e in effects) or "nothing",
        answer=_words(verdict, named) if answer else "no answer",
    )


def _number(x: Any) -> float | None:
    return float(x) if isinstance(x, (int, float)) and math.isfinite(x) else None


def _words(verdict: str, findings: list) -> str:
    named = " + ".join(f"{f.get('mechanism')} at {f.get('site')}" for f in findings)
    return f"{verdict}: {named}" if named else verdict


def _physics(case: Mapping[str, Any]) -> bool:
    return any(e["verdict"] in PHYSICS for e in case["effects"])


def _leading(findings: list) -> Iterator[tuple[str, str]]:
    """Yield the leading finding and its alternatives, the most probable first."""
    if not findings:
        return
    first = findings[0]
    yield str(first.get("mechanism")), str(first.get("site"))
    others = [a for a in first.get("alternatives") or [] if isinstance(a, Mapping)]
    for other in sorted(others, key=lambda a: -(_number(a.get("probability")) or 0.0)):
        yield str(other.get("mechanism")), str(other.get("site"))


def _right(mechanism: str, site: str, case: Mapping[str, Any]) -> bool:
    return any(equivalent(mechanism, site, e, case) for e in case["effects"])


def _site_right(mechanism: str, site: str, case: Mapping[str, Any]) -> bool:
    return any(same_site(site, e) for e in case["effects"]) or _right(mechanism, site, case)


def _named(effect: Mapping[str, Any], findings: list, case: Mapping[str, Any]) -> bool:
    return any(
        equivalent(str(f.get("mechanism")), str(f.get("site")), effect, case) for f in findings
    )


def _false(case: Mapping[str, Any], verdict: str, expected: frozenset[str]) -> bool | None:
    """Whether physics is claimed where none is left out; None where some is."""
    kinds = {e["verdict"] for e in case["effects"]}
    if kinds & set(PHYSICS):
        return None
    if verdict in expected:
        return False
    return verdict in (PHYSICS if case["effects"] else POSITIVE)


def _coverage(case: Mapping[str, Any], finding: Mapping[str, Any]) -> tuple[bool, ...]:
    """Compare the intervals of a finding of the planted mechanism; signs are convention."""
    effect = next(
        (
            e
            for e in case["effects"]
            if e["mechanism"] == finding.get("mechanism") and same_site(str(finding["site"]), e)
        ),
        None,
    )
    if effect is None:
        return ()
    marks = []
    for name, value in effect["values"].items():
        if name in effect["unchecked"]:
            continue
        for key, row in (finding.get("parameters") or {}).items():
            if key != name and not key.startswith(f"{name}_"):
                continue
            interval = row.get("ci95") if isinstance(row, Mapping) else None
            if interval and all(_number(b) is not None for b in interval):
                low, high = sorted(interval)
                marks.append(low <= value <= high or low <= -value <= high)
    return tuple(marks)


def _gains(case: Mapping[str, Any], answer: Mapping[str, Any]) -> tuple[float | None, float | None]:
    """Held-out gain 1 - explained/recalibrated and the gap closed, at the answer's headline.

    gap closed = (recalibrated - explained)/(recalibrated - oracle), at most 1; an answer
    without a changed model closes nothing. A push does not act on what is held out.
    """
    if all(e["verdict"] == "external_input" for e in case["effects"]):
        return None, None
    evidence, fit = case["evidence"], answer.get("fit") or {}
    held, horizons, headline = fit.get("held_out"), fit.get("horizons_s"), fit.get("headline_s")
    if not held or not horizons or headline is None:
        before, best = evidence["recalibrated"][-1], evidence["oracle"][-1]
        return (0.0, 0.0) if best < WORTH * before else (0.0, None)
    k = int(np.argmin(np.abs(np.asarray(horizons) - headline)))
    before, after = _number(held["recalibrated"][k]), _number(held["explained"][k])
    if not before or after is None:
        return None, None
    lengths = np.log(evidence["horizons"])
    best = float(np.exp(np.interp(np.log(headline), lengths, np.log(evidence["oracle"]))))
    gain = 1.0 - after / before
    if best >= WORTH * before:
        return gain, None
    return gain, min((before - after) / (before - best), 1.0)
