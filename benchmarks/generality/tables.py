"""Scores as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.concealed.rates import Rate

ROWS = (
    ("cases", "cases"),
    ("verdict", "verdict right"),
    ("false_discovery", "false discoveries"),
    ("site", "site, first"),
    ("mechanism_first", "mechanism, first"),
    ("mechanism_among_three", "mechanism, among three"),
    ("interval_coverage", "95 % intervals that cover"),
    ("right_where_sure", "right where above 0.95"),
    ("calibration_error", "calibration error"),
    ("calibration_error_by_chance", "the same by chance, at most"),
    ("gap_closed_median", "gap closed, median"),
    ("cpu_seconds_median", "processor seconds, median"),
    ("crashes", "crashes"),
)
PARTS = ("in-group", "out-of-group")


def cell(value: Any) -> str:
    """Return a value of the table."""
    if isinstance(value, Rate):
        return "-" if value.value is None else f"{100 * value.value:.0f} % ({value.k}/{value.n})"
    if value is None:
        return "-"
    return f"{value}" if isinstance(value, int) else f"{value:.3g}"


def side_by_side(table: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a Markdown table: engines, each in-group, out-of-group and their difference."""
    heads = [f"{engine}, {part}" for engine in table for part in (*PARTS, "in - out, points")]
    lines = ["| | " + " | ".join(heads) + " |", "|---|" + "---|" * len(heads)]
    for key, label in ROWS:
        cells = []
        for parts in table.values():
            inside, outside = (parts[part][key] for part in PARTS)
            cells += [cell(inside), cell(outside), _difference(inside, outside)]
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _difference(inside: Any, outside: Any) -> str:
    if not isinstance(inside, Rate) or inside.value is None or outside.value is None:
        return ""
    return f"{100 * (inside.value - outside.value):+.0f}"


def by_group(table: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a Markdown table: a row a group, verdict and mechanism of every engine."""
    keys = ("verdict", "mechanism_first")
    heads = [f"{engine}, {key.replace('_', ' ')}" for engine in table for key in keys]
    lines = ["| group | " + " | ".join(heads) + " |", "|---|" + "---|" * len(heads)]
    groups = dict.fromkeys(g for parts in table.values() for g in parts if ": " in g)
    for group in groups:
        cells = [
            cell(parts[group][key]) if group in parts else "-"
            for parts in table.values()
            for key in keys
        ]
        lines.append(f"| {group} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def missed(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a line for every miss."""
    lines = []
    for row in rows:
        seen = "" if row["detectable"] or not row["size"] else ", below detection"
        stated = "" if row["probability"] is None else f" (p {row['probability']:.2f})"
        three = ", right among three" if row["among_three"] and not row["mechanism_right"] else ""
        lines.append(
            f"{row['engine']} {row['case']}: truth {row['truth']} "
            f"({100 * row['size']:.2g} %{seen}); answer {row['broke'] or row['answer']}"
            f"{stated}{three}"
        )
    return "\n".join(lines)
