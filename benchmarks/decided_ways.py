"""The decision three ways: as it stands, by the evidence alone, and by the contest alone.

    python -m benchmarks.decided_ways OUT.jsonl [--generality DIR ...] [--sensing SEED ...]
                    [--force-units] [--hidden NAME ...] [--skip PART ...] [--ways WAY ...]
                    [--budget SECONDS]
    python -m benchmarks.decided_ways OUT.jsonl     # the table of what is there

`today` is the decision of the commands. `evidence` takes the leading set of the posterior wherever
there is a posterior, whatever free runs say of it; it is run where `today` left that to the
contest. `contest` never looks at the posterior. Every answer is a line of OUT.jsonl with the most
probable sets, so that a run goes on where it stopped, and other rules can be tried on what is
there. Set JAXSR_CLOCK=processor: the budget is that of the processor then.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import jaxsr
from benchmarks.concealed.judging import judge
from benchmarks.force_plants import PLANTS, WAYS
from benchmarks.generality.scoring import settled_on
from benchmarks.hidden import cases as hidden_cases
from benchmarks.sensing import CASES, MUST, task
from jaxsr.diagnosis.likelihood.posterior import Posterior
from jaxsr.diagnosis.settled import verdicts_of
from jaxsr.models import parse_model

COURSE = importlib.import_module("jaxsr.diagnosis.diagnose")
PATCHED = ("weighed", "beyond_doubt", "borne_out")
SHOWN = 8
"""Sets of mechanisms that a line keeps."""
SEED = 0
Judged = tuple[bool, bool | None]
"""Whether the verdict is right, and the first finding; none where there is nothing to find."""


@dataclass(frozen=True, eq=False)
class Task:
    """A case with its judge, which reads a diagnosis."""

    name: str
    group: str
    truth: str
    simulator: Callable[[], jaxsr.Simulator]
    data: Callable[[], Sequence[Any]]
    judge: Callable[[Any], Judged]


class Way:
    """Puts another decision in the place of the diagnosis' own, and keeps what it saw."""

    def __init__(self, name: str, known: Posterior | None = None) -> None:
        self.name, self.known = name, known
        self.found: Posterior | None = None
        self.sure: bool | None = None
        self.borne: bool | None = None
        self.own: dict[str, Callable[..., Any]] = {}

    def __enter__(self) -> Way:
        self.own = {name: getattr(COURSE, name) for name in PATCHED}
        for name in PATCHED:
            setattr(COURSE, name, getattr(self, f"_{name}"))
        return self

    def __exit__(self, *_: object) -> None:
        for name, own in self.own.items():
            setattr(COURSE, name, own)

    @property
    def decided(self) -> bool:
        """Whether the posterior decided."""
        return self.borne is not None and (self.name != "today" or self.borne)

    def _weighed(self, case: Any) -> Posterior | None:
        if self.name != "contest":
            self.found = self.known or self.own["weighed"](case)
        return self.found

    def _beyond_doubt(self, found: Posterior) -> bool:
        self.sure = bool(self.own["beyond_doubt"](found))
        return self.sure or self.name != "today"

    def _borne_out(self, settled: Any) -> bool:
        self.borne = bool(self.own["borne_out"](settled))
        return self.borne or self.name != "today"


def generality(folder: Path) -> Iterator[Task]:
    """Cases of a folder of `benchmarks.generality`."""
    settled = settled_on()
    for place in sorted((folder / "cases").iterdir()):
        truth = json.loads((place / "truth.json").read_text(encoding="utf-8"))
        arguments = json.loads((place / "case.json").read_text(encoding="utf-8"))
        groups = truth["groups"]
        inside = all(groups[k] in settled[k] for k in settled)
        what = [f"{e['mechanism']}@{e['site']}" for e in truth["effects"]]

        def marked(found: Any, name: str = place.name, truth: Any = truth) -> Judged:
            mark = judge(name, truth, found.document)
            return mark.verdict_right, mark.mechanism_1

        yield Task(
            f"{folder.name}/{place.name}",
            "generality, in" if inside else "generality, out",
            " + ".join(what) or "nothing",
            partial(jaxsr.Simulator.from_file, place / arguments["model"]),
            partial(list, [place / n for n in arguments["data"]]),
            marked,
        )


def sensing(seeds: Sequence[int]) -> Iterator[Task]:
    """Cases of `benchmarks.sensing`."""
    for case, judged in CASES.items():
        for seed in seeds:
            job = task(case, seed)

            def marked(found: Any, judged: Any = judged, job: Any = job) -> Judged:
                right = judged(found, job.truth)
                rest = [right[k] for k in MUST if k in right and k != "verdict"]
                return right["verdict"], all(rest)

            truth = job.truth.get("mechanism") or job.truth.get("name") or "nothing"
            yield Task(
                f"{case} {seed}",
                "sensing",
                truth,
                partial(_read, job.model),
                partial(list, job.recordings),
                marked,
            )


def _read(text: str) -> jaxsr.Simulator:
    return jaxsr.Simulator(parse_model(text))


def force_units() -> Iterator[Task]:
    """Plants of `benchmarks.force_units`, each in one way of writing."""
    for k, plant in enumerate(PLANTS):
        way = WAYS[k % len(WAYS)]

        def marked(found: Any, plant: Any = plant) -> Judged:
            first = found.findings[0]["mechanism"] if found.findings else ""
            return found.verdict == "structure", first == plant.mechanism

        yield Task(
            f"{plant.name}, {way}",
            "force units",
            plant.mechanism,
            partial(jaxsr.Simulator, plant.model(way)),
            partial(plant.recordings, way, 100 * k + WAYS.index(way)),
            marked,
        )


def hidden(names: Sequence[str]) -> Iterator[Task]:
    """Cases of `benchmarks.hidden`."""
    for name, case in hidden_cases().items():
        if not any(part in name for part in names):
            continue

        def marked(found: Any, case: Any = case) -> Judged:
            first = [f"{f['mechanism']}@{f['site']}" for f in found.findings[:1]]
            if not case.truth:
                return found.verdict == "nothing", None
            sensor = "@output" in case.truth[0] and "drift" not in case.truth[0]
            expected = "measurement" if sensor else "structure"
            return found.verdict == expected, bool(first) and first[0] in case.truth

        def recorded(case: Any = case) -> list[Any]:
            return case.plant.records(np.random.default_rng(SEED), case.sensors, case.missing)

        truth = " or ".join(case.truth) or "nothing"
        model = case.plant.model(case.sensors)
        yield Task(name, "hidden", truth, partial(_read, model), recorded, marked)


def told(found: Posterior | None) -> dict[str, Any] | None:
    """Return what the posterior says, as plain values."""
    if found is None:
        return None
    leader, null = found.leader, next(h for h in found.hypotheses if not h.members)
    every = list(zip(found.hypotheses, found.probabilities, strict=True))
    mass: dict[str, float] = {}
    for h, p in every:
        key = "+".join(sorted(verdicts_of(found, h))) or "nothing"
        mass[key] = mass.get(key, 0.0) + float(p)
    sets = [
        {
            "labels": [found.candidates[i].label for i in h.members],
            "p": round(float(p), 6),
            "share": float(h.share),
            "settled": bool(h.settled),
        }
        for h, p in every[:SHOWN]
    ]
    return {
        "finished": found.finished,
        "settled": bool(leader.settled),
        "something_else": found.something_else,
        "left": float(leader.share / max(null.share, 1e-300)),
        "mass": {k: round(v, 6) for k, v in mass.items()},
        "sets": sets,
        "wrong": [(w.name, w.probability) for w in found.wrong],
    }


def answered(job: Task, way: str, known: Posterior | None, budget: float) -> tuple[dict, Way]:
    """Diagnose a case in one way; return its row."""
    seen, begin = Way(way, known), time.process_time()
    row: dict[str, Any] = {"case": job.name, "group": job.group, "truth": job.truth, "way": way}
    try:
        with warnings.catch_warnings(), seen:
            warnings.simplefilter("ignore")
            found = jaxsr.diagnose(job.simulator(), job.data(), seed=SEED, budget=budget)
        verdict, first = job.judge(found)
        row |= {
            "verdict": str(found.verdict),
            "findings": [
                [f"{f['mechanism']}@{f['site']}", round(f["probability"], 4)]
                for f in found.findings
            ],
            "verdict_right": bool(verdict),
            "first_right": first if first is None else bool(first),
        }
    except Exception:  # a case that breaks is a case that is wrong
        row |= {"verdict": "broke", "findings": [], "verdict_right": False, "first_right": False}
        row["error"] = traceback.format_exc(limit=-2)[-400:]
    row |= {"sure": seen.sure, "borne": seen.borne, "decided": seen.decided}
    row |= {"cpu_seconds": round(time.process_time() - begin, 1), "posterior": told(seen.found)}
    return row, seen


def run(jobs: Iterator[Task], ways: Sequence[str], out: Path, budget: float) -> None:
    """Answer what was not yet answered."""
    done = {(r["case"], r["way"]): r for r in rows_of(out)}
    with out.open("a", encoding="utf-8") as file:
        for job in jobs:
            known = None
            for way in ways:
                before = done.get((job.name, "today"))
                # Where the evidence decides today, it decides alone as well.
                same = before is not None and (before["decided"] or not before["posterior"])
                if (job.name, way) in done or (way == "evidence" and same):
                    continue
                row, seen = answered(job, way, known, budget)
                known = known or seen.found
                done[job.name, way] = row
                file.write(json.dumps(row) + "\n")
                file.flush()
                print(said(row), flush=True)


def rows_of(out: Path) -> list[dict[str, Any]]:
    """Return the lines of a file."""
    if not out.exists():
        return []
    return [json.loads(line) for line in out.read_text(encoding="utf-8").splitlines()]


def said(row: Mapping[str, Any]) -> str:
    """One line of a row."""
    marks = "".join("x" if m is False else "." for m in (row["verdict_right"], row["first_right"]))
    findings = ", ".join(f"{n} {p:.2f}" for n, p in row["findings"][:3])
    by = "evidence" if row["decided"] else "contest"
    return (
        f"{marks} {row['case'][:52]:52} {row['way']:8} by {by:8} {row['verdict']:14} "
        f"[{findings}] truth {row['truth']} ({row['cpu_seconds']} s)"
    )


def doubt_of(row: Mapping[str, Any]) -> str:
    """Say in a few words what the posterior left in doubt."""
    post = row["posterior"]
    if post is None:
        return "no posterior"
    top = max(post["mass"].values())
    parts = [] if post["finished"] else ["not finished"]
    parts += [] if post["settled"] else ["not at rest"]
    parts += [] if row["borne"] is not False else ["free run"]
    return (
        f"{', '.join(parts) or 'doubt'}; mass {top:.3f}, else {post['something_else']:.2f}, "
        f"left {post['left']:.2f}"
    )


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Cases left to the contest, both answers side by side, and rates by group and way."""
    by = {(r["case"], r["way"]): r for r in rows}
    lines = []
    for (case, way), row in by.items():
        if way != "today" or row["decided"]:
            continue
        lines.append(f"{case} ({row['truth']}): {doubt_of(row)}")
        for other in ("today", "evidence"):
            if (case, other) in by:
                lines.append("    " + said(by[case, other]))
    lines.append("")
    groups = list(dict.fromkeys(r["group"] for r in rows))
    for group in groups:
        for way in ("today", "evidence", "contest"):
            own = []
            for (case, w), row in by.items():
                if row["group"] != group or w != "today":
                    continue
                other = by.get((case, way))
                if other is None and way == "evidence":
                    other = row  # what decides today is the evidence, or there is none
                own += [other] if other is not None else []
            if own:
                first = [r["first_right"] for r in own if r["first_right"] is not None]
                undecided = sum(r["verdict"] == "undecided" for r in own)
                lines.append(
                    f"{group:16} {way:8} verdict {sum(r['verdict_right'] for r in own)} of "
                    f"{len(own)}, first finding {sum(first)} of {len(first)}, "
                    f"undecided {undecided}"
                )
    return "\n".join(lines)


def main() -> int:
    """Run; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("out", type=Path)
    parser.add_argument("--generality", nargs="+", type=Path, default=[], metavar="DIR")
    parser.add_argument("--sensing", nargs="+", type=int, default=[], metavar="SEED")
    parser.add_argument("--force-units", action="store_true")
    parser.add_argument("--hidden", nargs="+", default=[], metavar="NAME")
    parser.add_argument("--skip", nargs="+", default=[], metavar="PART", help="of names of cases")
    parser.add_argument("--ways", nargs="+", default=["today", "evidence"], metavar="WAY")
    parser.add_argument("--budget", type=float, default=60.0, metavar="SECONDS")
    options = parser.parse_args()

    def jobs() -> Iterator[Task]:
        for folder in options.generality:
            yield from generality(folder)
        yield from sensing(options.sensing)
        if options.force_units:
            yield from force_units()
        yield from hidden(options.hidden)

    asked = (job for job in jobs() if not any(part in job.name for part in options.skip))
    run(asked, options.ways, options.out, options.budget)
    print(table(rows_of(options.out)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
