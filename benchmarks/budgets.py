"""Time against the budget, for commands of any size, alone and with all cores busy.

    python -m benchmarks.budgets [--quick] [--command C] [--load L] [--states N,..] [--samples N,..]
        [--budgets S,..] [--recordings N,..] [--clock wall|processor]

Chains of masses, springs and dampers, sampled 1,000 to 1,000,000 times; `discover` finds the
equations, `diagnose` what a model without the dry friction of the last mass has left out, from one
recording or, with --recordings, from as many of that length as asked for. Every
case is a process of its own, as a user starts it; the stages that it tells of on its standard
error say where its time goes. A budget holds where the whole command, start and report included,
takes at most 1.1 times as long. Results: ``results/budgets.json``, written after every case; rows
of other cases stay, each with the commit that it was measured on.
--clock processor: budgets and times are of processor time (`jaxsr._clock`), so that the table can
be made beside other work, and the loads are one.
--quick: small cases at one budget, no file, on processor time; fails where a command does or takes
half as long again.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, astuple, dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.chains import write_case
from benchmarks.provenance import RESULTS, engine, write

BUDGETS = (5.0, 20.0, 60.0)
SAMPLES = (1_000, 10_000, 100_000, 1_000_000)
STATES = (2, 4, 8, 16, 30)
COMMANDS, LOADS = ("discover", "diagnose"), ("alone", "busy")
CLOCKS = ("wall", "processor")
HOLDS, QUICK_HOLDS = 1.1, 1.5  # times the budget
_LONGEST = 6.0  # times the budget, and as many seconds more than that, until a case is ended
_CROWDED = 20.0  # times as long on the wall, where budgets are of processor time
_STAGE = "jaxsr: "
_STARTING, _WRITING = "start", "report and files"


@dataclass(frozen=True)
class Case:
    """One command on one chain."""

    command: str
    states: int
    samples: int
    budget: float
    load: str
    clock: str = CLOCKS[0]
    recordings: int = 1


@dataclass(frozen=True)
class Outcome:
    """What a command took.

    Attributes
    ----------
    seconds, processor_seconds : float
        On the wall, and of all its threads.
    memory_gib : float
        At most resident.
    status : int
        Of its exit; negative where it was ended.
    stages : dict of str to float
        Seconds by stage.
    """

    seconds: float
    processor_seconds: float
    memory_gib: float
    status: int
    stages: dict[str, float] = field(default_factory=dict)

    def took(self, case: Case) -> float:
        """Return the seconds on the clock of a case."""
        return self.seconds if case.clock == CLOCKS[0] else self.processor_seconds


def run(case: Case, folder: Path) -> Outcome:
    """Run one case in a process of its own."""
    model, data = write_case(folder, case.states // 2, case.samples, case.recordings)
    out = folder / "out"
    words = [sys.executable, "-m", "jaxsr", case.command]
    if case.command == "discover":
        names = [f"{kind}{k + 1}" for kind in "qv" for k in range(case.states // 2)]
        words += [*map(str, data), "--states", ",".join(names), "--inputs", "u"]
    else:
        words += [str(model), *map(str, data)]
    words += ["--out", str(out), "--budget", str(case.budget)]
    own = {} if case.clock == CLOCKS[0] else {"JAXSR_CLOCK": case.clock}
    # as a user starts it, whose modules were compiled when they were installed
    around = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    patience = _LONGEST if case.clock == CLOCKS[0] else _CROWDED * _LONGEST
    began = time.monotonic()
    process = subprocess.Popen(
        words,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        bufsize=1,
        env={**around, **own},
    )
    stages, name, since = {}, _STARTING, began
    watch = _Watch(process, began + patience * (case.budget + 1.0))
    assert process.stderr is not None
    with watch:
        for text in process.stderr:
            if text.startswith(_STAGE):
                now = time.monotonic()
                stages[name] = stages.get(name, 0.0) + now - since
                name, since = _kind(text.removeprefix(_STAGE)), now
        _, status, usage = os.wait4(process.pid, 0)
    ended = time.monotonic()
    stages[name] = stages.get(name, 0.0) + ended - since
    process.returncode = os.waitstatus_to_exitcode(status)
    scale = 2.0**30 if sys.platform == "darwin" else 2.0**20
    return Outcome(
        round(ended - began, 2),
        round(usage.ru_utime + usage.ru_stime, 2),
        round(usage.ru_maxrss / scale, 2),
        process.returncode,
        {stage: round(seconds, 2) for stage, seconds in stages.items()},
    )


def kept(measured: Sequence[Case]) -> list[tuple[Case, Outcome, str]]:
    """Return the rows of the result that are of other cases, with their commits."""
    path = RESULTS / "budgets.json"
    rows = json.loads(path.read_text(encoding="utf-8"))["cases"] if path.is_file() else []
    found = []
    for row in rows:
        case = Case(**{name: row[name] for name in Case.__dataclass_fields__ if name in row})
        out = Outcome(**{name: row[name] for name in Outcome.__dataclass_fields__})
        if case not in measured:
            found.append((case, out, row.get("engine", "")))
    return found


def _kind(text: str) -> str:
    """Return a stage without the names in it: "equation of v3" is one with "equation of v1"."""
    words = text.strip().split(" of ")
    return words[0] if words[0] else _WRITING


class _Watch:
    """End a process that runs on and on."""

    def __init__(self, process: subprocess.Popen[str], until: float) -> None:
        import threading

        self._timer = threading.Timer(max(until - time.monotonic(), 1.0), process.kill)

    def __enter__(self) -> None:
        self._timer.start()

    def __exit__(self, *error: object) -> None:
        self._timer.cancel()


@contextlib.contextmanager
def busy(load: str) -> Iterator[None]:
    """Keep every core busy meanwhile, where the load says so."""
    count = os.cpu_count() or 1
    words = [sys.executable, "-c", "while True: pass"]
    others = [subprocess.Popen(words) for _ in range(count)] if load == "busy" else []
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def table(rows: Sequence[tuple[Case, Outcome]]) -> str:
    """Return a line for each case: its time over its budget, memory, and where the time went."""
    lines = ["command   load  states   samples  budget  seconds  ratio  GiB   where the time goes"]
    for case, out in rows:
        memory = f"{out.memory_gib:4.1f}"
        parts = sorted(out.stages.items(), key=lambda item: -item[1])[:4]
        told = ", ".join(f"{name} {seconds:.1f}" for name, seconds in parts)
        ratio = out.took(case) / case.budget
        many = f"{case.recordings}x" if case.recordings > 1 else ""
        size = f"{many}{case.samples}"
        mark = " " if out.status == 0 and ratio <= HOLDS else "!"
        lines.append(
            f"{case.command:9} {case.load:5} {case.states:6d} {size:>9} "
            f"{case.budget:7.0f} {out.took(case):8.1f} {ratio:6.2f}{mark} {memory}  {told}"
            + (f" (exit {out.status})" if out.status else "")
        )
    return "\n".join(lines)


def summary(rows: Sequence[tuple[Case, Outcome]]) -> dict[str, object]:
    """Return how many cases held their budget, and the worst, by command and load."""
    out: dict[str, object] = {}
    for command, load in itertools.product(COMMANDS, LOADS):
        own = [(c, o) for c, o in rows if (c.command, c.load) == (command, load)]
        if own:
            ratios = np.array([o.took(c) / c.budget for c, o in own])
            failed = sum(o.status != 0 for _, o in own)
            out[f"{command}, {load}"] = {
                "cases": len(own),
                "held": int(np.count_nonzero(ratios <= HOLDS)),
                "failed": failed,
                "worst_ratio": round(float(np.max(ratios)), 2),
                "most_memory_gib": max(o.memory_gib for _, o in own),
            }
    return out


def measured(cases: Sequence[Case], keep: bool) -> list[tuple[Case, Outcome]]:
    """Run cases one after the other, and print each as it ends."""
    rows: list[tuple[Case, Outcome]] = []
    commit = engine()
    for case in cases:
        with tempfile.TemporaryDirectory() as folder, busy(case.load):
            rows.append((case, run(case, Path(folder))))
        lines = table(rows).splitlines()
        print("\n".join(lines if len(rows) == 1 else lines[-1:]), flush=True)
        if keep:
            own = [(c, o, commit) for c, o in rows]
            every = sorted(kept([c for c, _ in rows]) + own, key=lambda row: astuple(row[0]))
            body = {
                "held_at": HOLDS,
                "summary": summary([(c, o) for c, o, _ in every]),
                "cases": [{**asdict(c), **asdict(o), "engine": e} for c, o, e in every],
            }
            write("budgets", "time against the budget, chains of masses", [0], body)
    return rows


def _numbers(text: str) -> list[int]:
    return [int(word) for word in text.split(",")]


def main() -> int:
    """Measure and write; 1 where a quick case failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small cases, no file")
    parser.add_argument("--command", choices=COMMANDS, help="one command only")
    parser.add_argument("--load", choices=LOADS, help="one load only")
    parser.add_argument("--states", type=_numbers, help="numbers of states, even")
    parser.add_argument("--samples", type=_numbers, help="numbers of samples")
    parser.add_argument("--budgets", type=_numbers, help="seconds")
    parser.add_argument("--recordings", type=_numbers, default=[1], help="of that many samples")
    parser.add_argument("--clock", choices=CLOCKS, default=CLOCKS[0], help="of budgets and times")
    given = parser.parse_args()
    commands = [given.command] if given.command else COMMANDS
    clock = CLOCKS[1] if given.quick else given.clock
    loads = [given.load] if given.load else (LOADS[:1] if clock == CLOCKS[1] else LOADS)
    states = given.states or ((2, 8) if given.quick else STATES)
    samples = given.samples or ((1_000, 20_000) if given.quick else SAMPLES)
    budgets = given.budgets or (BUDGETS[1:2] if given.quick else BUDGETS)
    every = itertools.product(commands, states, samples, budgets, loads, [clock], given.recordings)
    rows = measured([Case(*case) for case in every], not given.quick)
    for name, told in summary(rows).items():
        print(name, told)
    bad = [c for c, o in rows if o.status or o.took(c) > QUICK_HOLDS * c.budget]
    return int(given.quick and bool(bad))


if __name__ == "__main__":
    sys.exit(main())
