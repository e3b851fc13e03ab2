"""Scores of engines, inside and outside of the groups that the tool was settled on."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.concealed.judging import Mark, judge
from benchmarks.concealed.rates import Rate

SETTLED_ON = Path(__file__).with_name("settled_on.json")
KINDS = ("system", "sensing", "mechanism")
SURE = 0.95
BINS = np.linspace(0.0, 1.0, 11)
DRAWN = 400
"""Sets of answers drawn to tell what the calibration error is by chance."""


@dataclass(frozen=True)
class Scored:
    """A judged answer with the groups of its case."""

    mark: Mark
    engine: str
    groups: Mapping[str, str]
    inside: Mapping[str, bool]
    seconds: float
    cpu_seconds: float
    broke: str

    @property
    def in_group(self) -> bool:
        """Whether system, sensing and mechanism all were settled on."""
        return all(self.inside.values())


def settled_on(path: Path = SETTLED_ON) -> dict[str, list[str]]:
    """Return the groups that the tool was settled on; ``group/system`` names one system."""
    document = json.loads(path.read_text(encoding="utf-8"))
    return {kind: list(document[kind]) for kind in KINDS}


def scored(
    truths: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], settled: Mapping[str, list[str]]
) -> list[Scored]:
    """Judge answers against the truth of their cases."""
    found = []
    for row in rows:
        truth = truths[row["case"]]
        groups = dict(truth["groups"])
        inside = {kind: groups[kind] in settled[kind] for kind in KINDS}
        inside["system"] |= f"{groups['system']}/{truth['system']}" in settled["system"]
        found.append(
            Scored(
                judge(row["case"], truth, row["answer"]),
                row["engine"],
                groups,
                inside,
                row["seconds"],
                row["cpu_seconds"],
                row["broke"],
            )
        )
    return found


def rates(items: Sequence[Scored]) -> dict[str, Any]:
    """Count over judged answers; rates are (right, of)."""
    marks = [i.mark for i in items]

    def over(name: str) -> Rate:
        values = [getattr(m, name) for m in marks]
        return Rate.of([v for v in values if v is not None])

    stated = [
        (m.probability, m.leading_right)
        for m in marks
        if m.probability is not None and m.leading_right is not None
    ]
    gaps = [m.gap for m in marks if m.gap is not None]
    return {
        "cases": len(marks),
        "crashes": Rate.of([bool(i.broke) for i in items]),
        "verdict": over("verdict_right"),
        "false_discovery": over("false_discovery"),
        "site": over("site_1"),
        "mechanism_first": over("mechanism_1"),
        "mechanism_among_three": over("mechanism_3"),
        "interval_coverage": Rate.of([c for m in marks for c in m.covered]),
        "right_where_sure": Rate.of([bool(r) for p, r in stated if p > SURE]),
        "calibration_error": calibration_error(stated),
        "calibration_error_by_chance": by_chance([p for p, _ in stated]),
        "gap_closed_median": float(np.median(gaps)) if gaps else None,
        "gaps": len(gaps),
        "seconds_median": float(np.median([i.seconds for i in items])) if items else None,
        "cpu_seconds_median": float(np.median([i.cpu_seconds for i in items])) if items else None,
    }


def calibration_error(stated: Sequence[tuple[float, bool]]) -> float | None:
    """Return the expected calibration error in ten bins: sum of n_b/n |right_b - stated_b|.

    Naeini, Cooper & Hauskrecht, AAAI 2015.
    """
    if not stated:
        return None
    p, right = (np.array(column, dtype=float) for column in zip(*stated, strict=True))
    own = np.clip(np.digitize(p, BINS) - 1, 0, len(BINS) - 2)
    gaps = [
        np.sum(own == b) * abs(float(right[own == b].mean() - p[own == b].mean()))
        for b in np.unique(own)
    ]
    return float(np.sum(gaps) / len(p))


def by_chance(stated: Sequence[float]) -> float | None:
    """Return the calibration error that probabilities which are right stay below in 19 of 20 sets.

    Answers are drawn to be right as often as stated: of few findings, bins hold too few for less.
    """
    if not stated:
        return None
    p, rng = np.array(stated), np.random.default_rng(0)
    drawn = rng.random((DRAWN, len(p))) < p
    errors = [calibration_error([*zip(p, right, strict=True)]) for right in drawn]
    return float(np.quantile([e for e in errors if e is not None], 0.95))


def table(items: Sequence[Scored]) -> dict[str, dict[str, Any]]:
    """Return rates by engine: in-group, out-of-group, and out-of-group by kind of group."""
    parts: dict[str, Callable[[Scored], bool]] = {
        "all": lambda i: True,
        "in-group": lambda i: i.in_group,
        "out-of-group": lambda i: not i.in_group,
    }
    for kind in KINDS:
        parts[f"out by {kind}"] = lambda i, kind=kind: not i.inside[kind]
    found: dict[str, dict[str, Any]] = {}
    for engine in dict.fromkeys(i.engine for i in items):
        own = [i for i in items if i.engine == engine]
        found[engine] = {name: rates([i for i in own if part(i)]) for name, part in parts.items()}
        for kind in KINDS:
            for group in sorted({i.groups[kind] for i in own}):
                chosen = [i for i in own if i.groups[kind] == group]
                found[engine][f"{kind}: {group}"] = rates(chosen)
    return found


def common(items: Sequence[Scored]) -> list[Scored]:
    """Return the answers to cases that every engine answered: only those can be compared."""
    engines = {i.engine for i in items}
    answered = {(i.engine, i.mark.case) for i in items}
    return [i for i in items if all((e, i.mark.case) in answered for e in engines)]


def misses(items: Sequence[Scored]) -> list[dict[str, Any]]:
    """Return every answer that is wrong, with the truth beside it."""
    return [
        {
            "case": i.mark.case,
            "engine": i.engine,
            "truth": i.mark.truth,
            "size": i.mark.size,
            "detectable": i.mark.detectable,
            "expected": list(i.mark.expected),
            "answer": i.mark.answer,
            "probability": i.mark.probability,
            "verdict_right": i.mark.verdict_right,
            "site_right": i.mark.site_1,
            "mechanism_right": i.mark.mechanism_1,
            "among_three": i.mark.mechanism_3,
            "broke": i.broke,
        }
        for i in items
        if i.broke or not i.mark.verdict_right or i.mark.mechanism_1 is False
    ]


def plain(document: Any) -> Any:
    """Return nested rates as plain values."""
    if isinstance(document, Rate):
        return document.document()
    if isinstance(document, Mapping):
        return {k: plain(v) for k, v in document.items()}
    return document


def marks(items: Sequence[Scored]) -> list[dict[str, Any]]:
    """Return every judged answer as plain values."""
    return [
        {**asdict(i.mark), "engine": i.engine, "groups": dict(i.groups), "in_group": i.in_group}
        for i in items
    ]
