"""Where the mismatch sits: the force residual over the state and over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from jaxsr.report.evidence import ForceResidual
from jaxsr.report.formatting import unit_text
from jaxsr.report.style import (
    AFTER,
    BEFORE,
    GIVEN,
    SHADE,
    Drawing,
    draw,
    labelled,
    limits,
    line,
    rms,
)
from jaxsr.report.words import capital, site_words

MOST_SITES = 4
_MOST_POINTS = 1500  # of a scatter
_BINS = 32
_LEAST_IN_BIN = 5


def mismatches(
    residuals: Sequence[ForceResidual],
    findings: Sequence[Mapping[str, Any]],
    stop: Callable[[], bool] = lambda: False,
) -> list[Drawing]:
    """Draw the residual of each site, sites with findings first.

    Parameters
    ----------
    residuals : sequence of ForceResidual
        Training recordings of a site are pooled over the state, as what was found is found there;
        over time one of them is drawn.
    findings : sequence of mapping
        Their sites give the order, their regions are shaded.
    stop : callable
        Asked before every figure.

    Returns
    -------
    list of Drawing
        At most `MOST_SITES`.
    """
    sites = by_site(residuals)
    found = [str(finding.get("site")) for finding in findings]
    order = sorted(sites, key=lambda site: found.index(site) if site in found else len(found))
    drawings = []
    for number, site in enumerate(order[:MOST_SITES], start=1):
        if stop():
            break
        panel = _Panel(sites[site], _regions(findings, site, sites[site][0].state_name))
        drawings.append(
            Drawing(
                name=f"mismatch_{number}.png",
                png=draw((10.0, 3.7), panel.paint),
                caption=f"{capital(site_words(site))}: what the model leaves unexplained",
                note=panel.note,
            )
        )
    return drawings


def by_site(residuals: Sequence[ForceResidual]) -> dict[str, list[ForceResidual]]:
    """Return the training recordings of each site, those held out where there are no others."""
    sites: dict[str, list[ForceResidual]] = {}
    for residual in residuals:
        if len(residual.time):
            sites.setdefault(residual.site, []).append(residual)
    return {
        site: [part for part in parts if part.role == "train"] or parts
        for site, parts in sites.items()
    }


def _regions(
    findings: Sequence[Mapping[str, Any]], site: str, state: str
) -> list[tuple[float, float]]:
    spans: list[tuple[float, float]] = []
    for finding in findings:
        for region in (finding.get("where") or {}).get("region") or []:
            ends = (region.get("from"), region.get("to"))
            here = finding.get("site") == site and region.get("variable") == state
            here = here and not region.get("everywhere")
            if here and None not in ends and ends not in spans:
                spans.append(ends)
    return spans


def paint_residuals(
    parts: list[ForceResidual],
    findings: Sequence[Mapping[str, Any]],
    figure: Figure | SubFigure,
) -> None:
    """Paint the residual of one site over its state and over time into a figure."""
    _Panel(parts, _regions(findings, parts[0].site, parts[0].state_name)).paint(figure)


class _Panel:
    """Residual over the state (left) and over time (right)."""

    def __init__(self, parts: list[ForceResidual], regions: list[tuple[float, float]]) -> None:
        self.parts, self.regions = parts, regions
        self.shown = max(parts, key=lambda part: rms(part.recalibrated))
        self.before = np.concatenate([part.recalibrated for part in parts])
        self.after = np.concatenate([part.explained for part in parts])
        self.state = np.concatenate([part.state for part in parts])
        over = f"Lines: medians over {self.shown.state_name}."
        time = f" Right: {self.shown.recording}"
        names = {part.recording for part in parts}
        time += f", the largest of {len(names)} recordings." if len(names) > 1 else "."
        self.note = over + (" Shaded: where the finding acts." if regions else "") + time

    def paint(self, figure: Figure | SubFigure) -> None:
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=[1, 1.35])
        shown = self.shown
        for start, end in self.regions:
            # A thin region still shows: at least a hundredth of what is drawn.
            span = limits(self.state, share=0.0, pad=0.0) or (0.0, 1.0)
            least = 0.005 * (span[1] - span[0])
            middle, half = (start + end) / 2, max((end - start) / 2, least)
            left.axvspan(middle - half, middle + half, color=SHADE, alpha=0.35, lw=0)
        self._scatter(left, self.before, BEFORE)
        self._scatter(left, self.after, AFTER)
        left.set_xlabel(labelled(shown.state_name, unit_text(shown.state_unit)))
        left.set_ylabel(labelled("residual", unit_text(shown.unit)))
        line(right, shown.time, shown.recalibrated, color=BEFORE, lw=1.1, label="re-calibrated")
        line(right, shown.time, shown.explained, color=AFTER, lw=1.1, label="explained")
        right.set_xlabel("time in s")
        for ax in (left, right):
            ax.axhline(0, color=GIVEN, lw=0.8, zorder=0.6)
        span = limits(self.before, self.after)
        if span is not None:
            left.set_ylim(*span)
        figure.legend(*right.get_legend_handles_labels(), loc="outside upper left", ncols=2)

    def _scatter(self, ax: Axes, residual: np.ndarray, colour: str) -> None:
        keep = np.isfinite(residual) & np.isfinite(self.state)
        state, residual = self.state[keep], residual[keep]
        every = max(1, -(-len(state) // _MOST_POINTS))
        ax.plot(state[::every], residual[::every], ".", ms=3, alpha=0.25, color=colour, mew=0)
        ax.plot(*medians(state, residual), color=colour, lw=1.8)


def medians(state: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the median residual in equal stretches of the state; NaN where it is sparse."""
    if len(state) < 2 * _LEAST_IN_BIN or np.ptp(state) == 0:
        return np.empty(0), np.empty(0)
    edges = np.linspace(state.min(), state.max(), _BINS + 1)
    place = np.clip(np.digitize(state, edges) - 1, 0, _BINS - 1)
    middle = np.full(_BINS, np.nan)
    for index in range(_BINS):
        inside = residual[place == index]
        if len(inside) >= _LEAST_IN_BIN:
            middle[index] = np.median(inside)
    return (edges[:-1] + edges[1:]) / 2, middle
