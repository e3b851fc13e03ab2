"""The before-and-after numbers of ``fit``, ready for a table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jaxsr.report.formatting import is_number, percent, seconds
from jaxsr.report.words import capital, errors_at, headline_index, site_words

CLEARER = 0.5
"""Share of the error left, relative to that at the headline horizon, below which another horizon
is shown beside it."""
_MODELS = {
    "given": "As given",
    "recalibrated": "Re-calibrated",
    "explained": "Explained",
}
_ROLES = {"train": "Training", "held_out": "Held out"}


def figures_at_a_glance(fit: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the few before-and-after pairs that stand beside the verdict.

    Free runs at the headline horizon, held-out first, and at the horizon where far more of the
    error was removed, if there is one; then the force error of the first site.
    """
    shown = headline_index(fit)
    tiles = [
        _tile(f"Free run over {seconds(fit.get('headline_s'))}", role, before, after)
        for role, before, after in errors_at(fit, shown)
    ]
    clearer = _clearer_horizon(fit, shown)
    if clearer is not None:
        words = seconds((fit.get("horizons_s") or [])[clearer])
        tiles.append(_tile(f"Free run over {words}", *errors_at(fit, clearer)[0]))
    for site, entry in (fit.get("force") or {}).items():
        role = "held_out" if (entry.get("held_out") or {}).get("explained") is not None else "train"
        pair = entry.get(role) or {}
        if is_number(pair.get("recalibrated")) and is_number(pair.get("explained")):
            words = "held-out recordings" if role == "held_out" else "training recordings"
            title = f"Force, {site_words(site)}"
            tiles.append(_tile(title, words, pair["recalibrated"], pair["explained"]))
            break
    return tiles


def _clearer_horizon(fit: Mapping[str, Any], shown: int | None) -> int | None:
    """Return the horizon at which least of the error is left, if far less than at the one shown."""

    def left(index: int | None) -> float:
        (_, before, after), *_ = errors_at(fit, index) or [("", None, None)]
        return after / before if is_number(before) and is_number(after) and before > 0.0 else 1.0

    best = min(range(len(fit.get("horizons_s") or [])), key=left, default=None)
    return best if best is not None and left(best) < CLEARER * left(shown) else None


def _tile(title: str, role: str, before: float | None, after: float | None) -> dict[str, Any]:
    largest = max(before or 0.0, after or 0.0) or 1.0
    return {
        "title": title,
        "role": role,
        "before": percent(before),
        "after": percent(after),
        "bar_before": round(100 * (before or 0) / largest, 1),
        "bar_after": round(100 * (after or 0) / largest, 1),
    }


def fit_groups(fit: Mapping[str, Any]) -> dict[str, Any]:
    """Return the free-run errors: a column for each horizon, rows for each role and model."""
    horizons = fit.get("horizons_s") or []
    marked = headline_index(fit)
    groups = []
    for role, words in _ROLES.items():
        rows = fit.get(role) or {}
        lines = [
            {
                "model": name,
                "key": model,
                "cells": [percent(value) for value in _padded(rows.get(model), len(horizons))],
            }
            for model, name in _MODELS.items()
            if rows.get(model)
        ]
        if lines:
            groups.append({"role": words, "files": rows.get("files") or [], "rows": lines})
    columns = [
        {"text": seconds(h), "headline": i == marked, "last": i == len(horizons) - 1}
        for i, h in enumerate(horizons)
    ]
    return {"columns": columns, "groups": groups}


def _padded(values: list[float | None] | None, length: int) -> list[float | None]:
    return ([*(values or []), *[None] * length])[:length]


def force_rows(fit: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the force errors, a row for each site and role."""
    rows = []
    for site, entry in (fit.get("force") or {}).items():
        for role, words in _ROLES.items():
            pair = entry.get(role)
            if pair:
                rows.append(
                    {
                        "site": capital(site_words(site)),
                        "role": words,
                        "half_width": seconds(entry.get("half_width_s")),
                        "before": percent(pair.get("recalibrated")),
                        "after": percent(pair.get("explained")),
                    }
                )
    return rows
