"""Tables of runs that must end well whatever they are given, from the committed JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from docs.generate.tables import number, result, table

SIGNALS = {"Ctrl-C": "Ctrl-C (SIGINT)", "kill -9": "kill -9 (SIGKILL)"}
SETTLED_ON = 6
"""Searches, the first ones, on which it was settled how many digits are kept."""
LEFT = {"none": "none", "old": "the earlier ones", "new": "new ones"}


def engines(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the commits of rows that were added over time, and how many each has."""
    counts = Counter(row["engine"] for row in rows)
    return ", ".join(f"`{commit}` ({count})" for commit, count in counts.most_common())


def forms_table() -> str:
    """Return how forms of models and recordings end."""
    found = result("answered_forms")["summary"]
    rows = [
        ("forms", found["forms"]),
        ("ended as they must", found["right"]),
        ("answered", found["answered"]),
        ("refused in one line", found["refused"]),
        *((f"not: {kind.partition(': #')[0]}", len(rows)) for kind, rows in found["wrong"].items()),
    ]
    return table(["what", "count"], rows)


def late_forms() -> str:
    """Return the names of the forms that did not end as they must."""
    forms = [form for form in result("answered_forms")["forms"] if form["problems"]]
    return "; ".join(form["label"].partition(": ")[2] for form in forms) or "none"


def forms_engines() -> str:
    """Return the commits of the rows of forms."""
    return engines(result("answered_forms")["forms"])


def hostile_table() -> str:
    """Return how damaged and hostile files are read."""
    rows = [
        (kind, f"{row['files']:,}", row["wrong"], number(row["seconds"], 2), row["megabytes"])
        for kind, row in result("hostile")["summary"].items()
    ]
    head = ["files of", "read", "not as they should be", "longest, s", "most memory, MB"]
    return table(head, rows)


def hostile_engines() -> str:
    """Return the commits of the blocks of files, 500 each."""
    return engines(result("hostile")["blocks"])


def interrupts_table() -> str:
    """Return what a signal at any moment leaves behind."""
    rows = []
    for sent, row in result("interrupts")["summary"].items():
        statuses = ", ".join(f"{status}: {count}" for status, count in row["statuses"].items())
        files = ", ".join(f"{LEFT[kind]}: {count}" for kind, count in row["files"].items())
        rows.append((SIGNALS[sent], f"{row['right']} of {row['moments']}", statuses, files))
    return table(["signal", "left nothing wrong", "exit status", "results in the folder"], rows)


def rewritings_table() -> str:
    """Return whether one model gives one answer however it is written."""
    rows = [
        (
            name,
            *(row[k] for k in ("ways", "sound", "same_findings", "alike", "same_verdict")),
            f"{row['budget_s']:.0f} s",
            f"`{row['engine']}`",
        )
        for name, row in result("rewritings")["summary"].items()
    ]
    head = ["model", "ways", "without error", "same findings", "alike", "same verdict"]
    head += ["budget", "engine"]
    return table(head, rows)


def reruns_table() -> str:
    """Return how many searches find the same laws with other last digits."""
    found = result("search_reruns")
    rows = []
    for way, count in found["summary"].items():
        later = [r["same"] for r in found["rows"] if r["way"] == way and r["seed"] >= SETTLED_ON]
        rows.append((way, f"{count['same']} of {count['of']}", f"{sum(later)} of {len(later)}"))
    return table(["search", "the same laws", "of them held out"], rows)
