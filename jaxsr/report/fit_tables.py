"""The before-and-after numbers of ``fit``, ready for a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from jaxsr.report.formatting import is_number, listing, percent, seconds
from jaxsr.report.words import capital, errors_at, headline_index, site_words

CLEARER = 0.5
"""Share of the error left, relative to that at the headline horizon, below which another horizon
is shown beside it."""
MODELS: Mapping[str, str] = {
    "given": "As given",
    "recalibrated": "Re-calibrated",
    "explained": "Explained",
}
UNKNOWN: Mapping[str, Role] = MappingProxyType({})
_ROLES = {"train": "Training", "held_out": "Held out"}


@dataclass(frozen=True)
class Role:
    """What a reader must know of the recordings of one role beside their errors.

    Parameters
    ----------
    lengths : tuple of float
        Of the recordings, in seconds; empty where nothing is known of them.
    noise : float or None
        NRMSE that the sensors' noise alone makes.
    """

    lengths: tuple[float, ...] = ()
    noise: float | None = None

    def covers(self, horizon: float) -> bool:
        """Whether runs over a horizon are runs over whole recordings."""
        return bool(self.lengths) and horizon >= max(self.lengths) * (1.0 - 1e-6)

    @property
    def span(self) -> str:
        """The recordings' length, or the shortest and the longest."""
        ends = [seconds(end) for end in (min(self.lengths), max(self.lengths))]
        return ends[0] if ends[0] == ends[1] else f"{ends[0]} to {ends[1]}"

    def run_words(self, horizon: float, whole: bool) -> str:
        """Say over what a free run goes: a horizon, or whole recordings by their own length."""
        if not self.lengths or not (whole or self.covers(horizon)):
            return seconds(horizon)
        many = "the whole recording" if len(self.lengths) == 1 else "whole recordings"
        return f"{many}, {self.span}"

    def note(self, horizons: Sequence[float]) -> str:
        """Say how long the recordings are, and which horizons reach beyond them."""
        if not self.lengths:
            return ""
        beyond = [seconds(h) for h in horizons[:-1] if self.covers(h)]
        note = f"{self.span} long"
        return f"{note}: runs of {listing(beyond)} are whole ones too" if beyond else note


def figures_at_a_glance(
    fit: Mapping[str, Any], about: Mapping[str, Role] = UNKNOWN, site: str | None = None
) -> list[dict[str, Any]]:
    """Return the few before-and-after pairs that stand beside the verdict.

    Free runs at the headline horizon, held-out first, and at the horizon where far more of the
    error was removed, if there is one; then the force error at the `site` of the first finding,
    or at the first site.
    """
    shown = headline_index(fit)
    tiles = [_run_tile(fit, shown, row, about) for row in errors_at(fit, shown)]
    clearer = _clearer_horizon(fit, shown)
    if clearer is not None:
        tiles.append(_run_tile(fit, clearer, errors_at(fit, clearer)[0], about))
    forces = sorted((fit.get("force") or {}).items(), key=lambda item: item[0] != site)
    for place, entry in forces:
        role = "held_out" if (entry.get("held_out") or {}).get("explained") is not None else "train"
        pair = entry.get(role) or {}
        if is_number(pair.get("recalibrated")) and is_number(pair.get("explained")):
            words = "held-out recordings" if role == "held_out" else "training recordings"
            title = f"Force, {site_words(place)}"
            tiles.append(_tile(title, words, pair["recalibrated"], pair["explained"]))
            break
    return tiles


def _run_tile(
    fit: Mapping[str, Any],
    index: int | None,
    row: tuple[str, float | None, float | None],
    about: Mapping[str, Role],
) -> dict[str, Any]:
    words, before, after = row
    role = about.get("held_out" if words.startswith("held") else "train", Role())
    horizons = fit.get("horizons_s") or []
    whole = index == len(horizons) - 1
    title = f"Free run over {role.run_words(horizons[index or 0], whole)}"
    return _tile(title, words, before, after, role.noise)


def _clearer_horizon(fit: Mapping[str, Any], shown: int | None) -> int | None:
    """Return the horizon at which least of the error is left, if far less than at the one shown."""

    def left(index: int | None) -> float:
        (_, before, after), *_ = errors_at(fit, index) or [("", None, None)]
        return after / before if is_number(before) and is_number(after) and before > 0.0 else 1.0

    best = min(range(len(fit.get("horizons_s") or [])), key=left, default=None)
    return best if best is not None and left(best) < CLEARER * left(shown) else None


def _tile(
    title: str,
    role: str,
    before: float | None,
    after: float | None,
    noise: float | None = None,
) -> dict[str, Any]:
    largest = max(before or 0.0, after or 0.0, noise or 0.0) or 1.0
    return {
        "title": title,
        "role": role,
        "before": percent(before),
        "after": percent(after),
        "bar_before": round(100 * (before or 0) / largest, 1),
        "bar_after": round(100 * (after or 0) / largest, 1),
        "noise": percent(noise) if noise else "",
        "bar_noise": round(100 * (noise or 0) / largest, 1),
    }


def fit_groups(fit: Mapping[str, Any], about: Mapping[str, Role] = UNKNOWN) -> dict[str, Any]:
    """Return the free-run errors: a column for each horizon, rows for each role and model.

    Horizons at which nothing was run have no column.
    """
    horizons = fit.get("horizons_s") or []
    marked, run = headline_index(fit), _run(fit, len(horizons))
    groups = []
    for key, words in _ROLES.items():
        rows, role = fit.get(key) or {}, about.get(key, Role())
        lines = [
            {
                "model": name,
                "key": model,
                "cells": [percent(_padded(rows[model], len(horizons))[i]) for i in run],
            }
            for model, name in MODELS.items()
            if rows.get(model)
        ]
        if lines and role.noise:
            cells = [percent(role.noise)] * len(run)
            lines.append({"model": "Sensor noise alone", "key": "noise", "cells": cells})
        if lines:
            note = role.note(horizons)
            files = rows.get("files") or []
            groups.append({"role": words, "files": files, "note": note, "rows": lines})
    last = len(horizons) - 1
    columns = [
        {"text": "whole recording" if i == last else seconds(horizons[i]), "headline": i == marked}
        for i in run
    ]
    return {"columns": columns, "groups": groups}


def _run(fit: Mapping[str, Any], count: int) -> list[int]:
    """Return the horizons at which anything was run: time may have ended before others."""
    rows = [_padded((fit.get(role) or {}).get(model), count) for role in _ROLES for model in MODELS]
    return [i for i in range(count) if any(is_number(row[i]) for row in rows)]


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
