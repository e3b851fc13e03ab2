"""Tables of the results of `diagnose`, from the committed JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from statistics import median
from typing import Any

from docs.generate.tables import answer, constants, number, of, origin, percent, result, table

DRAG = {"viscous_damping", "quadratic_drag", "power_law_drag"}
DENSE = ("bowling_ball", "golf_ball", "baseball")
TITLES = {
    "emps": "EMPS drive",
    "silverbox": "Silverbox",
    "balls": "Falling balls",
    "ur10e": "UR10e, joint 1",
    "dfki": "DFKI pendulum",
    "tanks": "Cascaded tanks",
    "bam": "XL330 servo",
    "ced": "Coupled drives",
    "go2": "Go2 leg",
    "kvlcc2": "KVLCC2 roll decay",
    "pendula": "Multi-arm pendulum",
    "tx40": "TX40 arm",
}
LATER = ("bam", "ced", "go2", "kvlcc2", "pendula", "tx40")
"""Sets that were added after the engine's decision was settled on the others."""
FIRST = tuple(case for case in TITLES if case not in LATER)


def real() -> Mapping[str, Any]:
    """Return the cases of the real recordings."""
    return result("real_recordings")["cases"]


def headline(fit: Mapping[str, Any] | None) -> str:
    """Return re-calibrated and explained free-run errors at the headline horizon, held out."""
    if not fit:
        return "-"
    held = fit["held_out"] or fit["train"]
    at = fit["horizons_s"].index(fit["headline_s"])
    where = "held out" if fit["held_out"] else "training"
    before, after = held["recalibrated"][at], held["explained"][at]
    return f"{percent(before)} → {percent(after)} over {number(fit['headline_s'])} s ({where})"


def force(fit: Mapping[str, Any] | None) -> str:
    """Return the held-out force errors, re-calibrated and explained, by equation."""
    rows = (fit or {}).get("force") or {}
    parts = []
    for site, row in rows.items():
        held = row["held_out"] or row["train"]
        if held["recalibrated"] is not None:
            parts.append(f"{site}: {percent(held['recalibrated'])} → {percent(held['explained'])}")
    return "; ".join(parts) or "-"


def real_table(cases: tuple[str, ...]) -> str:
    """Return verdict, findings and errors of real recordings."""
    rows = []
    for case in cases:
        for name, found in real()[case]["diagnoses"].items():
            title = TITLES[case] if len(real()[case]["diagnoses"]) == 1 else name.replace("_", " ")
            verdict = found["verdict"] or found["failure"]
            said = answer(found.get("findings", ()))
            errors = headline(found.get("fit")), force(found.get("fit"))
            rows.append((title, verdict, said, *errors, f"{found['seconds']:.0f}"))
    head = ["recording", "verdict", "findings (95 % interval; probability)"]
    return table([*head, "free run, NRMSE", "force error", "s"], rows)


def checks_table(cases: tuple[str, ...]) -> str:
    """Return the targets that were stated beforehand, and whether they are met."""
    rows = [
        (TITLES[case], c["what"], c["target"], c["value"] or "none", "yes" if c["met"] else "no")
        for case in cases
        for c in real()[case]["checks"]
    ]
    return table(["recording", "what", "target", "found", "met"], rows)


def met(cases: tuple[str, ...]) -> tuple[int, int]:
    """Return how many stated targets are met, and how many there are."""
    every = [c["met"] for case in cases for c in real()[case]["checks"]]
    return sum(every), len(every)


def tanks() -> Mapping[str, float]:
    """Return the free-run errors of the tanks' level in V."""
    return real()["tanks"]["figures"]["validation_rmse_V"]


def arrow() -> Mapping[str, float]:
    """Return the free-run errors of the Silverbox's arrow in mV."""
    return real()["silverbox"]["figures"]["arrow_rmse_mV"]


def arm() -> Mapping[str, Any]:
    """Return the diagnosis of the six joints of the UR10e."""
    return result("ur10e_arm")["diagnosis"]


def scored_set() -> Mapping[str, Any]:
    """Return the sealed set that the detailed score is of."""
    truth = result("concealed/score")["sealed"]["truth_sha256"]
    return next(s for s in result("concealed/sets") if s["truth_sha256"] == truth)


def origins_table() -> str:
    """Return which engine each row of the real recordings is of."""
    return table(
        ["recording", "what the file says of its engine"],
        [(TITLES[case], origin(row)) for case, row in real().items()],
    )


def trap_table() -> str:
    """Return how sets of mechanisms rank on EMPS at several horizons."""
    figures = real()["emps"]["figures"]["trap_rmse_mm"]
    at = [f"{h} s" if not isinstance(h, str) else h for h in figures["horizons_s"]]
    rows = [(n, *map(number, v)) for n, v in figures.items() if n != "horizons_s"]
    return table(["added to EMPS; position error in mm over", *at], rows)


def balls() -> dict[str, Any]:
    """Return how often drag is found, on light balls and on dense ones."""
    found = real()["balls"]["diagnoses"]
    named = {n: {f["mechanism"] for f in d["findings"]} for n, d in found.items()}
    light = [n for n in found if n not in DENSE]
    right = sum(found[n]["verdict"] == "structure" and bool(named[n] & DRAG) for n in light)
    dense = Counter(found[n]["verdict"] for n in DENSE)
    return {"right": right, "light": len(light), "dense": dict(dense)}


def arm_table() -> str:
    """Return the six joints of the UR10e in one model."""
    found = result("ur10e_arm")["diagnosis"]
    by_joint: dict[str, list[str]] = {}
    for f in found["findings"]:
        text = f"{f['mechanism']} ({constants(f)}; {f['probability']:.2f})"
        by_joint.setdefault(f["site"], []).append(text)
    rows = []
    for site, row in sorted(found["fit"]["force"].items()):
        held = row["held_out"]
        error = f"{percent(held['recalibrated'])} → {percent(held['explained'])}"
        rows.append((site, "; ".join(by_joint.get(site, ["-"])), error))
    return table(["joint", "findings (95 % interval; probability)", "force error, held out"], rows)


def arm_current_table() -> str:
    """Return errors of the current by joint with friction given, by least squares."""
    errors = result("ur10e_arm")["relative_current_error"]
    rows = [
        (law, file, *(percent(e) for e in joints))
        for law, files in errors.items()
        for file, joints in files.items()
    ]
    return table(["model", "file", *(f"joint {k}" for k in range(1, 7))], rows)


def arm_constants_table() -> str:
    """Return friction constants of the six joints beside the owners'."""
    found, owners = result("ur10e_arm")["constants"]["+ Coulomb"], result("ur10e_arm")["owners"]
    rows = [
        (name, who, *(number(x) for x in values[name]))
        for name in ("Fv", "Fc")
        for who, values in (("jaxsr", found), ("owners", owners))
    ]
    return table(["constant", "by", *(f"joint {k}" for k in range(1, 7))], rows)


def demo_table() -> str:
    """Return the four bundled demonstrations beside their truths."""
    rows = []
    for name, row in result("demo_sets")["sets"].items():
        truth = row["truth"]["mechanism"] or row["truth"]["verdict"]
        right = "all" if all(row["right"].values()) else "not all"
        rows.append((name, truth, answer(row["findings"]), right, number(row["seconds"])))
    return table(["set", "planted", "found", "verdict, mechanism, site, interval right", "s"], rows)


PLANTED = {
    "verdict right": ("verdict", "85 %"),
    "false discoveries, no physics missing": ("false_discoveries", "5 %"),
    "site, first answer": ("site_top1", "85 %"),
    "mechanism, first answer": ("mechanism_top1", "80 %"),
    "mechanism, first three": ("mechanism_top3", "95 %"),
    "95 % intervals that cover": ("interval_coverage", "90 to 98 %"),
    "below 60 s": ("under_60_s", "-"),
}


def planted_table() -> str:
    """Return the last sealed set: this tool beside three baselines."""
    methods = result("concealed/score")["methods"]
    order = ("jaxsr", "pysindy", "network", "recalibration")
    rows = [
        (label, aim, *(of(methods[m][key]) for m in order)) for label, (key, aim) in PLANTED.items()
    ]
    gaps = (percent(methods[m]["gap_closed_median"]) for m in order)
    rows.append(("gap closed to a fit told the truth, median", "90 %", *gaps))
    rows.append(("seconds, median", "-", *(number(methods[m]["seconds_median"]) for m in order)))
    return table(["", "aim", "jaxsr", "pysindy", "network", "re-calibration"], rows)


def families_table() -> str:
    """Return how often each family is named first, on the last sealed set."""
    rows = result("concealed/score")["methods"]["jaxsr"]["mechanism_top1_by_family"]
    return table(["family", "mechanism, first answer"], [(k, of(v)) for k, v in rows.items()])


def stated_table() -> str:
    """Return how often findings of a stated probability are right, on the last sealed set."""
    rows = result("concealed/score")["methods"]["jaxsr"]["probabilities"]
    body = [(f"{r['from']} to {r['to']}", number(r["stated"]), of(r["right"])) for r in rows]
    return table(["stated probability", "mean", "right"], body)


def failures_table() -> str:
    """Return what went wrong on the last sealed set."""
    rows = result("concealed/score")["methods"]["jaxsr"]["failures"]
    body = [(r["case"], r["truth"], percent(r["size"]), r["answer"]) for r in rows]
    return table(["case", "planted", "size of its force", "answer"], body)


def sets_table() -> str:
    """Return every sealed set in the order in which they were drawn, and their sums."""
    sets = result("concealed/sets")
    keys = [key for key, _ in PLANTED.values()]
    body = [
        (
            f"`{s['commit']}`",
            s["cases"],
            *(f"{s['counts'][k]['k']} of {s['counts'][k]['n']}" for k in keys),
        )
        for s in sets
    ]
    sums = [
        f"{sum(s['counts'][k]['k'] for s in sets)} of {sum(s['counts'][k]['n'] for s in sets)}"
        for k in keys
    ]
    body.append(("all", sum(s["cases"] for s in sets), *sums))
    return table(["engine", "cases", *PLANTED], body)


def last_two(key: str) -> tuple[int, int]:
    """Return hits and cases of the last two sealed sets."""
    counts = [s["counts"][key] for s in result("concealed/sets")[-2:]]
    return sum(c["k"] for c in counts), sum(c["n"] for c in counts)


def loop_table() -> str:
    """Return estimates of mass and damping in closed loop, by method, over the seeds."""
    rows = []
    for method, found in result("closed_loop")["planted"].items():
        for name, errors in found.items():
            spread = max(abs(e - median(errors)) for e in errors)
            rows.append((method, name, percent(median(errors)), percent(spread), len(errors)))
    return table(["method", "constant", "error, median", "farthest seed from it", "seeds"], rows)


def loop_emps_table() -> str:
    """Return EMPS with the recorded force and with the controller in the model."""
    found = result("closed_loop")["emps"]
    return table(["EMPS with", "found"], [(k, answer(v["findings"])) for k, v in found.items()])


def sensing_table() -> str:
    """Return the cases with sensors that engineers have."""
    rows = []
    for case, row in result("sensing")["summary"].items():
        covering = (
            f"{row['intervals_covering']} of {row['intervals']}" if "intervals" in row else "-"
        )
        rows.append((case, f"{row['right']} of {row['of']}", covering))
    return table(["case", "right", "intervals that cover"], rows)


def one_mode_table() -> str:
    """Return models that switch and lack an effect in one mode, in all, or in none."""
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in result("one_mode")["rows"]:
        groups.setdefault((row["system"], row["planted"]), []).append(row)
    body = []
    for (system, planted), rows in groups.items():
        covered = [r["covered"] for r in rows if r.get("covered") is not None]
        body.append(
            (
                system,
                planted,
                f"{sum(r['right'] for r in rows)} of {len(rows)}",
                f"{sum(covered)} of {len(covered)}" if covered else "-",
            )
        )
    return table(["system", "effect in", "right", "intervals that cover"], body)


def small_table() -> str:
    """Return the checks that are one line each."""
    units, cut = result("force_units"), result("cut_short")["summary"]
    gravity, names = result("gravity_fixed")["right"], result("naming")["summary"]
    lost, figures = result("lost_samples")["summary"], result("report_figures")["rows"]
    public = result("public_reports")["rows"]
    rows = [
        (
            "units of a force, however the equation is written",
            "force_units",
            f"unit right {units['unit_right']} of {units['models']}, "
            f"intervals that cover {units['covered']} of {units['models']}",
        ),
        (
            "gravity is held where a value beside it is wrong",
            "gravity_fixed",
            ", ".join(f"{k} {v} of 20" for k, v in gravity.items()),
        ),
        (
            "laws named, and laws left without a name",
            "naming",
            ", ".join(f"{k} {v[0]} of {v[1]}" for k, v in names.items()),
        ),
        (
            "a tenth of the samples lost; slow sensors: same findings",
            "lost_samples",
            ", ".join(f"{k} {v['same']} of {v['of']}" for k, v in lost.items()),
        ),
        (
            "a search cut at a tenth of its time",
            "cut_short",
            "{right} right, {abstains} abstain, {wrong} wrong of {runs}".format(**cut),
        ),
        (
            "figures of a report against closed forms",
            "report_figures",
            f"{sum(r['right'] for r in figures)} of {len(figures)}",
        ),
        (
            "inputs after public reports",
            "public_reports",
            f"{sum(r['right'] for r in public)} of {len(public)}; wrong: "
            + (", ".join(r["case"] for r in public if not r["right"]) or "none"),
        ),
    ]
    body = [(a, c, f"`{b}.json`: {origin(result(b))}") for a, b, c in rows]
    return table(["what", "result", "from"], body)
