"""Tables of the results of `discover` and of the evaluation, from the committed JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

from docs.generate.tables import number, percent, result, table


def odebench_table() -> str:
    """Return ODEBench by method and noise."""
    rows = []
    for name, row in result("odebench")["summary"].items():
        if row["runs"]:
            rows.append(
                (
                    name,
                    row["runs"],
                    *(percent(row[k]) for k in ("reconstruction", "generalisation")),
                    percent(row["exact"]),
                    number(row["median_seconds_an_equation"]),
                )
            )
    head = ["method, noise", "runs", "training run simulated", "unseen run simulated"]
    return table([*head, "exact structure", "s an equation, median"], rows)


def two_mass_table() -> str:
    """Return the two-mass chain beside its peers."""
    rows = []
    for case in ("forces_unknown", "force_given"):
        for method, row in result("two_mass")[case]["summary"].items():
            error = number(row["largest_constant_error"], 2)
            rows.append(
                (
                    case.replace("_", " "),
                    method,
                    f"{row['exact']} of {row['of']}",
                    error,
                    number(row["median_seconds"]),
                )
            )
    head = ["case", "method", "exact structure", "largest error of a constant"]
    return table([*head, "s, median"], rows)


def sizes_table() -> str:
    """Return the two-mass chain from few samples."""
    rows = [
        (
            row["samples"],
            f"{row['exact']} of {row['of']}",
            number(row["median_e_T"], 2),
            number(row["paper"]["e_T"], 2),
            number(row["median_seconds"]),
        )
        for row in result("sample_sizes")["table"]
    ]
    return table(["samples", "exact structure", "training error", "paper's", "s, median"], rows)


def noise_table() -> str:
    """Return the two-mass chain with noise on every column."""
    rows = [
        (
            row["decibels"],
            row["data"],
            f"{row['exact']} of {row['of']}",
            f"{number(row['median_percent_of_rms'])} %",
            f"{number(row['largest_percent_of_rms'])} %",
        )
        for row in result("noise")["table"]
    ]
    head = ["dB", "data", "exact structure", "error of accelerations, median"]
    return table([*head, "largest"], rows)


def slider_table() -> str:
    """Return the crank-slider beside its peers."""
    rows = []
    for method, row in result("crank_slider")["summary"].items():
        found = f"{row['found']} of {row['of']}" if "found" in row else "-"
        terms = number(row.get("median_terms", row.get("terms")))
        rows.append(
            (method, found, number(row["mean_rss"]), terms, number(row.get("median_seconds")))
        )
    return table(["method", "law found", "mean RSS", "terms", "s, median"], rows)


def chain() -> Mapping[str, Any]:
    """Return the summary of the chain of 25 masses."""
    return result("chain")["summary"]


def hybrid_table() -> str:
    """Return the systems that switch."""
    data = result("hybrid")
    cases = {"sliding mass with friction (paper's example iii)": data["example_iii"]}
    cases |= data["others"]
    cases |= {f"the same at {n} dB": data[f"example_iii_{n}_dB"] for n in (40, 30)}
    cases["a contact visited for 3 % of the samples"] = data["rare_mode"]
    rows = [
        (
            name,
            _right(runs, "success"),
            _right(runs, "exact"),
            _largest(runs, "guard_error"),
            _largest(runs, "free_run"),
            number(median(r["seconds"] for r in runs)),
        )
        for name, runs in cases.items()
    ]
    head = ["system", "modes, guards and laws right", "all laws exact", "guard off by, largest"]
    return table([*head, "free run off by, largest", "s, median"], rows)


def _right(runs: Sequence[Mapping[str, Any]], key: str) -> str:
    return f"{sum(bool(r[key]) for r in runs)} of {len(runs)}"


def _largest(runs: Sequence[Mapping[str, Any]], key: str) -> str:
    values = [r[key] for r in runs if r.get("success") and r.get(key) is not None]
    return number(max(values), 2) if values else "-"


def displacement_table() -> str:
    """Return example iii from the displacement alone."""
    rows = [
        (r["seed"], r["modes"], ", ".join(r["guards"]) or "-", f"`{r['found']}`")
        for r in result("hybrid")["displacement_only"]
    ]
    return table(["seed", "modes", "guards", "found"], rows)


def peers_table() -> str:
    """Return k-means clusters and pysindy on the systems that switch."""
    rows = [
        (name, percent(row["purity"]), ", ".join(number(e, 2) for e in row["law_errors"]))
        for name, row in result("hybrid")["baselines"].items()
        if "purity" in row
    ]
    return table(["system; k-means and pysindy", "purity of clusters", "errors of the laws"], rows)


def smooth_traps() -> tuple[int, int]:
    """Return how many smooth systems stay one law, of how many."""
    runs = result("hybrid")["traps"]
    return sum(r["modes"] == 1 for r in runs), len(runs)


def no_law_table() -> str:
    """Return what is claimed of recordings with and without a law."""
    s = result("no_law")["summary"]
    rows = [
        ("recordings without a law: claimed all the same", f"{s['claimed']} of {s['without_law']}"),
        ("recordings with a law: lost", f"{s['lost']} of {s['with_law']}"),
        ("of these, one of several laws that fit", s["several"]),
    ]
    return table(["", "count"], rows)


def throughput_table() -> str:
    """Return the throughput of raw evaluation beside pyoperon."""
    runs = result("throughput")["raw"]["runs"]
    distinct = {r["rows"]: r for r in runs if r["population"] == "distinct"}
    rows = []
    for r in (r for r in runs if r["population"] == "random"):
        low, high = (number(r["paired_ratio"][k]) for k in ("quartile_1", "quartile_3"))
        ratio = f"{number(r['paired_ratio']['median'])} [{low}, {high}]"
        other = number(distinct[r["rows"]]["paired_ratio"]["median"])
        speeds = (number(r[k]["median"] / 1e9, 2) for k in ("ours", "pyoperon", "gplearn", "naive"))
        rows.append((f"{r['rows']:,}", *speeds, ratio, other))
    head = ["rows", "jaxsr", "pyoperon", "gplearn", "stack machine under vmap"]
    return table([*head, "jaxsr / pyoperon, quartiles", "where no subtree recurs"], rows)


DATA_SHEET = {"NVIDIA H100 80GB HBM3": 3.35e12}
"""Bytes a second that makers state for their memory."""


def gpu_table() -> str:
    """Return the throughput of raw evaluation on one GPU, beside the CPU of its machine."""
    data = result("throughput_gpu")
    stated = DATA_SHEET.get(data["device"])
    rows = []
    for p in data["points"]:
        speeds = (number(p[k]["median"] / 1e9) for k in ("kept", "brought", "cpu"))
        share = percent(p["share_of_bandwidth_bound"], 2)
        bound = p["bound"] * (stated or 0.0) / data["copy_bytes_per_second"]
        largest = percent(p["kept"]["median"] / bound, 2) if bound else "-"
        rows.append((f"{p['rows']:,}", f"{p['terms']:,}", *speeds, share, largest))
    head = ["rows", "terms", "columns left on the GPU", "brought to the host"]
    head.append(f"CPU, {data['cpu_threads']} threads")
    return table([*head, "share of a copy's bandwidth", "of what the data sheet states"], rows)


def gpu_generations_table() -> str:
    """Return the time of a search's generations on one GPU and on the CPU of its machine."""
    data = result("throughput_gpu")
    found = {(row["rows"], row["kind"]): row for row in data["generations"]}
    rows = []
    for count in sorted({row["rows"] for row in data["generations"]}):
        pair = [found.get((count, kind)) for kind in ("kept", "cpu")]
        cells = [
            number(part)
            for row in pair
            for part in ((row["first"], row["each"][0], row["generation"]) if row else [None] * 3)
        ]
        rate = number(1.0 / pair[0]["generation"]) if pair[0] else "-"
        rows.append((f"{count:,}", *cells, rate))
    head = [
        f"s {what}, {where}" for where in ("GPU", "CPU") for what in ("to begin", "first", "later")
    ]
    return table(["rows", *head, "generations a second, GPU"], rows)


def gpu_memory() -> str:
    """Return a sentence about columns that are larger than the GPU's memory."""
    data = result("throughput_gpu")
    large, name = result("throughput_gpu")["too_large"], data["device"]
    size, memory = (large[k] / 2**30 for k in ("answer_bytes", "memory_bytes"))
    return (
        f"Sums of {large['terms']:,} columns on {large['rows']:,} rows, {size:.0f} GiB together, "
        f"on one {name} of whose memory JAX had {memory:.0f} GiB: {large['seconds']:.2f} s."
    )


def before_after_table() -> str:
    """Return the time to the exact structure before and after the evaluator was rebuilt."""
    data = result("before_after")
    rows = [
        (
            case.replace("_", " "),
            number(median(row["before"]["seconds"])),
            number(median(row["now"]["seconds"])),
            number(row["ratio_of_medians"]),
        )
        for case, row in data.items()
        if isinstance(row, dict) and "ratio_of_medians" in row
    ]
    return table(["case", f"s before (`{data['commit_before']}`)", "s now", "ratio"], rows)


def smoothing_table() -> str:
    """Return how often each way to differentiate is within 1.3 of the best."""
    data = result("derivatives")
    values, rates = (data[f"{k}_within_1.3_of_best"] for k in ("value", "derivative"))
    rows = [(n, percent(values.get(n), 2), percent(rates.get(n), 2)) for n in {**values, **rates}]
    return table(["method", "values within 1.3 of the best", "derivatives within 1.3"], rows)


def constants_table() -> str:
    """Return the ways to refine the constants inside terms."""
    rows = [
        (r["case"], r["method"], percent(r["success_rate"], 2), number(r["time_ratio"]))
        for r in result("constants")["runs"]
    ]
    return table(["case", "method", "found", "time over Levenberg-Marquardt's"], rows)
