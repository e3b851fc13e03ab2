"""Tables of many diagnoses: the rate of two workers, and what survives a kill."""

from __future__ import annotations

from typing import Any

from docs.generate.tables import RESULTS, number, result, source, table

NAME, COMMAND = "batch_rate", "python -m benchmarks.batch_rate"


def _measured() -> Any:
    """Return the result, None where it has not been measured yet."""
    return result("batch_rate") if (RESULTS / f"{NAME}.json").exists() else None


def passes() -> str:
    """Return a row for every pass that was timed."""
    found = _measured()
    if found is None:
        return f"Not measured yet: `{COMMAND}`."
    rows = [
        [
            words,
            found["count"],
            number(found[key]["seconds"]),
            number(found["one"]["seconds"] / found[key]["seconds"]),
            number(found[key]["tree_mib"]),
            number(found[key]["process_mib"]),
            found["ended_by_budget"][key],
        ]
        for key, words in (("one", "one process after another"), ("two", "two workers"))
    ]
    header = ["", "cases", "seconds", "rate", "MiB at most", "of one process", "ended by budget"]
    return table(header, rows)


def kept() -> str:
    """Return what the passes agree in, and what a kill cost, a sentence each."""
    found = _measured()
    if found is None:
        return ""
    unlike, kills = found["differing"], found["killed"]
    return (
        f"Cases whose files are not those of the first pass: {len(unlike['two'])} of two workers, "
        f"{len(unlike['killed'])} of the pass with kills, {len(unlike['alone'])} of "
        f"{found['alone']} that `jaxsr diagnose` made by itself. Of the pass with kills "
        f"{kills['lost']} cases were lost and {len(kills['done_twice'])} done twice."
    )


def origin() -> str:
    """Return where the figures are from."""
    return "" if _measured() is None else source(NAME, COMMAND)
