"""Ctrl-C and kill -9 at seeded moments of a diagnosis: what is left behind.

    python -m benchmarks.interrupts [--quick] [--moments N] [--seed S]

A diagnosis of a small chain of masses, as a user starts it, is timed once; then it is begun anew
for every moment and sent a signal. Moments are of processor time from the start of the process:
two in five log-uniform from 0.05 s to the end of loading, two in five uniform over the run, one
in five in its last tenth, where files are written. Every other run finds the results of an
earlier one in its place, and one in three finds nothing compiled before.

Ctrl-C (SIGINT): exit status 130 (or 0 where the work was done), no traceback and no warning, the
best so far whole or the earlier results untouched, no other file, no process left. kill -9
(SIGKILL): the earlier results or the new ones, complete; after the next run nothing else is left,
and that run says nothing that it would not say otherwise.
Results: ``results/interrupts.json``. --quick: two moments of each, less to
search, no file. Ends with status 1 if a moment left
anything wrong.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.chains import write_case
from benchmarks.provenance import write

ROOT = Path(__file__).resolve().parents[1]
MOMENTS, FIRST = 50, 0.05
"""How many; the earliest, in s of processor time."""
BUDGET, QUICK_BUDGET = 20.0, 4.0
"""What the whole run may take, in s of processor time."""
_LOADING, _LAST = 2.5, 0.9  # s of processor time that libraries take to load; share of a run
_GONE = 10.0  # s of wall time within which what a killed run began has ended
_SIGNALS = {"Ctrl-C": signal.SIGINT, "kill -9": signal.SIGKILL}
_MODEL, _DATA, _OUT, _TEMPORARY = "chain.toml", "chain.npz", "d", "tmp"
_RESULTS = ("diagnosis.json", "explained.toml", "report.html")
_MANIFEST = ".jaxsr-files"


@dataclass(frozen=True)
class Moment:
    """When a run is sent its signal, and what it finds.

    Attributes
    ----------
    sent : str
        "Ctrl-C" or "kill -9".
    seconds : float
        Processor time from the start of the process.
    old : bool
        Whether results of an earlier run are in the place.
    cold : bool
        Whether nothing is compiled yet.
    """

    sent: str
    seconds: float
    old: bool
    cold: bool


@dataclass(frozen=True)
class Left:
    """What a run left behind.

    Attributes
    ----------
    status : int
        Of its exit; negative where a signal ended it.
    files : str
        "none", "old" or "new".
    problems : tuple of str
        Empty where all is right.
    """

    status: int
    files: str
    problems: tuple[str, ...]


def moments(rng: np.random.Generator, sent: str, count: int, whole: float) -> list[Moment]:
    """Draw moments between `FIRST` and the end of a run of `whole` seconds."""
    early = round(0.4 * count)
    last = math.ceil(0.2 * count)
    loading = min(_LOADING, whole)
    drawn = np.concatenate(
        [
            np.exp(rng.uniform(np.log(FIRST), np.log(loading), early)),
            rng.uniform(FIRST, whole, count - early - last),
            rng.uniform(_LAST * whole, whole, last),
        ]
    )
    return [
        Moment(sent, round(float(seconds), 3), k % 2 == 1, k % 3 == 2)
        for k, seconds in enumerate(drawn)
    ]


def command(seed: int, budget: float) -> list[str]:
    """Return the words of a diagnosis in the folder of a case."""
    words = [sys.executable, "-m", "jaxsr", "diagnose", _MODEL, _DATA, "--out", _OUT]
    return [*words, "--seed", str(seed), "--budget", f"{budget:g}"]


def started(folder: Path, words: Sequence[str], compiled: Path) -> subprocess.Popen[str]:
    """Start a command in a session of its own, with temporary files in `folder` too."""
    (folder / _TEMPORARY).mkdir(exist_ok=True)
    own = {
        "PYTHONPATH": str(ROOT),
        "MPLBACKEND": "Agg",
        "JAXSR_CLOCK": "processor",
        "TMPDIR": str(folder / _TEMPORARY),
        "JAX_COMPILATION_CACHE_DIR": str(compiled),
    }

    def heard() -> None:  # also where this script runs under `nohup` or in the background
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)

    return subprocess.Popen(
        words,
        cwd=folder,
        env={**os.environ, **own},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=heard,
    )


def processor_time(pid: int) -> float:
    """Return the seconds that a process has worked (proc(5), ``stat``)."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def members(session: int) -> list[int]:
    """Return the processes of a session that still run (proc(5), ``stat``)."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            words = entry.read_text().rpartition(")")[2].split()
        except OSError:  # it ended meanwhile
            continue
        if int(words[3]) == session and words[0] != "Z":
            found.append(int(entry.parent.name))
    return found


def contents(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder by name; empty where there is none."""
    return {p.name: p.read_bytes() for p in folder.iterdir()} if folder.is_dir() else {}


def is_whole(files: Mapping[str, bytes], seed: int) -> bool:
    """Return whether files are the complete results of a run with this seed."""
    manifest = files.get(_MANIFEST, b"").decode().split()
    if not set(_RESULTS) <= set(manifest) or set(files) != {*manifest, _MANIFEST}:
        return False
    document = json.loads(files[_RESULTS[0]])
    tomllib.loads(files[_RESULTS[1]].decode())
    return document["provenance"]["seed"] == seed and files[_RESULTS[2]].rstrip().endswith(
        b"</html>"
    )


def litter(folder: Path) -> list[str]:
    """Return the names of files beside model, recording and results."""
    names = {p.name for p in folder.iterdir()} - {_MODEL, _DATA, _OUT, _TEMPORARY}
    out = folder / _OUT
    hidden = {p.name for p in out.glob(".*")} - {_MANIFEST} if out.is_dir() else set()
    return sorted(names | hidden | {p.name for p in (folder / _TEMPORARY).iterdir()})


def complaints(text: str) -> list[str]:
    """Return lines of standard error that no run should write."""
    return [x[:160] for x in text.splitlines() if "Traceback" in x or "Warning" in x]


def state(folder: Path, old: Mapping[str, bytes], seed: int) -> str:
    """Return what stands in the place of the results: none, old, new or mixed."""
    files = contents(folder / _OUT)
    if files == old:
        return "old" if old else "none"
    return "new" if is_whole(files, seed) else f"mixed: {sorted(files)}"


def run(
    moment: Moment, folder: Path, budget: float, old: Mapping[str, bytes], compiled: Path
) -> Left:
    """Begin a run, send it its signal, and judge what it left."""
    if old:
        (folder / _OUT).mkdir()
        for name, data in old.items():
            (folder / _OUT / name).write_bytes(data)
    process = started(folder, command(1, budget), compiled)
    while process.poll() is None and processor_time(process.pid) < moment.seconds:
        time.sleep(0.002)
    process.send_signal(_SIGNALS[moment.sent])
    _, err = process.communicate()
    status = process.returncode
    problems = complaints(err)
    if moment.sent == "Ctrl-C":
        if status not in (130, 0):
            problems.append(f"status {status}: {err.strip().splitlines()[-1:]}")
        files = state(folder, old, 1)
        if (status == 0) != (files == "new" and "interrupted" not in err):
            problems.append(f"status {status} with {files} files")
        problems += [f"left: {name}" for name in litter(folder)]
    else:
        files = state(folder, old, 1)
        problems += _next_run(folder, compiled)
    if files.startswith("mixed"):
        problems.append(files)
    problems += _survivors(process.pid)
    return Left(status, files, tuple(problems))


def _next_run(folder: Path, compiled: Path) -> list[str]:
    """Run the command again after a kill; return what it says or leaves that it should not."""
    again = started(folder, command(2, 1.0), compiled)
    _, err = again.communicate()
    found = [f"next run: {line}" for line in complaints(err)]
    if again.returncode != 0:
        found.append(f"next run: status {again.returncode}: {err.strip().splitlines()[-1:]}")
    elif not is_whole(contents(folder / _OUT), 2):
        found.append(f"next run: {sorted(contents(folder / _OUT))}")
    return found + [f"after the next run: {name}" for name in litter(folder)]


def _survivors(session: int) -> list[str]:
    """Return processes that a run has left; they have some seconds to see that it is gone."""
    until = time.monotonic() + _GONE
    while (alive := members(session)) and time.monotonic() < until:
        time.sleep(0.05)
    return [f"still runs: {pid}" for pid in alive]


def measured(count: int, budget: float, seed: int) -> dict[str, Any]:
    """Time a whole run, then send every signal at every moment."""
    rng = np.random.default_rng(seed)
    rows: list[tuple[Moment, Left]] = []
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        compiled = home / "compiled"
        given = home / "given"
        given.mkdir()
        write_case(given, 1, 300)
        _whole_run(_copy(given, home / "first"), budget, compiled)
        old = contents(home / "first" / _OUT)
        whole = _whole_run(_copy(given, home / "second"), budget, compiled)
        for sent in _SIGNALS:
            for k, moment in enumerate(moments(rng, sent, count, whole)):
                folder = _copy(given, home / f"{sent[0]}{k}")
                own, there = home / "own", old if moment.old else {}
                left = run(moment, folder, budget, there, own if moment.cold else compiled)
                rows.append((moment, left))
                told = f"{sent} {moment.seconds:.3f} s: {left.status}, {left.files}"
                print(f"{told}: {'; '.join(left.problems) or 'right'}", flush=True)
                shutil.rmtree(folder)
                shutil.rmtree(own, ignore_errors=True)
    return {
        "whole_run_s": round(whole, 2),
        "summary": {sent: summary([x for x in rows if x[0].sent == sent]) for sent in _SIGNALS},
        "moments": [{**asdict(m), **asdict(a)} for m, a in rows],
    }


def _copy(given: Path, folder: Path) -> Path:
    shutil.copytree(given, folder)
    return folder


def _whole_run(folder: Path, budget: float, compiled: Path) -> float:
    """Run the command to its end; return its processor time in s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    process = started(folder, command(0, budget), compiled)
    _, err = process.communicate()
    if process.returncode != 0:
        raise RuntimeError(f"the run without a signal ended with {process.returncode}: {err}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def summary(rows: Sequence[tuple[Moment, Left]]) -> dict[str, Any]:
    """Return how many moments left all right, and what statuses and files they left."""
    return {
        "moments": len(rows),
        "right": sum(not left.problems for _, left in rows),
        "statuses": dict(Counter(str(left.status) for _, left in rows)),
        "files": dict(Counter(left.files.partition(":")[0] for _, left in rows)),
    }


def main() -> int:
    """Send the signals and write what was left; 1 where anything was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two moments of each, no file")
    parser.add_argument("--moments", type=int, default=MOMENTS, help="of each signal")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    count, budget = (2, QUICK_BUDGET) if given.quick else (given.moments, BUDGET)
    found = measured(count, budget, given.seed)
    if not given.quick:
        write("interrupts", "signals at seeded moments of a diagnosis", [given.seed], found)
    for sent, told in found["summary"].items():
        print(sent, told)
    return int(any(told["right"] < told["moments"] for told in found["summary"].values()))


if __name__ == "__main__":
    sys.exit(main())
