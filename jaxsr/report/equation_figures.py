"""Figures of a discovery: the Pareto fronts, the fits, the modes over time."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxsr.report.evidence import EquationFit
from jaxsr.report.formatting import is_number, shorten
from jaxsr.report.style import (
    AFTER,
    BEFORE,
    GIVEN,
    MEASURED,
    MODES,
    Drawing,
    Pace,
    draw,
    limits,
    line,
    plain,
    rms,
)

MOST_FRONTS = 6
MOST_FITS = 6
_MOST_RECORDINGS = 12  # of the mode figure
_COLUMNS = 3
_PLAIN = re.compile(r"[A-Za-z_]\w{0,40}", re.ASCII)  # states that may name a file


def is_pick(point: Mapping[str, Any], equation: Mapping[str, Any]) -> bool:
    """Whether a point of the front is the equation that was taken, marked as such or alike."""
    if "picked" in point:
        return bool(point["picked"])
    if point.get("expression") == equation.get("expression"):
        return True
    return point.get("complexity") == equation.get("complexity")


def pareto_figure(document: Mapping[str, Any]) -> list[Drawing]:
    """Draw the error over the number of terms, a panel for each state, the pick ringed."""
    equations = {str(e.get("state")): e for e in document.get("equations") or []}
    fronts = {
        state: [p for p in points if is_number(p.get("complexity")) and is_number(p.get("mse"))]
        for state, points in (document.get("pareto") or {}).items()
    }
    shown = [(state, points) for state, points in fronts.items() if points][:MOST_FRONTS]
    if not shown:
        return []
    columns = min(_COLUMNS, len(shown))
    rows = -(-len(shown) // columns)

    def paint(figure: Figure) -> None:
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for ax, (state, points) in zip(axes, shown, strict=False):
            _front(ax, state, points, equations.get(state, {}))
        for ax in axes[len(shown) :]:
            ax.set_visible(False)
        for ax in axes[::columns]:
            ax.set_ylabel("mean square error")

    width = {1: 5.6, 2: 8.4}.get(columns, 10.0)
    png = draw((width, 3.3 * rows), paint)
    note = "Each point is the best equation of its size; the ring marks the one taken."
    return [Drawing("pareto.png", png, "Error against number of terms", note, wide=columns > 1)]


def _front(
    ax: Axes, state: str, points: Sequence[Mapping[str, Any]], equation: Mapping[str, Any]
) -> None:
    points = sorted(points, key=lambda p: p["complexity"])
    size = [p["complexity"] for p in points]
    error = [p["mse"] for p in points]
    ax.plot(size, error, color=GIVEN, lw=1.1, drawstyle="steps-post", zorder=1.5)
    ax.plot(size, error, "o", ms=5, color=AFTER)
    picks = [p for p in points if is_pick(p, equation)]
    exact = [p for p in picks if p.get("expression") == equation.get("expression")]
    for pick in exact or picks:
        place = (pick["complexity"], pick["mse"])
        ax.plot(*place, "o", ms=12, mfc="none", mec=BEFORE, mew=2)
    if min(error) > 0:
        ax.set_yscale("log")
        room = max(5.0, (max(error) / min(error)) ** 0.06)  # for the ring
        ax.set_ylim(min(error) / room, max(error) * room)
    ax.set_xlim(min(size) - 0.5, max(size) + 0.5)
    ax.set_title(plain(state))
    ax.set_xlabel("terms")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))


def fit_figures(fits: Sequence[EquationFit], pace: Pace | None = None) -> list[Drawing]:
    """Draw derivative and residual of each state, in the recording with the largest residual.

    Parameters
    ----------
    fits : sequence of EquationFit
    pace : Pace, optional
        What figures there is time for; all by default.

    Returns
    -------
    list of Drawing
        At most `MOST_FITS`, states in the order in which they come.
    """
    states: dict[str, list[EquationFit]] = {}
    for fit in fits:
        if len(fit.time) > 1:
            states.setdefault(fit.state, []).append(fit)
    drawings: list[Drawing] = []
    pace = pace or Pace()
    wide = len(states) <= 2
    for number, (state, group) in enumerate(list(states.items())[:MOST_FITS], start=1):
        name = f"fit_{state if _PLAIN.fullmatch(state) else number}.png"
        drawings += pace.drawn(lambda group=group, name=name: [_fit_drawing(group, name, wide)])
    return drawings


def _fit_drawing(group: Sequence[EquationFit], name: str, wide: bool) -> Drawing:
    fit = max(group, key=lambda f: rms(f.target - f.predicted))
    note = f"The recording with the largest residual of {len(group)}." if len(group) > 1 else ""
    png = draw((10.0, 4.2) if wide else (5.4, 3.7), lambda figure: _fit(figure, fit))
    caption = f"Rate of {shorten(fit.state)}, {shorten(fit.recording, 32)}"
    return Drawing(name, png, caption, note, wide)


def _fit(figure: Figure, fit: EquationFit) -> None:
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    line(top, fit.time, fit.target, color=MEASURED, lw=2.6, alpha=0.45, label="from the data")
    line(top, fit.time, fit.predicted, color=AFTER, lw=1.3, label="equation")
    top.set_ylabel(plain(f"rate of {fit.state}", 24))
    residual = fit.target - fit.predicted
    bottom.axhline(0, color=GIVEN, lw=0.8)
    line(bottom, fit.time, residual, color=AFTER, lw=1.0)
    span = limits(residual)
    if span is not None:
        bottom.set_ylim(*span)
    bottom.set_ylabel("residual")
    bottom.set_xlabel("time in s")
    bottom.set_xlim(fit.time[0], fit.time[-1])
    figure.legend(*top.get_legend_handles_labels(), loc="outside upper left", ncols=2)
    figure.align_ylabels([top, bottom])


def mode_figure(document: Mapping[str, Any]) -> list[Drawing]:
    """Draw which mode holds when, a row for each recording; nothing with one mode."""
    switching = {name: rows for name, rows in (document.get("switching") or {}).items() if rows}
    shown = list(switching.items())[:_MOST_RECORDINGS]
    if not shown:
        return []
    modes = sorted({int(row[2]) for _, rows in shown for row in rows})

    def paint(figure: Figure) -> None:
        ax = figure.subplots()
        for height, (_, rows) in enumerate(shown):
            for mode in modes:
                spans = [(row[0], row[1] - row[0]) for row in rows if int(row[2]) == mode]
                colour = MODES[mode % len(MODES)]
                label = f"mode {mode}" if height == 0 else "_"
                ax.broken_barh(spans, (height - 0.35, 0.7), facecolors=colour, label=label)
        ax.set_yticks(np.arange(len(shown)), [plain(name, 28) for name, _ in shown])
        ax.invert_yaxis()
        ax.grid(visible=False, axis="y")
        ax.set_xlabel("time in s")
        figure.legend(loc="outside upper left", ncols=len(modes))

    png = draw((10.0, 1.3 + 0.4 * len(shown)), paint)
    rest = len(switching) - len(shown)
    note = f"{rest} more recordings are not drawn." if rest else ""
    return [Drawing("modes.png", png, "Modes over time", note)]
