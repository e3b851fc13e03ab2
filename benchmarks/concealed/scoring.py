"""The scorer: checks the truth's checksum, judges every answer, and counts."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.concealed.judging import Mark, judge
from benchmarks.concealed.rates import Rate, thresholds
from benchmarks.concealed.running import TOOL, answer_of, methods, sealed, wrong_files
from benchmarks.concealed.sealing import sha256
from jaxsr._result import InputError

BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)
LONG = 60.0


def open_truth(folder: Path) -> dict[str, Any]:
    """Return the truth if it is the one that was sealed.

    Raises
    ------
    InputError
        The truth or a case was changed after sealing.
    """
    document = sealed(folder)
    path = folder / "truth" / "truth.json"
    if not path.exists() or sha256(path) != document["truth_sha256"]:
        raise InputError("is not the truth that was sealed", str(path), "Seal the cases again")
    changed = wrong_files(folder, document)
    if changed:
        raise InputError("was changed after sealing", changed[0], "Seal the cases again")
    return json.loads(path.read_text(encoding="utf-8"))["cases"]


def score(folder: Path, truth: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the scores of every method with answers."""
    truth = open_truth(folder) if truth is None else truth
    document: dict[str, Any] = {"sealed": sealed(folder), "plan": _plan(truth), "methods": {}}
    del document["sealed"]["files_sha256"]
    for method in methods(folder):
        marks = [judge(n, case, answer_of(folder, method, n)) for n, case in truth.items()]
        ran = [m for m in marks if m.answered or _tried(folder, method, m.case)]
        document["methods"][method] = summary(ran)
    return document


def _tried(folder: Path, method: str, case: str) -> bool:
    return (folder / "answers" / method / f"{case}.run.json").exists()


def _plan(truth: Mapping[str, Any]) -> dict[str, Any]:
    cases = list(truth.values())
    effects = [e for c in cases for e in c["effects"]]
    return {
        "cases": len(cases),
        "systems": sorted({c["system"] for c in cases}),
        "mechanisms": sorted({e["mechanism"] for e in effects}),
        "kinds": {
            k: sum(c["kind"] == k for c in cases) for k in sorted({c["kind"] for c in cases})
        },
        "multibody": sum(c["multibody"] for c in cases),
        "closed_loop": sum(c["closed_loop"] for c in cases),
        "masked": sum(c["masked"] for c in cases),
        "detectable": sum(bool(c["effects"]) and c["evidence"]["detectable"] for c in cases),
    }


def summary(marks: Sequence[Mark]) -> dict[str, Any]:
    """Count over the marks of one method."""
    seen = [m for m in marks if m.detectable]

    def over(name: str, among: Sequence[Mark] = marks) -> dict[str, Any]:
        values = [getattr(m, name) for m in among]
        return Rate.of([v for v in values if v is not None]).document()

    covered = [c for m in marks for c in m.covered]
    seconds = [m.seconds for m in marks if m.seconds is not None]
    gains = [m.gain for m in seen if m.gain is not None]
    gaps = [m.gap for m in seen if m.gap is not None]
    wrong, total = (sum(getattr(m, n) for m in marks) for n in ("wrong_findings", "findings"))
    families = sorted({m.family for m in seen})
    return {
        "cases": len(marks),
        "answered": Rate.of([m.answered for m in marks]).document(),
        "verdict": over("verdict_right"),
        "verdict_detectable": over("verdict_right", seen),
        "verdict_by_kind": {
            k: over("verdict_right", [m for m in marks if m.kind == k])
            for k in sorted({m.kind for m in marks})
        },
        "false_discoveries": over("false_discovery"),
        "wrong_findings": Rate(wrong, total).document(),
        "site_top1": over("site_1"),
        "site_top3": over("site_3"),
        "mechanism_top1": over("mechanism_1"),
        "mechanism_top3": over("mechanism_3"),
        "mechanism_top1_by_family": {
            f: over("mechanism_1", [m for m in seen if m.family == f]) for f in families
        },
        "effects_named": Rate(sum(m.found for m in seen), sum(m.planted for m in seen)).document(),
        "interval_coverage": Rate.of(covered).document(),
        "probabilities": reliability(marks),
        "held_out_gain_median": float(np.median(gains)) if gains else None,
        "gap_closed_median": float(np.median(gaps)) if gaps else None,
        "gap_closed_cases": len(gaps),
        "detection": {
            f: thresholds(*_sizes([m for m in marks if m.family == f]))
            for f in sorted({m.family for m in marks} - {"none"})
        },
        "risk_coverage": risk_coverage(marks),
        "seconds_median": float(np.median(seconds)) if seconds else None,
        "under_60_s": Rate.of([s < LONG for s in seconds]).document(),
        "failures": [
            {
                "case": m.case,
                "kind": m.kind,
                "truth": m.truth,
                "expected": list(m.expected),
                "answer": m.answer,
                "size": m.size,
                "detectable": m.detectable,
            }
            for m in marks
            if not m.verdict_right or m.mechanism_1 is False
        ],
        "marks": [asdict(m) for m in marks],
    }


def _sizes(marks: Sequence[Mark]) -> tuple[list[float], list[bool]]:
    return [m.size for m in marks], [m.detected for m in marks]


def reliability(marks: Sequence[Mark]) -> list[dict[str, Any]]:
    """Return, by stated probability of the leading finding, how often it is right."""
    pairs = [
        (m.probability, m.leading_right)
        for m in marks
        if m.probability is not None and m.leading_right is not None
    ]
    rows = []
    for low, high in itertools.pairwise(BINS):
        last = high == BINS[-1]
        inside = [(p, r) for p, r in pairs if low <= p < high or (last and p >= high)]
        if inside:
            rows.append(
                {
                    "from": low,
                    "to": high,
                    "stated": float(np.mean([p for p, _ in inside])),
                    "right": Rate.of([r for _, r in inside]).document(),
                }
            )
    return rows


def risk_coverage(marks: Sequence[Mark]) -> list[tuple[float, float]]:
    """Return (share of detectable cases answered, share of wrong among them), surest first.

    A case without a finding, or undecided, is not answered.
    """
    seen = [m for m in marks if m.detectable]
    sure = [m for m in seen if m.probability is not None and m.verdict != "undecided"]
    sure.sort(key=lambda m: -(m.probability or 0.0))
    wrong, rows = 0, []
    for k, m in enumerate(sure, 1):
        wrong += not m.leading_right
        rows.append((k / len(seen), wrong / k))
    return rows


__all__ = ["TOOL", "open_truth", "reliability", "risk_coverage", "score", "summary"]
