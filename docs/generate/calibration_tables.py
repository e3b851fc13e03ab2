"""Tables of stated probabilities against frequencies, in and out of what rules were settled on."""

from __future__ import annotations

from docs.generate.tables import number, of, percent, result, table

_GROUPS = {
    "verdict": "verdict right",
    "false_discovery": "false discoveries, no physics missing",
    "site": "site, first answer",
    "mechanism_first": "mechanism, first answer",
    "mechanism_among_three": "mechanism, first three",
    "interval_coverage": "95 % intervals that cover",
    "right_where_sure": "right where the stated probability is above 0.95",
}
_ERRORS = {
    "calibration_error": "expected calibration error",
    "calibration_error_by_chance": "the same of right probabilities, 19 times of 20 at most",
}
_PARTS = ("in-group", "out-of-group")


def evidence_table() -> str:
    """Return the reliability of stated probabilities, a row a bin."""
    low, rows = 0.0, []
    for row in result("evidence_calibration")["summary"]["reliability"]:
        at = number(row["stated"], 2), percent(row["right"], 2)
        rows.append((f"{number(low)} to {number(row['up_to'])}", *at, row["count"]))
        low = row["up_to"]
    return table(["stated probability", "mean", "right", "statements"], rows)


def evidence_sentence() -> str:
    """Return the rest of what was counted, in a sentence."""
    found = result("evidence_calibration")["summary"]
    first, claims, covered = (
        "{} of {}".format(*found[key])
        for key in ("first_right", "claims_where_nothing_is", "covered")
    )
    return (
        f"The first answer is right in {first} cases; where nothing is missing, something is "
        f"claimed in {claims}; {covered} intervals of 95 % cover; the expected calibration error "
        f"is {number(found['expected_calibration_error'], 2)}."
    )


def groups_table() -> str:
    """Return rates in and out of the groups that numbers were settled on, by way to decide."""
    found = result("generality")["common"]
    heads = [f"{engine}, {part}" for engine in found for part in _PARTS]
    cells = [parts[part] for parts in found.values() for part in _PARTS]
    rows = [(label, *(of(c[key]) for c in cells)) for key, label in _GROUPS.items()]
    for key, label in _ERRORS.items():
        rows.append((label, *(number(c[key], 2) for c in cells)))
    rows.append(("cases", *(c["cases"] for c in cells)))
    rows.append(("gap closed, median", *(percent(c["gap_closed_median"]) for c in cells)))
    return table(["", *heads], rows)


def groups_missed_table() -> str:
    """Return the cases of the groups that were not right."""
    rows = [
        (row["case"], row["engine"], row["truth"], percent(row["size"], 2), row["answer"])
        for row in result("generality")["misses"]
    ]
    return table(["case", "decided by", "planted", "size of its force", "answer"], rows)
