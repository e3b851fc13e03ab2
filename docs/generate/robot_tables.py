"""Tables of diagnoses through the doors of MuJoCo, URDF and FMI, from the committed JSON."""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median
from typing import Any

from docs.generate.tables import RESULTS, number, percent, result, table

DOORS = ("toml", "mjcf", "urdf", "fmu")


def run(name: str) -> bool:
    """Whether a benchmark has a committed result."""
    return (RESULTS / f"{name}.json").exists()


def zoo() -> Mapping[str, Any]:
    """Return the planted cases and their rates."""
    return result("mjcf_doors")


def zoo_table() -> str:
    """Return the rates of planted cases by file."""
    cases = zoo()["cases"]
    rows = []
    for file in [*dict.fromkeys(c["file"] for c in cases), "all"]:
        own = [c for c in cases if file in (c["file"], "all")]
        planted = [c for c in own if "closed" in c]
        bare = [c for c in own if "closed" not in c]
        findings = sum(len(c["found"]) for c in own)
        rows.append(
            [
                file,
                len(own),
                f"{sum(c['joint_right'] for c in planted)} of {len(planted)}",
                f"{sum(c['law_first'] for c in planted)} of {len(planted)}",
                f"{sum(c['right'] for c in bare)} of {len(bare)}",
                f"{sum(c['false'] for c in own)} of {findings}",
                percent(median(c["closed"] for c in planted)) if planted else "-",
                number(median(c["seconds"] for c in own), 2),
            ]
        )
    header = ["file", "cases", "joint right", "law first", "nothing right", "false findings"]
    return table([*header, "gap closed, median", "processor time in s, median"], rows)


def missed_table() -> str:
    """Return the planted cases that are not right, or have a finding that was not planted."""
    return table(
        ["file", "planted", "joint", "verdict", "findings"],
        [
            [
                c["file"],
                c["effect"],
                c["joint"],
                c["verdict"],
                ", ".join(f"{m} at {s} ({number(p, 2)})" for m, s, p in c["found"]) or "none",
            ]
            for c in zoo()["cases"]
            if c["false"] or not c["right"]
        ],
    )


def joints_table() -> str:
    """Return how many joints are named where all lack friction, and how many were before."""
    rows, before = [], {c["file"]: c for c in result("many_joints_before")["cases"]}
    for case in result("many_joints")["cases"]:
        other = before[case["file"]]
        rows.append(
            [
                case["file"],
                f"{case['named']} of {case['joints']}",
                case["others"],
                case["verdict"],
                percent(case["closed"]),
                number(case["seconds"], 2),
                f"{other['named']} of {other['joints']}",
                percent(other["closed"]),
            ]
        )
    header = ["robot", "joints named", "other findings", "verdict", "gap closed"]
    return table([*header, "processor time in s", "named before", "gap closed before"], rows)


def door_table() -> str:
    """Return the findings of real recordings through every door."""
    rows = []
    for rig, document in result("format_doors").items():
        for door in (d for d in DOORS if d in document["doors"]):
            row = document["doors"][door]
            findings = "; ".join(
                f"{f['law']}, {', '.join(_constant(n, c) for n, c in f['constants'].items())} "
                f"({number(f['probability'], 2)})"
                for f in row["findings"]
            )
            rows.append([rig, door, row["verdict"], findings or "none", number(row["seconds"], 2)])
    return table(["recordings", "door", "verdict", "findings", "s"], rows)


def _constant(name: str, values: list[float]) -> str:
    value, low, high = (number(x, 4) for x in values)
    return f"{name} = {value} [{low}, {high}]"


def agreement() -> str:
    """Return how far the doors of every rig agree, in a sentence each."""
    parts = []
    for rig, document in result("format_doors").items():
        count = sum(d in document["doors"] for d in DOORS)
        same = "the same findings" if document["same"] else "findings that differ"
        inside = "" if document["inside"] else " not"
        parts.append(
            f"{rig}, {count} doors: {same}; constants are{inside} all in each other's intervals."
        )
    return " ".join(parts)
