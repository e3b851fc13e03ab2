"""Tables of live use: false alarms, and how soon changes are noticed."""

from __future__ import annotations

from docs.generate.tables import number, result, source, table

NAME, COMMAND = "monitor", "python -m benchmarks.monitor"


def false_alarms() -> str:
    """Return a row for every machine in normal running, and their sum."""
    rows = result("monitor")["normal"]
    lines = [
        [
            row["plant"],
            number(row["hours"], 4),
            row["blocks"],
            number(row["stated_per_hour"] * row["hours"]),
            row["alarms"],
            ", ".join(number(x) for x in row["exponents"]),
        ]
        for row in rows
    ]
    hours, alarms = sum(r["hours"] for r in rows), sum(r["alarms"] for r in rows)
    allowed = sum(r["hours"] * r["stated_per_hour"] for r in rows)
    blocks = sum(r["blocks"] for r in rows)
    lines.append(["all", number(hours, 4), blocks, number(allowed), alarms, ""])
    header = ["machine", "hours", "blocks", "false alarms stated", "raised", "exponents"]
    return table(header, lines)


def delays() -> str:
    """Return a row for every effect."""
    rows = []
    for row in result("monitor")["effects"]:
        places = row["first_suspects"]
        suspects = ", ".join(f"`{site}` {count}" for site, count in places.items())
        noticed = f"{row['noticed']} of {row['runs']}"
        times = [number(row[key]) for key in ("median_s", "ninth_decile_s", "block_s")]
        rows.append([row["plant"], row["effect"], noticed, *times, row["before"], suspects])
    return table(
        [
            *("machine", "effect", "noticed", "median in s", "nine of ten within, in s"),
            *("block in s", "alarms before", "first suspect"),
        ],
        rows,
    )


def origin() -> str:
    """Return where the figures are from."""
    return source(NAME, COMMAND)
