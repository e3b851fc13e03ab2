"""Plots of an equation on axes of the caller's: its front, its fit, its residual.

Each function draws on ``ax``, or on the current axes of pyplot, and returns them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from jaxsr.report.style import AFTER, BEFORE, GIVEN, MEASURED, decimate, limits, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_POINTS = 4000


@dataclass(frozen=True, eq=False)
class Fitted:
    """A target beside what an equation gives for it.

    Attributes
    ----------
    target, fit : ndarray, (samples,)
    over : ndarray, (samples,), optional
        What to plot over; increasing.
    name, over_name : str
        Names of the target and of what it is plotted over.
    """

    target: np.ndarray
    fit: np.ndarray
    over: np.ndarray | None = None
    name: str = "y"
    over_name: str = "t"


def plot_front(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Plot loss over size for the candidates of one equation, the pick ringed.

    Parameters
    ----------
    table : DataFrame
        Columns size, loss and picked, as in ``equations_``.
    ax : matplotlib Axes, optional
    """
    ax = _axes(ax)
    size, loss, picked = (table[name].to_numpy() for name in ("size", "loss", "picked"))
    order = np.lexsort((loss, size))
    order = order[np.isfinite(loss[order])]
    size, loss, picked = size[order], loss[order], picked[order].astype(bool)
    # exact fits differ by rounding alone: a floor keeps the axis readable
    floor = max(float(np.max(loss, initial=0.0)) * 1e-20, np.finfo(float).tiny)
    loss = np.maximum(loss, floor)
    best = np.minimum.accumulate(loss) if len(loss) else loss
    ax.plot(size, best, color=GIVEN, lw=1.1, drawstyle="steps-post", zorder=1.5)
    ax.plot(size, loss, "o", ms=5, color=AFTER, label="candidates")
    style = {"ms": 12, "mfc": "none", "mec": BEFORE, "mew": 2, "ls": "none"}
    ax.plot(size[picked], loss[picked], "o", label="taken", **style)
    ax.set_yscale("log")
    ax.set_xlabel("size (nodes and coefficients)")
    ax.set_ylabel("mean square error")
    ax.legend(frameon=False)
    return ax


def plot_fit(shown: Fitted, ax: Axes | None = None) -> Axes:
    """Plot target and fit over time, or the fit against the target where there is no time."""
    ax, target, fit = _axes(ax), shown.target, shown.fit
    if shown.over is None:
        _scattered(ax, target, fit)
        span = limits(target)
        if span is not None:
            ax.plot(span, span, color=GIVEN, lw=1, zorder=1.5)
        ax.set_xlabel(plain(shown.name))
        ax.set_ylabel(f"{plain(shown.name)} by the equation")
        return ax
    ax.plot(
        *decimate(shown.over, target), color=MEASURED, lw=2.6, alpha=0.45, label="from the data"
    )
    ax.plot(*decimate(shown.over, fit), color=AFTER, lw=1.3, label="equation")
    ax.set_xlabel(plain(shown.over_name))
    ax.set_ylabel(plain(shown.name))
    ax.legend(frameon=False)
    return ax


def plot_residual(shown: Fitted, ax: Axes | None = None) -> Axes:
    """Plot target minus fit, over time or over the fit."""
    ax, residual = _axes(ax), shown.target - shown.fit
    ax.axhline(0.0, color=GIVEN, lw=0.8)
    if shown.over is None:
        _scattered(ax, shown.fit, residual)
        ax.set_xlabel(f"{plain(shown.name)} by the equation")
    else:
        ax.plot(*decimate(shown.over, residual), color=AFTER, lw=1.0)
        ax.set_xlabel(plain(shown.over_name))
    ax.set_ylabel(f"residual of {plain(shown.name)}")
    return ax


def _scattered(ax: Axes, x: np.ndarray, y: np.ndarray) -> None:
    """Plot samples as dots, evenly spread ones where there are many."""
    few = np.unique(np.linspace(0, len(x) - 1, min(len(x), _MOST_POINTS)).astype(int))
    ax.plot(x[few], y[few], ".", ms=4, color=AFTER)


def _axes(ax: Axes | None) -> Axes:
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt  # only here: it chooses a display

    return plt.gca()
