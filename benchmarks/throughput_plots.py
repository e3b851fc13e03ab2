"""One figure of the measured rates, ratios and scaling curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

matplotlib.use("Agg")

# Okabe and Ito's palette, told apart by most colour-blind readers.
COLOURS = {"ours": "#0072B2", "pyoperon": "#D55E00", "gplearn": "#009E73", "naive": "#7F7F7F"}
LABELS = {"ours": "jaxsr", "pyoperon": "pyoperon", "gplearn": "gplearn", "naive": "naive vmap"}


def plot(body: dict[str, Any], path: Path) -> None:
    """Draw the document of benchmarks.throughput into a PNG."""
    figure = Figure(figsize=(13.0, 7.2), layout="constrained")
    axes = figure.subplots(2, 3)
    _rates(axes[0, 0], body["raw"]["runs"])
    _ratios(axes[0, 1], body["raw"]["runs"])
    _new_population(axes[0, 2], body["new_population"])
    _rows(axes[1, 0], body["scaling"]["rows"])
    _curve(axes[1, 1], body["scaling"]["population"]["points"], "terms", "terms (1,000 rows)")
    _curve(axes[1, 2], body["scaling"]["term_size"]["points"], "size", "nodes a term (1,000 rows)")
    figure.savefig(path, dpi=130)


def _style(ax: Axes, title: str, x: str, y: str) -> None:
    ax.set_title(title, fontsize=11)
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    ax.grid(True, which="major", linewidth=0.4, alpha=0.6)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def _with_quartiles(
    ax: Axes, x: Sequence[float], spreads: Sequence[dict[str, float]], scale: float, name: str
) -> None:
    middle = np.array([s["median"] for s in spreads]) / scale
    low = middle - np.array([s["quartile_1"] for s in spreads]) / scale
    high = np.array([s["quartile_3"] for s in spreads]) / scale - middle
    ax.errorbar(
        x,
        middle,
        [low, high],
        marker="o",
        markersize=4,
        capsize=2,
        color=COLOURS[name],
        label=LABELS[name],
    )


def _rates(ax: Axes, runs: list[dict[str, Any]]) -> None:
    random = [run for run in runs if run["population"] == "random"]
    for name in LABELS:
        known = [run for run in random if isinstance(run.get(name), dict)]
        if known:
            _with_quartiles(ax, [r["rows"] for r in known], [r[name] for r in known], 1e9, name)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.legend(frameon=False, fontsize=9)
    _style(ax, "Raw evaluation, random terms", "rows", "G node-rows / s")


def _ratios(ax: Axes, runs: list[dict[str, Any]]) -> None:
    for population, marker in (("random", "o"), ("distinct", "s")):
        known = [r for r in runs if r["population"] == population and "paired_ratio" in r]
        if not known:
            continue
        middle = np.array([r["paired_ratio"]["median"] for r in known])
        low = middle - np.array([r["paired_ratio"]["quartile_1"] for r in known])
        high = np.array([r["paired_ratio"]["quartile_3"] for r in known]) - middle
        style = "-" if population == "random" else "--"
        ax.errorbar(
            [r["rows"] for r in known],
            middle,
            [low, high],
            fmt=marker + style,
            markersize=4,
            capsize=2,
            color=COLOURS["ours"],
            label=f"{population} subtrees",
        )
    ax.axhline(1.0, color="black", linewidth=0.8)
    ax.set_xscale("log")
    ax.set_ylim(bottom=0.0)
    ax.legend(frameon=False, fontsize=9)
    _style(ax, "Times as fast as pyoperon (pairs)", "rows", "jaxsr / pyoperon")


def _new_population(ax: Axes, document: dict[str, Any]) -> None:
    rows = [name for name in document if name.endswith("_rows")]
    for shift, (key, label) in enumerate((("from_terms", "terms"), ("from_postfix", "postfix"))):
        spreads = [document[name][key]["ratio"] for name in rows]
        middle = np.array([s["median"] for s in spreads])
        ends = [
            middle - np.array([s["quartile_1"] for s in spreads]),
            np.array([s["quartile_3"] for s in spreads]) - middle,
        ]
        colour = list(COLOURS.values())[shift * 2]
        place = np.arange(len(rows)) + 0.36 * shift
        ax.bar(place, middle, 0.34, yerr=ends, capsize=2, color=colour, label=f"from {label}")
    ax.axhline(1.0, color="black", linewidth=0.8)
    labels = [f"{int(name.split('_')[0]):,} rows" for name in rows]
    ax.set_xticks(np.arange(len(rows)) + 0.18, labels)
    ax.legend(frameon=False, fontsize=9)
    _style(ax, "First evaluation of a new population", "", "seconds / repeated evaluation")


def _rows(ax: Axes, document: dict[str, Any]) -> None:
    points = document["points"]
    for name in ("ours", "pyoperon"):
        if name in points[0]:
            _with_quartiles(ax, [p["rows"] for p in points], [p[name] for p in points], 1.0, name)
            ax.get_legend_handles_labels()[0][-1].set_label(
                f"{LABELS[name]}, exponent {document[f'exponent_{name}']:.2f}"
            )
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.legend(frameon=False, fontsize=9)
    _style(ax, f"Cost of {document['terms']} terms", "rows", "seconds")


def _curve(ax: Axes, points: list[dict[str, Any]], key: str, label: str) -> None:
    for name in ("ours", "pyoperon"):
        if name not in points[0]:
            continue
        rates = [
            {
                part: point["nodes"] * point["rows"] / point[name][part]
                for part in ("median", "quartile_1", "quartile_3")
            }
            for point in points
        ]
        turned = [r | {"quartile_1": r["quartile_3"], "quartile_3": r["quartile_1"]} for r in rates]
        _with_quartiles(ax, [p[key] for p in points], turned, 1e9, name)
    if key == "terms":
        ax.set_xscale("log")
        ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_ylim(bottom=0.0)
    ax.legend(frameon=False, fontsize=9)
    _style(ax, f"Rate against {label.split(' (')[0]}", label, "G node-rows / s")
