"""The decision two ways: as it stands, and by the evidence alone.

    python -m benchmarks.decided_ways OUT.jsonl [--generality DIR ...] [--sensing SEED ...]
                    [--force-units] [--hidden NAME ...] [--only PART ...] [--skip PART ...]
                    [--ways WAY ...] [--budget SECONDS]
    python -m benchmarks.decided_ways OUT.jsonl     # the table of what is there

`today` is the decision of the commands. `evidence` is that of the posterior even where
free runs do not bear it out; it is run where `today` left that undecided. Every answer is
a line of OUT.jsonl with the most probable sets, so that a run goes on where it stopped, and other
rules can be tried on what is there. Set JAXSR_CLOCK=processor: the budget is that of the processor
then.
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
from jaxsr.diagnosis.verdict import Claim
from jaxsr.models import parse_model

COURSE, SETTLED = map(
    importlib.import_module, ("jaxsr.diagnosis.diagnose", "jaxsr.diagnosis.settled")
)
PATCHED = {"weighed": COURSE, "borne_out": SETTLED, "claimed": COURSE}
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
        self.borne: bool | None = None
        self.claim: Claim | None = None
        self.own: dict[str, Callable[..., Any]] = {}

    def __enter__(self) -> Way:
        self.own = {name: getattr(module, name) for name, module in PATCHED.items()}
        for name, module in PATCHED.items():
            setattr(module, name, getattr(self, f"_{name}"))
        return self

    def __exit__(self, *_: object) -> None:
        for name, own in self.own.items():
            setattr(PATCHED[name], name, own)

    def _weighed(self, case: Any, rng: np.random.Generator) -> Posterior | None:
        self.found = self.known or self.own["weighed"](case, rng)
        return self.found

    def _borne_out(self, settled: Any, leader: Any) -> bool:
        self.borne = bool(self.own["borne_out"](settled, leader))
        return self.borne or self.name == "evidence"

    def _claimed(self, *args: Any, **more: Any) -> Claim:
        claim = self.claim = self.own["claimed"](*args, **more)
        return claim


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
        "timely": found.timely,
        "settled": bool(leader.settled),
        "something_else": found.something_else,
        "left": float(leader.share / max(null.share, 1e-300)),
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
    row |= {"borne": seen.borne, "decided": seen.claim is not None}
    if seen.claim is not None:
        row |= {"mass": round(seen.claim.mass, 6), "claim": str(seen.claim.verdict)}
    row |= {"cpu_seconds": round(time.process_time() - begin, 1), "posterior": told(seen.found)}
    return row, seen


def run(jobs: Iterator[Task], ways: Sequence[str], out: Path, budget: float) -> None:
    """Answer what was not yet answered."""
    done = {(r["case"], r["way"]): r for r in rows_of(out)}
    with out.open("a", encoding="utf-8") as file:
        for job in jobs:
            known = None
            for way in ways:
                if (job.name, way) in done or not asked(way, done.get((job.name, "today"))):
                    continue
                row, seen = answered(job, way, known, budget)
                known = known or seen.found
                done[job.name, way] = row
                file.write(json.dumps(row) + "\n")
                file.flush()
                print(said(row), flush=True)


def asked(way: str, today: Mapping[str, Any] | None) -> bool:
    """Whether an answer in another way can differ from today's."""
    if today is None or way == "today":
        return True
    return today["borne"] is False


def rows_of(out: Path) -> list[dict[str, Any]]:
    """Return the lines of a file."""
    if not out.exists():
        return []
    return [json.loads(line) for line in out.read_text(encoding="utf-8").splitlines()]


def said(row: Mapping[str, Any]) -> str:
    """One line of a row."""
    marks = "".join("x" if m is False else "." for m in (row["verdict_right"], row["first_right"]))
    findings = ", ".join(f"{n} {p:.2f}" for n, p in row["findings"][:3])
    by = "doubt" if row["borne"] is False else "claim"
    return (
        f"{marks} {row['case'][:52]:52} {row['way']:8} by {by:8} {row['verdict']:14} "
        f"[{findings}] truth {row['truth']} ({row['cpu_seconds']} s)"
    )


def doubt_of(row: Mapping[str, Any]) -> str:
    """Say in a few words what the posterior left in doubt."""
    post = row["posterior"]
    if post is None:
        return "no posterior"
    top = row.get("mass", post["sets"][0]["p"])
    parts = [] if post["timely"] else ["not in time"]
    parts += [] if post["settled"] else ["not at rest"]
    parts += [] if row["borne"] is not False else ["free run"]
    return (
        f"{', '.join(parts) or 'doubt'}; mass {top:.3f}, else {post['something_else']:.2f}, "
        f"left {post['left']:.2f}"
    )


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Cases that were answered in several ways, and rates by group and way."""
    by = {(r["case"], r["way"]): r for r in rows}
    lines = []
    for (case, way), row in by.items():
        others = [o for o in ("before", "evidence") if (case, o) in by]
        if way != "today" or not others:
            continue
        lines.append(f"{case} ({row['truth']}): {doubt_of(row)}")
        lines += ["    " + said(by[case, other]) for other in ("today", *others)]
    lines.append("")
    groups = list(dict.fromkeys(r["group"] for r in rows))
    for group in groups:
        cases = [c for (c, way), r in by.items() if way == "today" and r["group"] == group]
        for way in ("today", "before", "evidence"):
            # where another way was not asked, it answers as today's does
            own = [by.get((c, way), by[c, "today"]) for c in cases]
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
    parser.add_argument("--only", nargs="+", default=[""], metavar="PART", help="of names of cases")
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

    chosen = (
        job
        for job in jobs()
        if any(part in job.name for part in options.only)
        and not any(part in job.name for part in options.skip)
    )
    run(chosen, options.ways, options.out, options.budget)
    print(table(rows_of(options.out)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
