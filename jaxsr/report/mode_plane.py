"""The trajectory in the data-driven plane, coloured by mode (the paper's Fig. 12)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxsr.report.style import GIVEN, MODES, Drawing, draw, plain

_MOST_POINTS = 6000
_EDGE = 0.03  # free space around the samples, of their range


@dataclass(frozen=True, eq=False)
class ModePlane:
    """What to draw of modes.

    Attributes
    ----------
    x, y : ndarray, (samples,)
        Two coordinates of the samples.
    names : tuple of str
    mode : ndarray of int, (samples,)
    boundary : ndarray of int, (rows, columns)
        Number of the mode that would hold, on a grid over the plane; empty where it depends on
        something else.
    centroids : ndarray, (clusters,)
        Of the clusters in their first coordinate.
    errors : ndarray, (clusters,)
        Mean square of the best submodel in each cluster.
    cluster_mode : ndarray of int, (clusters,)
        Its number; -1 where modes meet.
    cluster_name : str
        Name of the clusters' first coordinate.
    guards : tuple of str
    """

    x: np.ndarray
    y: np.ndarray
    names: tuple[str, str]
    mode: np.ndarray
    boundary: np.ndarray
    centroids: np.ndarray
    errors: np.ndarray
    cluster_mode: np.ndarray
    cluster_name: str
    guards: tuple[str, ...]


def plane_figures(shown: ModePlane | None) -> list[Drawing]:
    """Draw the plane with the boundary between modes, and the errors of the clusters."""
    if shown is None:
        return []
    plane = draw((7.5, 4.6), lambda figure: _plane(figure, shown))
    errors = draw((7.5, 3.6), lambda figure: _errors(figure, shown))
    note = "Grey lines: where the guard switches." if shown.boundary.size else ""
    best = "Error of the best submodel in every cluster; crosses where modes meet."
    return [
        Drawing("mode_plane.png", plane, "Modes in the data-driven plane", note),
        Drawing("cluster_errors.png", errors, "Clusters", best),
    ]


def draw_plane(ax: Axes, shown: ModePlane) -> None:
    """Draw the samples coloured by mode, and the boundary, on ``ax``."""
    few = np.unique(np.linspace(0, len(shown.x) - 1, min(len(shown.x), _MOST_POINTS)).astype(int))
    for number, guard in enumerate(shown.guards):
        rows = few[shown.mode[few] == number]
        colour = MODES[number % len(MODES)]
        label = f"mode {number}: {plain(guard, 40)}"
        ax.plot(shown.x[rows], shown.y[rows], ".", ms=3.5, color=colour, label=label)
    if shown.boundary.size and np.ptp(shown.boundary) > 0:
        rows, columns = shown.boundary.shape
        grid = np.linspace(*_span(shown.x), columns), np.linspace(*_span(shown.y), rows)
        for number in range(len(shown.guards)):
            held = (shown.boundary == number).astype(float)
            if np.ptp(held) > 0.0:
                ax.contour(*grid, held, levels=[0.5], colors=GIVEN, linewidths=1)
    for limits, values in ((ax.set_xlim, shown.x), (ax.set_ylim, shown.y)):
        low, high = _span(values)
        edge = _EDGE * (high - low)
        limits(low - edge, high + edge)
    ax.set_xlabel(plain(shown.names[0]))
    ax.set_ylabel(plain(shown.names[1]))


def _span(values: np.ndarray) -> tuple[float, float]:
    return float(np.min(values)), float(np.max(values))


def _plane(figure: Figure, shown: ModePlane) -> None:
    draw_plane(figure.subplots(), shown)
    figure.legend(loc="outside upper left", ncols=min(len(shown.guards), 2), markerscale=2.5)


def _errors(figure: Figure, shown: ModePlane) -> None:
    ax = figure.subplots()
    floor = max(float(np.max(shown.errors, initial=0.0)) * 1e-20, 1e-300)
    errors = np.maximum(shown.errors, floor)
    for number in range(-1, len(shown.guards)):
        rows = shown.cluster_mode == number
        mark, colour = ("x", GIVEN) if number < 0 else (".", MODES[number % len(MODES)])
        ax.plot(shown.centroids[rows], errors[rows], mark, ms=5, color=colour)
    ax.set_yscale("log")
    ax.set_xlabel(f"centroid, {plain(shown.cluster_name)}")
    ax.set_ylabel("mean square error")
