"""Free runs of a discovered model over recordings held out, as figures."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from jaxsr.report.evidence import ModelRun
from jaxsr.report.formatting import number, seconds, shorten, unit_text
from jaxsr.report.style import (
    AFTER,
    FAINT,
    GIVEN,
    MEASURED,
    Drawing,
    Pace,
    draw,
    labelled,
    limits,
    line,
    plain,
)

MOST_RUNS = 6
_MOST_MARKS = 40  # of starts


def run_figures(runs: Sequence[ModelRun], pace: Pace) -> list[Drawing]:
    """Draw measurement, model and error of every output in every recording.

    Recordings take turns, so that one with many outputs does not crowd out the others.

    Parameters
    ----------
    runs : sequence of ModelRun
    pace : Pace
        What figures there is time for.

    Returns
    -------
    list of Drawing
        At most `MOST_RUNS`.
    """
    chosen = _in_turns([run for run in runs if len(run.time) > 1])[:MOST_RUNS]
    wide, drawings = len(chosen) <= 2, list[Drawing]()
    for place, run in enumerate(chosen, start=1):
        drawings += pace.drawn(lambda run=run, place=place: [_drawing(run, place, wide)])
    return drawings


def _in_turns(runs: Sequence[ModelRun]) -> list[ModelRun]:
    groups: dict[str, list[ModelRun]] = {}
    for run in runs:
        groups.setdefault(run.recording, []).append(run)
    most = max((len(group) for group in groups.values()), default=0)
    return [group[k] for k in range(most) for group in groups.values() if k < len(group)]


def _drawing(run: ModelRun, place: int, wide: bool) -> Drawing:
    names = f"{shorten(run.output)}, {shorten(run.recording, 32)} (held out)"
    length = f"of {seconds(run.horizon_s)}"
    how = f"one free run {length}" if len(run.starts) == 1 else f"free runs {length}"
    return Drawing(
        name=f"held_out_run_{place}.png",
        png=draw((10.0, 4.5) if wide else (6.6, 4.5), lambda figure: _paint(figure, run)),
        caption=f"{names}, {how}: error {number(run.nrmse, 2)} (NRMSE)",
        note="The first third of each run tells its start, the rest is predicted.",
        wide=wide,
    )


def _paint(figure: Figure, run: ModelRun) -> None:
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    line(top, run.time, run.measured, color=MEASURED, lw=2.6, alpha=0.45, label="measured")
    line(top, run.time, run.simulated, color=AFTER, lw=1.3, label="model")
    span = limits(run.measured, pad=0.35)
    shown = limits(run.measured, run.simulated, share=0.0)
    if span is not None and shown is not None:
        # A run that flies off must not flatten the measurement.
        top.set_ylim(max(span[0], shown[0]), min(span[1], shown[1]))
    top.set_ylabel(labelled(run.output, unit_text(run.unit)))
    error = run.simulated - run.measured
    bottom.axhline(0, color=GIVEN, lw=0.8)
    line(bottom, run.time, error, color=AFTER, lw=1.0)
    span, whole = limits(error), limits(run.measured, pad=0.0)
    if span is not None and whole is not None:
        most = whole[1] - whole[0]
        bottom.set_ylim(max(span[0], -most), min(span[1], most))
    unit = unit_text(run.unit)
    bottom.set_ylabel(plain(f"error in {unit}" if unit else "error"))
    bottom.set_xlabel("time in s")
    bottom.set_xlim(run.time[0], run.time[-1])
    if 1 < len(run.starts) <= _MOST_MARKS:
        for ax in (top, bottom):
            for start in run.starts[1:]:
                ax.axvline(start, color=FAINT, lw=0.7, zorder=0.5)
    figure.legend(*top.get_legend_handles_labels(), loc="outside upper left", ncols=2)
    figure.align_ylabels([top, bottom])
