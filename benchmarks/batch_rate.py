"""How much faster two workers diagnose many machines than one, and what survives a kill.

    python -m benchmarks.batch_rate [--quick] [--cases N] [--budget SECONDS] [--folder DIR]

Small machines (`benchmarks.batch_plants`): a mass on a spring with one hidden law each, 300
samples. Three passes of ``jaxsr batch`` over the same cases:

1. one process after another (``--workers 1``);
2. two workers on a LocalCluster;
3. two workers of a Dask scheduler; on the way a worker is killed outright, later the command
   itself, and ``--resume`` goes on.

Counted: cases per second of 1 and 2; the most memory of all processes together (sum of their
proportional set sizes) and of one; cases of 2 and 3 whose files are not those of 1, byte for byte
but for seconds, and a few of ``jaxsr diagnose`` by itself; cases that are lost, and cases of 3 that
were done twice. Budgets are of processor time, so that a pass is the same work on a busy machine; a
case that its budget ended is counted, and its bytes are not compared, for none are promised.

What is done stays in a folder, and the same command goes on with it: times are added up. A full
run writes ``results/batch_rate.json``; --quick (two cases, cut short) writes nothing. Ends with
status 1 where results differ, a case is lost or done twice; a full run also where the rate is below
1.8.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.batch_plants import write_cases
from benchmarks.provenance import ROOT, write
from jaxsr._files import atomic_write_text

SEED = 37
CASES, QUICK = 200, 2
BUDGET, QUICK_BUDGET = 30.0, 3.0
"""Seconds of processor time, the start of the process among them: a case needs 5 to 10."""
ALONE = 5
"""Cases that are diagnosed by themselves too."""
ENOUGH = 1.8
"""Rate of two workers over that of one."""
_LOOK = 0.5  # seconds between looks at the memory
_PATIENCE = 60.0
_SECONDS = (rb'"seconds": [0-9.]+', rb"<dt>Time taken</dt>\s*<dd>.*?</dd>")


def start(words: list[str], folder: Path, log: Path) -> subprocess.Popen[bytes]:
    """Start a Python program in a folder."""
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH", ""))))
    # Two processes share what cores there are: none is to take more than one.
    settings = {"PYTHONPATH": path, "OMP_NUM_THREADS": "1", "JAXSR_CLOCK": "processor"}
    with log.open("ab") as stream:
        return subprocess.Popen(
            [sys.executable, "-m", *words],
            cwd=folder,
            env={**os.environ, **settings},
            stdout=stream,
            stderr=stream,
        )


def tree(root: int) -> list[int]:
    """Return a process and all that descend from it (proc(5))."""
    parents: dict[int, list[int]] = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            child, _, rest = entry.read_text().partition(" ")
            parents.setdefault(int(rest.rpartition(")")[2].split()[1]), []).append(int(child))
    found, new = [], [root]
    while new:
        found += new
        new = [child for parent in new for child in parents.get(parent, [])]
    return found


def memory(pid: int) -> int:
    """Return the proportional set size of a process in bytes, 0 if it is gone."""
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return 1024 * int(line.split()[1])
    return 0


def marks(out: Path) -> dict[str, int]:
    """Return when each case was done, in ns: a case that is done again has another time."""
    return {
        path.name.removeprefix(".").removesuffix(".done"): path.stat().st_mtime_ns
        for path in out.glob(".*.done")
    }


def timed(folder: Path, out: str, workers: int, count: int) -> dict[str, Any]:
    """Run a pass, or what is left of it; return its seconds and memory, of all runs together."""
    state = folder / f"{out}.json"
    known = {"seconds": 0.0, "tree_mib": 0.0, "process_mib": 0.0}
    if state.exists():
        known = json.loads(state.read_text(encoding="utf-8"))
    if len(marks(folder / out)) == count:
        return known
    command = ["jaxsr", "batch", "cases.toml", "--out", out, "--workers", str(workers), "--resume"]
    begin, spent = time.monotonic(), known["seconds"]
    process = start(command, folder, folder / f"{out}.log")
    try:
        while process.poll() is None:
            time.sleep(_LOOK)
            sizes = [memory(pid) / 2**20 for pid in tree(process.pid)]
            known["tree_mib"] = max(known["tree_mib"], round(sum(sizes)))
            known["process_mib"] = max(known["process_mib"], round(max(sizes)))
            known["seconds"] = round(spent + time.monotonic() - begin, 2)
            atomic_write_text(state, json.dumps(known))  # as it goes: this run may be killed too
    finally:
        _end(process)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)}: status {process.returncode}, see {folder}")
    return known


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()


@contextlib.contextmanager
def cluster(folder: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Yield the address of a scheduler and its two workers, processes of their own."""
    log, file = folder / "cluster.log", folder / "scheduler.json"
    file.unlink(missing_ok=True)
    local = ["--host", "127.0.0.1", "--no-dashboard"]
    words = ["distributed.cli.dask_scheduler", "--port", "0", "--scheduler-file", str(file)]
    processes = [start([*words, *local], folder, log)]
    try:
        _until(lambda: file.exists() and b'"address"' in file.read_bytes(), "no scheduler")
        address = json.loads(file.read_text(encoding="utf-8"))["address"]
        worker = ["distributed.cli.dask_worker", address, "--no-nanny", "--nthreads", "1"]
        processes += [start([*worker, *local], folder, log) for _ in range(2)]
        yield address, processes[1:]
    finally:
        for process in processes:
            _end(process)


def _until(true: Any, what: str) -> None:
    end = time.monotonic() + _PATIENCE
    while not true():
        if time.monotonic() > end:
            raise SystemExit(f"{what} after {_PATIENCE:g} s")
        time.sleep(0.05)


def killed(folder: Path, out: str, count: int) -> dict[str, Any]:
    """Run a pass in which a worker and then the command are killed; count what was done twice."""
    known: dict[str, int] = {}
    again: set[str] = set()

    def look() -> int:
        found = marks(folder / out)
        again.update(name for name, at in found.items() if known.setdefault(name, at) != at)
        return len(found)

    with cluster(folder) as (address, workers):
        command = ["jaxsr", "batch", "cases.toml", "--out", out, "--scheduler", address]
        log = folder / f"{out}.log"
        runs = [start([*command, "--resume"], folder, log)]
        stages = [(count // 4, workers[0]), (count // 2, runs[0])]
        while look() < count:
            if stages and look() >= stages[0][0] and any(folder.glob(f"{out}/.*.running")):
                stages[0][1].send_signal(signal.SIGKILL)
                stages[0][1].wait()
                stages = stages[1:]
                if not stages:
                    runs.append(start([*command, "--resume"], folder, log))
            elif runs[-1].poll() is not None:
                break
            time.sleep(0.1)
        status = runs[-1].wait()
        look()
    return {
        "worker_killed": workers[0].returncode == -signal.SIGKILL,
        "command_killed": len(runs) == 2,
        "status": status,
        "lost": count - len(marks(folder / out)),
        "done_twice": sorted(again),
    }


def differing(folder: Path, one: str, other: str) -> list[str]:
    """Return the cases of one pass whose files are others in another, but for seconds and place."""
    found = []
    for path in sorted(folder.glob(f"{one}/*/diagnosis.json")):
        name = path.parent.name
        pair = [folder / out / name for out in (one, other)]
        if _contents(pair[0], one) != _contents(pair[1], other):
            found.append(name)
    return found


def _contents(folder: Path, out: str) -> dict[str, bytes]:
    """Return the files of a case, without seconds; the command names the pass."""
    contents = {}
    for path in folder.iterdir():
        text = path.read_bytes().replace(f"{out}/{folder.name}".encode(), folder.name.encode())
        for pattern in _SECONDS:
            text = re.sub(pattern, b"", text)
        contents[path.name] = text
    return contents


def budget_ended(folder: Path, out: str) -> list[str]:
    """Return the cases that a budget ended: the same bytes are promised of all others."""
    return sorted(
        path.parent.name
        for path in folder.glob(f"{out}/*/diagnosis.json")
        if json.loads(path.read_text(encoding="utf-8"))["provenance"]["stopped_by"] == "budget"
    )


def alone(folder: Path, budget: float, count: int) -> None:
    """Diagnose a few cases by themselves."""
    names = sorted(path.stem for path in folder.glob("*_*.csv"))
    for name in names[:: max(len(names) // max(count, 1), 1)][:count]:
        words = ["jaxsr", "diagnose", "plant.toml", f"{name}.csv", "--out", f"alone/{name}"]
        if not (folder / "alone" / name / "diagnosis.json").exists():
            words += ["--seed", "0", "--budget", f"{budget:g}"]  # in a batch's own order
            process = start(words, folder, folder / "alone.log")
            try:
                process.wait()
            finally:
                _end(process)


def passes(folder: Path, count: int, budget: float, few: int) -> dict[str, Any]:
    """Run the three passes in a folder and return what they show."""
    write_cases(folder, count, SEED, budget)
    one = timed(folder, "one", 1, count)
    print(f"one worker: {one['seconds']:.1f} s, {one['tree_mib']:.0f} MiB at most", flush=True)
    two = timed(folder, "two", 2, count)
    print(f"two workers: {two['seconds']:.1f} s, {two['tree_mib']:.0f} MiB at most", flush=True)
    shutil.rmtree(folder / "killed", ignore_errors=True)  # marks of an earlier run tell nothing
    kills = killed(folder, "killed", count)
    print(f"killed: {kills}", flush=True)
    alone(folder, budget, few)
    cut = {out: budget_ended(folder, out) for out in ("one", "two", "killed", "alone")}
    promised = {
        out: [n for n in differing(folder, out, "one") if n not in {*cut["one"], *cut[out]}]
        for out in ("two", "killed", "alone")
    }
    return {
        **{"count": count, "budget_s": budget, "one": one, "two": two, "killed": kills},
        "alone": len(list(folder.glob("alone/*/diagnosis.json"))),
        "rate_ratio": round(one["seconds"] / two["seconds"], 3),
        "ended_by_budget": {out: len(names) for out, names in cut.items()},
        "differing": promised,
    }


def main() -> int:
    """Run the passes; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="two cases, writes nothing")
    parser.add_argument("--cases", type=int, default=CASES, help="number of machines")
    parser.add_argument("--budget", type=float, default=BUDGET, help="processor seconds of each")
    parser.add_argument("--folder", type=Path, help="where an interrupted run goes on")
    args = parser.parse_args()
    count, budget = (QUICK, QUICK_BUDGET) if args.quick else (args.cases, args.budget)
    with tempfile.TemporaryDirectory() as temporary:
        folder = args.folder or Path(temporary)
        if not args.quick and args.folder is None:
            folder = Path(tempfile.gettempdir()) / f"jaxsr-batch-rate-{count}"
            print(f"an interrupted run goes on with --folder {folder}")
        folder.mkdir(parents=True, exist_ok=True)
        shown = passes(folder, count, budget, 0 if args.quick else ALONE)
    print(f"rate of two workers over that of one: {shown['rate_ratio']:.2f}")
    print(f"ended by the budget: {shown['ended_by_budget']}; differing: {shown['differing']}")
    if not args.quick:
        write("batch_rate", "many diagnoses on two workers", [SEED], shown)
        if args.folder is None:
            shutil.rmtree(folder)  # the next run measures anew
    kills = shown["killed"]
    whole = not (kills["status"] or kills["lost"] or kills["done_twice"])
    met = whole and kills["worker_killed"] and kills["command_killed"]
    alike = not any(shown["differing"].values())
    return int(not (met and alike and (args.quick or shown["rate_ratio"] >= ENOUGH)))


if __name__ == "__main__":
    sys.exit(main())
