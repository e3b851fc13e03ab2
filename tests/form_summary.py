"""What went wrong with forms, by kind."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from form_running import Outcome


def kind_of(problem: str) -> str:
    """Return the kind of a problem: its words without numbers and names."""
    head, _, rest = problem.partition(": ")
    if head in ("traceback", "warning"):
        return f"{head}: {rest.partition(': ')[0]}"
    return f"{head}: {re.sub(r'[-+]?[0-9][0-9.e+-]*', '#', rest)[:90]}"


def by_kind(outcomes: Sequence[Outcome]) -> dict[str, list[Outcome]]:
    """Group outcomes by the kinds of their problems, most frequent first."""
    found: dict[str, list[Outcome]] = defaultdict(list)
    for outcome in outcomes:
        for kind in dict.fromkeys(map(kind_of, outcome.problems)):
            found[kind].append(outcome)
    return dict(sorted(found.items(), key=lambda item: -len(item[1])))


def write_summary(outcomes: Sequence[Outcome], folder: Path) -> list[str]:
    """Write ``forms.json`` and ``forms.md``, and return a line for each kind of problem."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = [asdict(outcome) for outcome in outcomes]
    (folder / "forms.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")
    kinds = by_kind(outcomes)
    lines = [
        f"{len(found)} x {kind}\n    {'; '.join(o.label for o in found[:6])}"
        for kind, found in kinds.items()
    ]
    right = sum(not outcome.problems for outcome in outcomes)
    head = f"# Forms\n\n{right} of {len(outcomes)} right.\n\n"
    text = "".join(f"- {line}\n" for line in lines)
    (folder / "forms.md").write_text(head + text, encoding="utf-8")
    return lines
