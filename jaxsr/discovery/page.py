"""The report of a discovery: one self-contained page with its figures."""

from __future__ import annotations

import base64
import html
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from jaxsr.discovery.equation import Equation
from jaxsr.discovery.samples import Samples, thinned

if TYPE_CHECKING:
    from jaxsr.discovery.result import Discovery

_STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}"
    "code{font:14px ui-monospace,monospace}td,th{text-align:left;padding:.2rem .8rem .2rem 0}"
    "img{max-width:100%}"
)


def write_page(discovery: Discovery, folder: Path) -> None:
    """Write ``report.html`` and one ``fit_STATE.png`` for each equation into ``folder``."""
    parts = []
    for equation in discovery.equations:
        name = f"fit_{equation.state}.png"
        _fit_figure(equation, discovery.samples).print_png(folder / name)
        picture = base64.b64encode((folder / name).read_bytes()).decode("ascii")
        parts.append(_section(equation, discovery, picture))
    lines = "\n".join(
        f"<tr><td>d({html.escape(e.state)})/dt =</td><td><code>{html.escape(e.expression)}</code>"
        "</td></tr>"
        for e in discovery.equations
    )
    text = (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>Discovered equations</title>'
        f"<style>{_STYLE}</style><h1>Equations of motion</h1><table>{lines}</table>"
        + "\n".join(parts)
        + "</html>\n"
    )
    (folder / "report.html").write_text(text, encoding="utf-8")


def _section(equation: Equation, discovery: Discovery, picture: str) -> str:
    rows = "".join(
        f"<tr><td><code>{html.escape(t.expression)}</code></td><td>{t.coefficient:.6g}</td>"
        f"<td>{t.ci95[0]:.6g} to {t.ci95[1]:.6g}</td></tr>"
        for t in equation.terms
    )
    errors = {"training": equation.train_mse, "validation": equation.validation_mse}
    if equation.held_out_mse is not None:
        errors["held-out"] = equation.held_out_mse
    said = ", ".join(f"{name} {value:.3g}" for name, value in errors.items())
    table = discovery.pareto
    front = table[table.state == equation.state].drop(columns="state")
    considered = front.to_html(index=False, float_format=lambda v: f"{v:.3g}") if len(front) else ""
    return (
        f"<h2>{html.escape(equation.state)}</h2><table><tr><th>term</th><th>coefficient</th>"
        f"<th>95 % interval</th></tr>{rows}</table><p>Mean square error: {said}.</p>"
        f'<img alt="derivative and fit" src="data:image/png;base64,{picture}">'
        f"<details><summary>What was chosen from</summary>{considered}</details>"
    )


def _fit_figure(equation: Equation, samples: Samples) -> FigureCanvasAgg:
    rows = thinned(np.arange(len(samples)), 4000)
    few = samples.take(rows)
    y, fit = few.targets[equation.state], equation.predict(few)
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
    place = np.arange(len(few))
    above.plot(place, y, color="0.6", lw=2.5, label="data")
    above.plot(place, fit, color="C0", lw=1, label="equation")
    above.set_ylabel(f"d({equation.state})/dt")
    above.legend(loc="upper right", frameon=False)
    below.plot(place, y - fit, color="C3", lw=0.8)
    below.set_ylabel("residual")
    below.set_xlabel("sample, recordings one after the other")
    return FigureCanvasAgg(figure)
