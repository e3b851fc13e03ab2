"""Tables of the time that commands take against their budgets, from the committed JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from docs.generate.tables import number, result, table

LONGEST = 3  # stages that a row names


def _cases() -> list[Mapping[str, Any]]:
    return result("budgets")["cases"]


def took(case: Mapping[str, Any]) -> float:
    """Return the seconds of a case on its clock."""
    return case["processor_seconds" if case["clock"] == "processor" else "seconds"]


def held() -> tuple[int, int]:
    """Return how many cases ended within the stated times their budget, and how many there are."""
    most = result("budgets")["held_at"]
    return sum(took(c) <= most * c["budget"] for c in _cases()), len(_cases())


def budgets_table() -> str:
    """Return a row a case: its time over its budget, and the stages that took longest."""
    rows = []
    for case in _cases():
        stages = sorted(case["stages"].items(), key=lambda item: -item[1])[:LONGEST]
        whole = sum(case["stages"].values()) or 1.0
        told = ", ".join(f"{name} {100 * seconds / whole:.0f} %" for name, seconds in stages)
        size = case["states"], f"{case['samples']:,}", number(case["budget"])
        ratio = number(took(case) / case["budget"])
        rows.append((case["command"], *size, ratio, number(case["memory_gib"], 2), told))
    head = ("command", "states", "samples", "budget, s", "time / budget", "GiB")
    return table([*head, "longest stages"], rows)
