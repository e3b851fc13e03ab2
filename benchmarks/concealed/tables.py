"""Scores as Markdown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.concealed.rates import Rate

ROWS = (
    ("answered", "answered"),
    ("verdict", "verdict right"),
    ("verdict_detectable", "verdict right, detectable cases"),
    ("false_discoveries", "false discoveries (nothing, parameter, measurement)"),
    ("wrong_findings", "findings that name nothing planted"),
    ("site_top1", "site, first answer"),
    ("site_top3", "site, first three"),
    ("mechanism_top1", "mechanism, first answer"),
    ("mechanism_top3", "mechanism, first three"),
    ("effects_named", "planted effects named"),
    ("interval_coverage", "95 % intervals that cover"),
    ("under_60_s", "under 60 s"),
)
NUMBERS = (
    ("held_out_gain_median", "held-out gain, median"),
    ("gap_closed_median", "gap closed, median"),
    ("gap_closed_cases", "cases with a gap"),
    ("seconds_median", "seconds, median"),
)


def rate_text(document: Mapping[str, Any]) -> str:
    """Return a rate for a table."""
    return Rate(document["k"], document["n"]).text()


def _number(x: float | int | None) -> str:
    return "none" if x is None else f"{x:.3g}"


def markdown(document: Mapping[str, Any]) -> str:
    """Return the scores of all methods, then what each got wrong."""
    plan, methods = document["plan"], document["methods"]
    head = document["sealed"]
    lines = [
        "# Planted cases",
        "",
        f"{plan['cases']} cases from seed {head['seed']} (truth SHA-256 "
        f"{head['truth_sha256']}), {len(plan['systems'])} systems, "
        f"{len(plan['mechanisms'])} mechanisms; {plan['detectable']} detectable, "
        f"{plan['multibody']} coupled bodies, {plan['closed_loop']} in closed loop, "
        f"{plan['masked']} given as re-calibrated with the effect. Rates over detectable cases "
        "unless named otherwise; brackets: 95 % Wilson intervals.",
        "",
        "| | " + " | ".join(methods) + " |",
        "|---|" + "---|" * len(methods),
    ]
    for key, label in ROWS:
        cells = [rate_text(m[key]) for m in methods.values()]
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    for key, label in NUMBERS:
        lines.append(f"| {label} | " + " | ".join(_number(m[key]) for m in methods.values()) + " |")
    for name, method in methods.items():
        lines += ["", f"## {name}", "", "Verdict by kind of case:", ""]
        lines += [f"- {k}: {rate_text(r)}" for k, r in method["verdict_by_kind"].items()]
        lines += ["", "| family | mechanism, first | size at 50 % | at 95 % |", "|---|---|---|---|"]
        for family, at in method["detection"].items():
            named = method["mechanism_top1_by_family"].get(family)
            sizes = [f"{100 * at[k]:.2g} %" if at and k in at else "-" for k in ("50 %", "95 %")]
            first = rate_text(named) if named else "no cases"
            lines.append(f"| {family} | {first} | {sizes[0]} | {sizes[1]} |")
        lines += ["", "| stated probability | mean | right |", "|---|---|---|"]
        for row in method["probabilities"]:
            lines.append(
                f"| {row['from']:g} to {row['to']:g} | {row['stated']:.2f} "
                f"| {rate_text(row['right'])} |"
            )
    lines += ["", "## Failures"]
    for name, method in methods.items():
        lines += ["", f"### {name}", "", "| case | kind | truth | size | right | answer |"]
        lines.append("|---|---|---|---|---|---|")
        for f in method["failures"]:
            seen = "" if f["detectable"] else " (below detection)"
            lines.append(
                f"| {f['case']} | {f['kind']} | {f['truth']}{seen if f['size'] else ''} "
                f"| {100 * f['size']:.2g} % | {' or '.join(f['expected'])} | {f['answer']} |"
            )
    return "\n".join(lines) + "\n"
