"""What is left after the explanation: whether it is white, and whether it follows anything."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from jaxsr.report.evidence import Evidence, ForceResidual, Trajectory
from jaxsr.report.formatting import shorten, unit_text
from jaxsr.report.style import AFTER, GIVEN, SHADE, Drawing, draw, labelled
from jaxsr.report.words import site_words

LAGS = 25
SURE = 2.576
"""Deviations that white noise stays within 99 times of 100."""
MOST_OUTPUTS, MOST_VARIABLES = 3, 3
BINS, LEAST = 16, 8
"""Stretches of a variable, and values that a stretch needs for its mean."""
_ROLES = {"train": "training", "held_out": "held-out"}


def left_over(evidence: Evidence, stop: Callable[[], bool] = lambda: False) -> list[Drawing]:
    """Draw the explained model's residuals: correlations, and means over the states.

    Held-out recordings are taken where there are any: no constant was fitted to them.

    Parameters
    ----------
    evidence : Evidence
    stop : callable
        Whether to draw nothing.

    Returns
    -------
    list of Drawing
        One, or none where nothing can be told.
    """
    runs = _told(evidence.trajectories)
    parts = _loudest(evidence.residuals)
    panels: list[Callable[[Axes], None]] = [_Correlation(run).paint for run in runs]
    panels += [_Means(parts, name, evidence.units).paint for name in _variables(parts)]
    if not panels or stop():
        return []

    def paint(figure: Figure | SubFigure) -> None:
        axes = np.atleast_1d(np.asarray(figure.subplots(1, len(panels))))
        for ax, panel in zip(axes, panels, strict=True):
            panel(ax)

    note = " ".join(filter(None, [*(_Correlation(r).sentence for r in runs), _means_note(parts)]))
    roles = dict.fromkeys(_ROLES[row.role] for row in (*runs, *parts))
    return [
        Drawing(
            name="left_over.png",
            png=draw((min(3.4 * len(panels) + 0.6, 12.0), 3.1), paint),
            caption=f"What the explained model leaves in {' and '.join(roles)} recordings",
            note=note,
            wide=True,
        )
    ]


def _told(runs: Sequence[Trajectory]) -> list[Trajectory]:
    """Return one run for each output: of a held-out recording, else of a training one."""
    found: dict[str, Trajectory] = {}
    for run in sorted(runs, key=lambda r: r.role != "held_out"):
        if len(_error(run)) > 4 * LAGS:
            found.setdefault(run.output, run)
    return list(found.values())[:MOST_OUTPUTS]


def _error(run: Trajectory) -> np.ndarray:
    error = run.explained - run.measured
    return error[np.isfinite(error)]


def correlations(error: np.ndarray) -> np.ndarray:
    """Return the autocorrelation at lags 1 to `LAGS`."""
    centred = error - error.mean()
    power = float(centred @ centred)
    if power == 0.0:
        return np.zeros(LAGS)
    return np.array([centred[k:] @ centred[:-k] for k in range(1, LAGS + 1)]) / power


class _Correlation:
    """Autocorrelation of one output's error, with the band that white noise stays in."""

    def __init__(self, run: Trajectory) -> None:
        error = _error(run)
        self.run, self.values = run, correlations(error)
        self.band = SURE / np.sqrt(error.size)

    @property
    def sentence(self) -> str:
        outside = int(np.count_nonzero(np.abs(self.values) > self.band))
        run = self.run
        name = f"{shorten(run.output)} ({shorten(run.recording, 32)}, {_ROLES[run.role]})"
        if outside <= 1:
            return f"The error of {name} is white: {outside} of {LAGS} lags outside the band."
        return (
            f"The error of {name} is not white: {outside} of {LAGS} lags outside the band of 99 %."
        )

    def paint(self, ax: Axes) -> None:
        ax.axhspan(-self.band, self.band, color=SHADE, alpha=0.5, lw=0)
        ax.axhline(0, color=GIVEN, lw=0.8)
        ax.vlines(np.arange(1, LAGS + 1), 0.0, self.values, color=AFTER, lw=1.6)
        low = min(-0.25, -1.5 * self.band, float(self.values.min()) - 0.05)
        ax.set_ylim(low, max(0.25, 1.5 * self.band, float(self.values.max()) + 0.05))
        ax.set_xlabel("lag in samples")
        ax.set_ylabel(f"autocorrelation, {shorten(self.run.output)}")


def _loudest(residuals: Sequence[ForceResidual]) -> list[ForceResidual]:
    """Return the recordings of the site whose residual was largest before.

    Those held out where there are any, else those of training.
    """
    power: dict[str, float] = {}
    for part in residuals:
        known = part.recalibrated[np.isfinite(part.recalibrated)]
        power[part.site] = power.get(part.site, 0.0) + float(known @ known)
    worst = max(power, key=lambda site: power[site], default=None)
    parts = [part for part in residuals if part.site == worst and len(part.time)]
    return [part for part in parts if part.role == "held_out"] or parts


def _variables(parts: Sequence[ForceResidual]) -> list[str]:
    """Return the state along the site, and others."""
    if not parts:
        return []
    names = dict.fromkeys([parts[0].state_name, *parts[0].variables])
    return list(names)[:MOST_VARIABLES]


def _means_note(parts: Sequence[ForceResidual]) -> str:
    if not parts:
        return ""
    return (
        f"Bands: the mean of the residual, {site_words(parts[0].site)}, over the "
        f"{_ROLES[parts[0].role]} recordings, and 95 % of its error."
    )


class _Means:
    """Mean of the explained residual over a variable, with its confidence."""

    def __init__(self, parts: Sequence[ForceResidual], name: str, units: Mapping[str, str]) -> None:
        self.part, self.name = parts[0], name
        self.unit = parts[0].state_unit if name == parts[0].state_name else units.get(name)
        columns = [p.variables.get(name, p.state) for p in parts]
        self.over = np.concatenate(columns)
        self.residual = np.concatenate([p.explained for p in parts])

    def paint(self, ax: Axes) -> None:
        keep = np.isfinite(self.over) & np.isfinite(self.residual)
        over, residual = self.over[keep], self.residual[keep]
        ax.axhline(0, color=GIVEN, lw=0.8)
        ax.plot(over, residual, ".", ms=2, alpha=0.25, color=AFTER, mew=0, rasterized=True)
        middle, mean, error = means(over, residual)
        ax.fill_between(middle, mean - 2 * error, mean + 2 * error, color=SHADE, alpha=0.6, lw=0)
        ax.plot(middle, mean, color=AFTER, lw=1.6)
        ax.locator_params(axis="x", nbins=4)  # panels are narrow
        ax.set_xlabel(labelled(self.name, unit_text(self.unit)))
        ax.set_ylabel(labelled("residual", unit_text(self.part.unit)))


def means(over: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the middles of stretches of a variable, and the means there with their errors.

    Stretches hold equally many values, so that few held-out ones still tell a mean. Neighbouring
    test functions overlap by three quarters, so that a fourth of them is independent.
    """
    if len(over) < 2 * LEAST or np.ptp(over) == 0.0:
        return np.empty(0), np.empty(0), np.empty(0)
    count = int(np.clip(len(over) // (2 * LEAST), 2, BINS))
    edges = np.unique(np.quantile(over, np.linspace(0.0, 1.0, count + 1)))
    place = np.clip(np.digitize(over, edges) - 1, 0, max(len(edges) - 2, 0))
    rows = []
    for k in range(len(edges) - 1):
        inside = values[place == k]
        if inside.size >= LEAST:
            error = np.std(inside) / np.sqrt(inside.size / 4.0)
            rows.append((np.mean(over[place == k]), np.mean(inside), error))
    found = np.array(rows).reshape(-1, 3).T
    return found[0], found[1], found[2]
