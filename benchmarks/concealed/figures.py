"""Figures of the scores: risk over coverage, reliability, detection over size."""

from __future__ import annotations

import itertools
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

SIZE = (5.0, 3.6)


def draw(document: Mapping[str, Any], out: Path) -> None:
    """Write the figures of all methods."""
    for name, paint in (
        ("risk_coverage.png", _risk),
        ("reliability.png", _reliability),
        ("detection.png", _detection),
    ):
        figure = Figure(figsize=SIZE, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots()
        paint(axes, document["methods"])
        _save(figure, out / name)


def _save(figure: Figure, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(suffix=".png", dir=path.parent)
    os.close(handle)
    figure.savefig(name, dpi=150)
    os.replace(name, path)


def _risk(axes: Axes, methods: Mapping[str, Any]) -> None:
    for name, method in methods.items():
        if method["risk_coverage"]:
            x, y = np.array(method["risk_coverage"]).T
            axes.plot(x, y, label=name)
    axes.set(
        xlabel="share of detectable cases answered, surest first",
        ylabel="share of wrong mechanisms among them",
        xlim=(0, 1),
        ylim=(0, 1),
    )
    if axes.lines:
        axes.legend()


def _reliability(axes: Axes, methods: Mapping[str, Any]) -> None:
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    for name, method in methods.items():
        rows = method["probabilities"]
        if not rows:
            continue
        x = np.array([r["stated"] for r in rows])
        y = np.array([r["right"]["rate"] for r in rows])
        low, high = np.array([r["right"]["wilson95"] for r in rows]).T
        spans = np.clip([y - low, high - y], 0, None)
        axes.errorbar(x, y, spans, marker="o", linestyle="none", label=name)
    axes.set(xlabel="stated probability", ylabel="share right", xlim=(0, 1.02), ylim=(0, 1.02))
    if len(axes.containers):
        axes.legend()


def _detection(axes: Axes, methods: Mapping[str, Any]) -> None:
    edges = np.geomspace(0.005, 0.4, 7)
    for name, method in methods.items():
        marks = [m for m in method["marks"] if m["size"] > 0]
        sizes = np.array([m["size"] for m in marks])
        found = np.array([m["mechanism_1"] is True for m in marks], dtype=float)
        x, y = [], []
        for low, high in itertools.pairwise(edges):
            inside = (sizes >= low) & (sizes <= high)
            if inside.any():
                x.append(100 * float(np.sqrt(low * high)))
                y.append(float(found[inside].mean()))
        axes.semilogx(x, y, marker="o", label=name)
    axes.set(
        xlabel="size of the effect, % of rms",
        ylabel="share with the right mechanism first",
        ylim=(0, 1.02),
    )
    if axes.lines:
        axes.legend()


__all__ = ["draw"]
