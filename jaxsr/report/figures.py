"""Figures of a diagnosis for the reader's own session: those of the report, and the posterior."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from jaxsr._result import InputError
from jaxsr.report.evidence import ForceResidual, Trajectory
from jaxsr.report.formatting import sureness
from jaxsr.report.mismatch import by_site, paint_residuals
from jaxsr.report.style import AFTER, GIVEN, SETTINGS
from jaxsr.report.trajectories import caption, choose, paint_free_run
from jaxsr.report.words import capital, mechanism_words, site_words


def plot_free_runs(
    trajectories: Sequence[Trajectory], headline_s: float | None, figure: Figure | None = None
) -> Figure:
    """Draw measured, re-calibrated and explained outputs, those first that tell most.

    Raises
    ------
    InputError
        There is none to draw.
    """
    chosen = choose(trajectories, headline_s)
    _needed(chosen, "free run")

    def paint(whole: Figure) -> None:
        for part, run in zip(_parts(whole, len(chosen)), chosen, strict=True):
            paint_free_run(run, part)
            part.axes[0].set_title(caption(run))

    return _painted(figure, paint, (8.0, 4.2 * len(chosen)))


def plot_residuals(
    residuals: Sequence[ForceResidual],
    findings: Sequence[Mapping[str, Any]],
    figure: Figure | None = None,
) -> Figure:
    """Draw the force that the re-calibrated and the explained model lack, a row for each site.

    Raises
    ------
    InputError
        The model has no force balance that the sensors show.
    """
    sites = by_site(residuals)
    _needed(list(sites), "force residual")

    def paint(whole: Figure) -> None:
        for part, site in zip(_parts(whole, len(sites)), sites, strict=True):
            paint_residuals(sites[site], findings, part)
            part.axes[0].set_title(capital(site_words(site)))

    return _painted(figure, paint, (9.0, 3.7 * len(sites)))


def plot_posterior(document: Mapping[str, Any], figure: Figure | None = None) -> Figure:
    """Draw how probable every finding is, and what may stand in its place.

    Raises
    ------
    InputError
        Nothing was found.
    """
    rows = _posterior(document)
    _needed(rows, "finding")

    def paint(whole: Figure) -> None:
        axes = whole.subplots()
        names = [name for name, _, _ in rows]
        shares = [share for _, share, _ in rows]
        colours = [AFTER if found else GIVEN for _, _, found in rows]
        bars = axes.barh(range(len(rows)), shares, color=colours)
        axes.bar_label(bars, [sureness(share) for share in shares], padding=3)
        axes.set_yticks(range(len(rows)), names)
        axes.invert_yaxis()
        axes.set_xlim(0.0, 1.15)
        axes.set_xlabel("posterior probability; blue: found, grey: may stand in its place")

    return _painted(figure, paint, (8.0, 1.2 + 0.35 * len(rows)))


def _posterior(document: Mapping[str, Any]) -> list[tuple[str, float, bool]]:
    """Return names, probabilities and whether it is a finding, in the order of the findings."""
    rows: list[tuple[str, float, bool]] = []
    for finding in document.get("findings") or []:
        for row in (finding, *(finding.get("alternatives") or [])):
            if row.get("probability") is not None:
                name = f"{mechanism_words(row.get('mechanism'))}, {site_words(row.get('site'))}"
                rows.append((name, float(row["probability"]), row is finding))
    return rows


def _parts(figure: Figure, count: int) -> list[Any]:
    """Return so many stretches of a figure, one above another."""
    parts: Any = figure.subfigures(count, 1, squeeze=False)
    return list(parts[:, 0])


def _painted(
    figure: Figure | None, paint: Callable[[Figure], None], size: tuple[float, float]
) -> Figure:
    with matplotlib.rc_context(SETTINGS):
        if figure is None:
            import matplotlib.pyplot as plt  # only here: it chooses a display

            figure = plt.figure(figsize=size, layout="constrained")
        paint(figure)
    return figure


def _needed(rows: Sequence[Any], what: str) -> None:
    if not rows:
        raise InputError(f"there is no {what} to draw", "plot")
