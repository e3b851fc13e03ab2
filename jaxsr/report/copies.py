"""Texts that the buttons of a report copy: an edit, a command, a few lines of Python."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jaxsr.report.diff import entry_text


def edit_text(edit: Mapping[str, Any]) -> str:
    """Return an edit as lines of a model file, table by table."""
    tables: dict[str, list[str]] = {}
    for key, value in edit.items():
        table, _, name = key.partition(".")
        if not name:
            table, name = "model", key
        tables.setdefault(table, []).append(f"{name} = {entry_text(value)}")
    return "\n".join(line for name, rows in tables.items() for line in (f"[{name}]", *rows))


def python_text(document: Mapping[str, Any]) -> str:
    """Return the lines that load the results and run the explained model.

    ``{folder}`` is where the report lies, which its script knows.
    """
    files = list((document.get("provenance") or {}).get("data_sha256") or {})
    recording = files[0] if files else "run1.csv"
    return (
        "import jaxsr\n\n"
        'found = jaxsr.load("{folder}")\n'
        "print(found)\n"
        f'run = found.explained.simulate(jaxsr.read_recording("{recording}"))\n'
    )
