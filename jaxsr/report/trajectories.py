"""Free runs before and after: the output, and the error below it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from jaxsr.report.evidence import Trajectory
from jaxsr.report.formatting import seconds, shorten, unit_text
from jaxsr.report.style import (
    AFTER,
    BEFORE,
    FAINT,
    GIVEN,
    MEASURED,
    SHADE,
    Drawing,
    draw,
    labelled,
    limits,
    line,
    plain,
    rms,
)

MOST_PANELS = 6
_MOST_SWINGS = 60  # beyond, lines merge into a band and a window is drawn instead
_WINDOW_SWINGS = 24
_MOST_MARKS = 40  # of segment borders


def free_runs(
    trajectories: Sequence[Trajectory],
    headline_s: float | None,
    stop: Callable[[], bool] = lambda: False,
) -> list[Drawing]:
    """Draw the free runs that tell most.

    Held-out recordings come first, then the headline horizon, then the largest error before;
    recordings take turns, so that one with many outputs does not crowd out the others.

    Parameters
    ----------
    trajectories : sequence of Trajectory
    headline_s : float or None
        The horizon that the verdict rests on.
    stop : callable
        Asked before every figure but the first.

    Returns
    -------
    list of Drawing
        At most `MOST_PANELS`.
    """
    chosen = choose(trajectories, headline_s)
    wide, drawn = len(chosen) <= 2, list[Drawing]()
    for number, run in enumerate(chosen, start=1):
        if drawn and stop():
            break
        drawn.append(
            Drawing(
                name=f"free_run_{number}.png",
                png=draw((10.0, 4.5) if wide else (6.6, 4.5), _Panel(run).paint),
                caption=caption(run),
                note=_Panel(run).note,
                wide=wide,
            )
        )
    return drawn


def choose(trajectories: Sequence[Trajectory], headline_s: float | None) -> list[Trajectory]:
    """Return the trajectories to draw, in order."""
    usable = [t for t in trajectories if len(t.time) > 1]
    headline = [t for t in usable if headline_s is not None and t.horizon_s == headline_s]
    pool = headline or usable
    ranked = sorted(pool, key=lambda t: (t.role != "held_out", t.recording, -_gain(t)))
    groups = [list(g) for _, g in groupby(ranked, key=lambda t: (t.role, t.recording))]
    turns: list[Trajectory] = []
    for turn in range(max((len(g) for g in groups), default=0)):
        turns.extend(g[turn] for g in groups if turn < len(g))
    held_out = [t for t in turns if t.role == "held_out"]
    train = [t for t in turns if t.role == "train"]
    # Two thirds of the places at most for held-out recordings, when there are others.
    places = max(MOST_PANELS - len(train), 2 * MOST_PANELS // 3)
    first = held_out[:places]
    return first + train[: MOST_PANELS - len(first)]


def caption(run: Trajectory) -> str:
    """Return the title of one panel."""
    role = "held out" if run.role == "held_out" else "training"
    names = f"{shorten(run.output)}, {shorten(run.recording, 32)}"
    if run.whole:
        return f"{names} ({role}), one free run of {seconds(run.time[-1] - run.time[0])}"
    return f"{names} ({role}), free runs of {seconds(run.horizon_s)}"


def _gain(run: Trajectory) -> float:
    spread = float(np.nanstd(run.measured)) if np.isfinite(run.measured).any() else 0.0
    return rms(run.recalibrated - run.measured) / spread if spread > 0 else 0.0


def paint_free_run(run: Trajectory, figure: Figure | SubFigure) -> None:
    """Paint one trajectory over its error into a figure."""
    _Panel(run).paint(figure)


class _Panel:
    """One trajectory over its error."""

    def __init__(self, run: Trajectory) -> None:
        self.run = run
        self.window = busiest_window(run)
        self.note = ""
        if self.window is not None:
            length = seconds(self.window[1] - self.window[0])
            self.note = f"Above: the {length} in which the re-calibrated model errs most (shaded)."

    def paint(self, figure: Figure | SubFigure) -> None:
        run, window = self.run, self.window
        shared = window is None
        top, bottom = figure.subplots(2, 1, sharex=shared, height_ratios=[2, 1])
        self._output(top)
        self._error(bottom)
        bottom.set_xlabel("time in s")
        if window is not None:
            top.set_xlim(*window)
            bottom.axvspan(*window, color=SHADE, alpha=0.35, lw=0)
        bottom.set_xlim(run.time[0], run.time[-1])
        for ax in (top, bottom):
            self._borders(ax)
        figure.legend(*top.get_legend_handles_labels(), loc="outside upper left", ncols=4)
        figure.align_ylabels([top, bottom])

    def _output(self, ax: Axes) -> None:
        run = self.run
        inside = np.ones(len(run.time), bool)
        if self.window is not None:
            inside = (run.time >= self.window[0]) & (run.time <= self.window[1])
        time = run.time[inside]
        line(ax, time, run.measured[inside], color=MEASURED, lw=2.6, alpha=0.45, label="measured")
        if run.given is not None:
            line(ax, time, run.given[inside], color=GIVEN, lw=1.1, ls=":", label="as given")
        before, after = run.recalibrated[inside], run.explained[inside]
        line(ax, time, before, color=BEFORE, lw=1.4, ls=(0, (5, 2)), label="re-calibrated")
        line(ax, time, after, color=AFTER, lw=1.4, label="explained")
        span = limits(run.measured[inside], pad=0.35)
        shown = limits(run.measured[inside], before, after, share=0.0)
        if span is not None and shown is not None:
            # A run that flies off must not flatten the measurement.
            ax.set_ylim(max(span[0], shown[0]), min(span[1], shown[1]))
        ax.set_ylabel(labelled(run.output, unit_text(run.unit)))

    def _error(self, ax: Axes) -> None:
        run = self.run
        before, after = run.recalibrated - run.measured, run.explained - run.measured
        ax.axhline(0, color=GIVEN, lw=0.8)
        line(ax, run.time, before, color=BEFORE, lw=1.0)
        line(ax, run.time, after, color=AFTER, lw=1.0)
        span, range_ = limits(before, after), limits(run.measured, pad=0.0)
        if span is not None and range_ is not None:
            # Beyond the output's own range an error is a failure, and its size says no more.
            most = range_[1] - range_[0]
            ax.set_ylim(max(span[0], -most), min(span[1], most))
        unit = unit_text(run.unit)
        ax.set_ylabel(plain(f"error in {unit}" if unit else "error"))

    def _borders(self, ax: Axes) -> None:
        low, high = ax.get_xlim()
        start, step = self.run.time[0], self.run.horizon_s
        if self.run.whole or step <= 0 or (high - low) / step > _MOST_MARKS:
            return
        for border in np.arange(start + step, high - 1e-9 * step, step):
            if border > low:
                ax.axvline(border, color=FAINT, lw=0.7, zorder=0.5)


def busiest_window(run: Trajectory) -> tuple[float, float] | None:
    """Return the window with the largest error before, where the whole is too dense to draw."""
    swings = _swings(run.measured)
    if swings <= _MOST_SWINGS:
        return None
    samples = max(8, round(len(run.time) * _WINDOW_SWINGS / swings))
    if samples >= len(run.time):
        return None
    error = np.abs(run.recalibrated - run.measured)
    error = np.where(np.isfinite(error), error, 0.0)
    total = np.concatenate([[0.0], np.cumsum(error)])
    start = int(np.argmax(total[samples:] - total[:-samples]))
    end = min(start + samples, len(run.time) - 1)
    return float(run.time[start]), float(run.time[end])


def _swings(values: np.ndarray) -> int:
    """Count how often a signal crosses its median, noise of a tenth of its spread aside."""
    finite = values[np.isfinite(values)]
    if finite.size < 3:
        return 0
    centred = finite - np.median(finite)
    side = np.sign(np.where(np.abs(centred) > 0.1 * np.std(finite), centred, 0.0))
    side = side[side != 0]
    return int(np.count_nonzero(np.diff(side)))
