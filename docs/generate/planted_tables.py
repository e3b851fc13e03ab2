"""Tables of planted machines: what is told of each, by ways of the engine."""

from __future__ import annotations

from typing import Any

from docs.generate.tables import result, table


def unread_table() -> str:
    """Return machines of which no sensor reads the positions, with starts sought and left."""
    found = result("unread_positions")
    rows: dict[str, dict[tuple[str, bool], str]] = {}
    for row in found["rows"]:
        state = "right" if row["right"] else f"{row['verdict']}: {row['mechanism'] or '-'}"
        rows.setdefault(row["machine"], {})[row["way"], row["lacking"]] = state
    ways = [(way, lacking) for way in found["summary"] for lacking in (True, False)]
    head = [f"{way}, {'an effect left out' if lacking else 'nothing'}" for way, lacking in ways]
    body = [(name, *(row.get(way, "-") for way in ways)) for name, row in rows.items()]
    count = [f"{c['right']} of {c['of']}" for c in found["summary"].values()]
    body.append(("right", *(part for c in count for part in (c, ""))))
    return table(["machine", *head], body)


def nameless_table() -> str:
    """Return laws that are none of those offered: all that err alike weighed, and one of each."""
    found = result("nameless_laws")
    rows: dict[str, dict[str, Any]] = {}
    for row in found["rows"]:
        rows.setdefault(row["machine"], {})[row["way"]] = row
    body = []
    for name, by_way in rows.items():
        cells = []
        for way in found["summary"]:
            row = by_way[way]
            told = " + ".join(dict.fromkeys(mechanism for mechanism, _ in row["findings"]))
            cells.append("right" if row["right"] else f"{row['verdict']}: {told or '-'}")
        left = by_way["laws written"]["left"]
        body.append((name, *cells, "no free run" if left is None else f"{left:.3f}"))
    for part in ("seen", "held out"):
        count = [f"{c[part]['right']} of {c[part]['of']}" for c in found["summary"].values()]
        left = found["summary"]["laws written"][part]["left"]
        middle = "no free run" if left is None else f"{left:.3f}"
        body.append((f"right, machines {part}", *count, f"median {middle}"))
    return table(["machine", *found["summary"], "error left, held out"], body)


def saturated_table() -> str:
    """Return what is told of sensors at their limits, with readings there censored or not."""
    found = result("saturated_sensors")
    rows: dict[tuple[str, str], dict[tuple[str, bool], str]] = {}
    for row in found["rows"]:
        told = " + ".join(mechanism for mechanism, _ in row["findings"])
        cell = "right" if row["right"] else f"{row['verdict']}: {told or '-'}"
        rows.setdefault((row["machine"], row["ends"]), {})[row["way"], row["lacking"]] = cell
    ways = [(way, lacking) for way in found["summary"] for lacking in (False, True)]
    head = [f"{way}{', a law missing' if lacking else ''}" for way, lacking in ways]
    body = [(*key, *(cells[way] for way in ways)) for key, cells in rows.items()]
    for part in ("seen", "held out"):
        count = [f"{c[part]['right']} of {c[part]['of']}" for c in found["summary"].values()]
        body.append((f"right, machines {part}", "", *(x for c in count for x in (c, ""))))
    return table(["machine", "limited at", *head], body)


def values_table(name: str) -> str:
    """Return what is told of machines whose values are wrong, nothing missing or one law."""
    found = result(name)
    rows: dict[str, dict[tuple[str, bool], str]] = {}
    for row in found["rows"]:
        told = " + ".join(mechanism for mechanism, _ in row["findings"])
        cell = "right" if row["right"] else f"{row['verdict']}: {told or '-'}"
        rows.setdefault(row["machine"], {})[row["way"], row["lacking"]] = cell
    ways = [(way, lacking) for way in found["summary"] for lacking in (False, True)]
    head = [f"{way}{', a law missing' if lacking else ''}" for way, lacking in ways]
    body = [(machine, *(cells[way] for way in ways)) for machine, cells in rows.items()]
    for part in ("seen", "held out"):
        count = [f"{c[part]['right']} of {c[part]['of']}" for c in found["summary"].values()]
        body.append((f"right, machines {part}", *(x for c in count for x in (c, ""))))
        inside = [
            f"{c[part]['values inside']} of {c[part]['values']}" for c in found["summary"].values()
        ]
        body.append((f"values inside, machines {part}", *(x for c in inside for x in (c, ""))))
    return table(["machine", *head], body)
