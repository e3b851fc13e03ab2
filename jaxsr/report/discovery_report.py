"""The report of a discovery."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from jaxsr._interval import MOST_DIGITS
from jaxsr.report.equation_figures import (
    MOST_FRONTS,
    fit_figures,
    is_pick,
    mode_figure,
    pareto_figure,
)
from jaxsr.report.evidence import EquationFit, ModelRun
from jaxsr.report.exploring import packed_runs, script, script_hash
from jaxsr.report.formatting import estimate, is_number, listing, number, percent
from jaxsr.report.mode_plane import ModePlane, plane_figures
from jaxsr.report.model_runs import run_figures
from jaxsr.report.page import write_page
from jaxsr.report.style import Pace

_TITLES = {
    "law": "Discovered equations",
    "several": "Several laws fit",
    "undecided": "Undecided: no law is claimed",
}


def write_discovery_report(
    document: Mapping[str, Any],
    fits: Sequence[EquationFit],
    directory: Path,
    plane: ModePlane | None = None,
    pace: Pace | None = None,
    runs: Sequence[ModelRun] = (),
) -> None:
    """Write ``report.html``, one file with its figures inside, and the figures as PNG.

    Parameters
    ----------
    document : mapping
        What ``discovery.json`` holds.
    fits : sequence of EquationFit
        Derivatives and predictions to draw; may be empty.
    directory : Path
        Where to write; made when absent.
    plane : ModePlane, optional
        The modes in the plane of two states.
    pace : Pace, optional
        What figures there is time for; all by default.
    runs : sequence of ModelRun
        Free runs over recordings held out; with any, the page can be explored.

    Raises
    ------
    InputError
        If `directory` cannot be written.
    """
    equations = document.get("equations") or []
    pace = pace or Pace()
    fitted = fit_figures(fits, pace)
    panels = max(1.0, 0.5 * min(len(equations), MOST_FRONTS))
    fronts = pace.drawn(lambda: pareto_figure(document), panels)
    switching = []
    if plane is not None or document.get("switching"):
        switching = pace.drawn(lambda: [*mode_figure(document), *plane_figures(plane)], 3.0)
    held_out = run_figures(runs, pace)
    explorable = any(len(run.time) > 1 for run in runs)
    context: dict[str, Any] = {
        "title": _TITLES.get(str(document.get("verdict")), "Discovered equations"),
        "sentence": _sentence(document),
        "verdict": _verdict(document),
        "alternatives": [
            [_equation(equation) for equation in _different(law, equations)]
            for law in document.get("alternatives") or []
        ],
        "data_checks": document.get("data_checks") or [],
        "equations": [_equation(equation) for equation in equations],
        "modes": [
            {
                "number": index,
                "guard": mode.get("guard"),
                "dwell": _dwell(mode.get("dwell_s")),
                "equations": [_equation(equation) for equation in mode.get("equations") or []],
            }
            for index, mode in enumerate(document.get("modes") or [])
        ],
        "one_law": _one_law(document),
        "rare_mode": str((document.get("rare_mode") or {}).get("sentence") or ""),
        "mode_figures": switching,
        "held_out_runs": held_out,
        "runs_undrawn": len(runs) - len(held_out),
        "explorable": explorable,
        "pareto_figures": fronts,
        "pareto": _fronts(document),
        "fits": fitted,
        "undrawn": len({fit.state for fit in fits}) - len(fitted),
        "hurried": pace.left_out,
        "provenance": document.get("provenance") or {},
    }
    if explorable:
        context |= {
            "evidence": Markup(packed_runs(runs)),
            "script": Markup(script()),
            "script_hash": script_hash(),
        }
    drawings = [*fronts, *fitted, *switching, *held_out]
    write_page(Path(directory), "discovery.html.j2", context, drawings)


def _verdict(document: Mapping[str, Any]) -> list[str]:
    """Say what is claimed and on what it rests, sentence by sentence."""
    told, reason = document.get("verdict"), str(document.get("reason") or "")
    out = []
    if told == "law":
        out.append("One law fits.")
    elif told == "several":
        count = len(document.get("alternatives") or [])
        others = "another law fits" if count == 1 else f"{count} other laws fit"
        out.append(f"The data cannot tell the law from others: {others} as well.")
    elif told:
        out.append("What stands below is the best that was found.")
    if reason:
        out.append(f"{reason[0].upper()}{reason[1:]}.")
    if is_number(document.get("free_run_nrmse")):
        error = number(document["free_run_nrmse"], 2)
        out.append(f"The model, run freely over data held back, errs by {error} (NRMSE).")
    return out


def _different(
    law: Sequence[Mapping[str, Any]], taken: Sequence[Mapping[str, Any]]
) -> list[Mapping[str, Any]]:
    """Return the equations of another law that are not those taken."""
    known = {e.get("state"): e.get("expression") for e in taken}
    return [e for e in law if e.get("expression") != known.get(e.get("state"))]


def _dwell(times: Sequence[float] | None) -> str:
    """Say how long visits of a mode last."""
    if not times:
        return ""
    low, middle, high = (number(value, 3) for value in times)
    return f"visits last {low} to {high} s, median {middle} s"


def _one_law(document: Mapping[str, Any]) -> str:
    """Say what one law for all samples leaves, and what the modes leave."""
    modes = {e.get("state"): e for e in document.get("equations") or []}
    parts = []
    for law in document.get("one_law") or []:
        both = law, modes.get(law.get("state"), {})
        left = [percent(e.get("relative_error")) for e in both]
        terms = int(law.get("complexity") or 0)
        parts.append(
            f"For {law.get('state')} the best single law, of {terms} terms, leaves {left[0]} of "
            f"the rate's rms, the modes {left[1]}."
        )
    return " ".join(parts)


def _sentence(document: Mapping[str, Any]) -> str:
    equations = document.get("equations") or []
    if not equations:
        return "No equation was found."
    states = listing([str(equation.get("state")) for equation in equations], most=8)
    terms = sum(int(equation.get("complexity") or 0) for equation in equations)
    count = "One equation" if len(equations) == 1 else f"{len(equations)} equations"
    modes = len(document.get("modes") or [])
    tail = f", in {modes} modes" if modes > 1 else ""
    return f"{count} for {states}: {terms} {'term' if terms == 1 else 'terms'}{tail}."


def _equation(equation: Mapping[str, Any]) -> dict[str, Any]:
    """Return an equation with its terms and errors printed."""
    terms = []
    expression = str(equation.get("expression") or "")
    for term in equation.get("terms") or []:
        if expression.startswith("Piecewise(") and term.get("expression") == expression:
            continue  # its coefficients stand with the modes
        value, interval = _coefficient(term.get("coefficient"), term.get("ci95"))
        row = {"expression": term.get("expression"), "value": value, "interval": interval}
        terms.append(row)
    errors = (("training", "train_mse"), ("validation", "validation_mse"))
    errors += (("held out", "held_out_mse"),)
    facts = [
        (f"Mean square error of the rate, {words}", number(equation.get(key), 3))
        for words, key in errors
        if is_number(equation.get(key))
    ]
    if is_number(equation.get("held_out_free_run_nrmse")):
        value = number(equation["held_out_free_run_nrmse"], 3)
        facts.insert(0, ("Free run, NRMSE, held out", value))
    if is_number(equation.get("free_run_nrmse")):
        value = number(equation["free_run_nrmse"], 3)
        facts.insert(0, ("Free run, NRMSE, data held back", value))
    if is_number(equation.get("relative_error")):
        facts.insert(0, ("Residual over rate, rms", percent(equation["relative_error"])))
    return {
        "state": str(equation.get("state")),
        "expression": equation.get("expression"),
        "shown": equation.get("shown") or equation.get("expression"),
        "digits": MOST_DIGITS if equation.get("shown") else 4,
        "terms": terms,
        "errors": facts,
        "complexity": number(equation.get("complexity")),
        "operators": number(equation.get("operators")),
    }


def _coefficient(value: Any, ci95: Any) -> tuple[str, str]:
    """Print a coefficient and its interval; a width where the ends would read the same."""
    shown, interval = estimate(value, ci95)
    low, _, high = interval.partition(" … ")
    if low != high:
        return shown, interval
    return number(value, 8), f"± {number((ci95[1] - ci95[0]) / 2.0, 2)}"


def _fronts(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return each state's Pareto front as rows, the pick marked."""
    equations = {str(e.get("state")): e for e in document.get("equations") or []}
    return [
        {
            "state": state,
            "rows": [
                {
                    "complexity": number(point.get("complexity")),
                    "mse": number(point.get("mse"), 3),
                    "expression": point.get("expression"),
                    "pick": is_pick(point, equations.get(state, {})),
                }
                for point in points
            ],
        }
        for state, points in (document.get("pareto") or {}).items()
    ]
