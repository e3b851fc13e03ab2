"""Tables in Markdown, and numbers as a reader wants them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "benchmarks" / "results"


def result(name: str) -> Any:
    """Return a committed result, ``benchmarks/results/NAME.json``."""
    return json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))


def unlisted() -> list[tuple[str, str]]:
    """Return results that no page tables, with what they say they are."""
    code = "".join(
        p.read_text(encoding="utf-8")
        for p in Path(__file__).parent.rglob("*.*")
        if p.suffix in (".py", ".j2")
    )
    found = []
    for path in sorted(RESULTS.rglob("*.json")):
        name = path.relative_to(RESULTS).with_suffix("").as_posix()
        if f'"{name}"' not in code and name != "concealed/sealed":
            document = result(name)
            title = document.get("case") if isinstance(document, dict) else None
            found.append((name, f": {title}" if title else ""))
    return found


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(_cell(c) for c in line) + " |" for line in lines)


def _cell(value: Any) -> str:
    text = str(value).replace("|", "\\|").replace("\n", " ")
    return text if "`" in text else text.replace("*", "\\*")


def number(value: float | None, digits: int = 3) -> str:
    """Return a number to significant digits, ``-`` where there is none."""
    if value is None:
        return "-"
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < 1e6 else text


def percent(value: float | None, digits: int = 3) -> str:
    """Return a share in percent."""
    return "-" if value is None else f"{number(100.0 * value, digits)} %"


def of(row: Mapping[str, Any]) -> str:
    """Return a rate as ``96 % [90, 98] (96 of 100)``, the brackets its 95 % Wilson interval."""
    if not row["n"]:
        return "no cases"
    low, high = (f"{100 * x:.0f}" for x in row["wilson95"])
    return f"{100 * row['rate']:.0f} % [{low}, {high}] ({row['k']} of {row['n']})"


def constants(finding: Mapping[str, Any]) -> str:
    """Return the constants of a finding with their intervals and units."""
    parts = []
    for name, row in finding["parameters"].items():
        unit = "" if row.get("unit") in (None, "1") else row["unit"]
        low, high = (number(x, 4) for x in row["ci95"])
        parts.append(f"{name} = {number(row['value'], 4)} [{low}, {high}] {unit}".strip())
    return ", ".join(parts)


def answer(findings: Sequence[Mapping[str, Any]], digits: int = 2) -> str:
    """Return findings in a line: mechanism, place, constants, probability."""
    return (
        "; ".join(
            f"{f['mechanism']} at {f['site']} ({constants(f)}; {f['probability']:.{digits}f})"
            for f in findings
        )
        or "-"
    )


def origin(document: Mapping[str, Any]) -> str:
    """Return what a result says of where it comes from: commit, versions, machine, load."""
    versions = document.get("versions") or document.get("provenance") or {}
    commit = versions.get("commit")
    seeds = document.get("seeds", [versions.get("seed", 0)])
    load = document.get("load_average")
    parts = [
        f"commit `{commit}`" if commit else "commit not stated",
        f"jax {versions.get('jax', '-')}, numpy {versions.get('numpy', '-')}",
        document.get("machine") or versions.get("machine", "-"),
        f"{len(seeds)} seeds" if len(seeds) > 1 else f"seed {seeds[0]}",
    ]
    return "; ".join(parts) + (f"; load average {load[0]}" if load else "")


def source(name: str, command: str) -> str:
    """Return the line below a table: the file, the command that writes it, and its origin."""
    return f"*From `benchmarks/results/{name}.json` (`{command}`): {origin(result(name))}.*"
