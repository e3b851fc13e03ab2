"""Processor time of the posterior, case by case, each in a process of its own.

    python -m benchmarks.likelihood_times [--quick] [--only CASE ...] [--out FILE.json]
    python -m benchmarks.likelihood_times --profile CASE

Cases are demo sets, planted systems of several groups at three recordings of 1,000 samples, and
motors whose angle is not measured, with dry friction. A process reads one case and weighs it once,
as a command does, so that whatever is compiled or recorded on the way counts. Printed are seconds
of reading and of weighing, the leading set, and its log evidence: a change that is meant to save
time alone has to leave these two as they are. --quick: two small cases, no file; it fails where
nothing could be followed. --profile shows where the time of a case goes.
"""

from __future__ import annotations

import argparse
import cProfile
import json
import pstats
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.generality.plan import Ticket
from benchmarks.generality.running import made
from benchmarks.sensing import task
from jaxsr._files import atomic_write_text, dump_json
from jaxsr.diagnosis.likelihood.posterior import posterior
from jaxsr.diagnosis.thinning import prepare_search
from jaxsr.models import Simulator
from jaxsr.recordings import write_csv

DEMO = Path(__file__).resolve().parents[1] / "jaxsr" / "datasets" / "demo"
SEED = 34
SAMPLES, FEW = 1000, 200
"""Samples of a recording of a planted system, usually and with --quick."""
Files = tuple[Path, list[Path]]


def _demo(name: str) -> Callable[[Path, int], Files]:
    return lambda folder, samples: (DEMO / "arm.toml", [DEMO / f"{name}_train.csv"])


def _planted(system: str, sensing: str, family: str) -> Callable[[Path, int], Files]:
    """Return what makes three recordings of a system; one of them is held out elsewhere."""

    def written(folder: Path, samples: int) -> Files:
        name = made(Ticket(f"{system}-{family}", system, sensing, family), SEED, folder, samples)
        here = folder / "cases" / name
        case = json.loads((here / "case.json").read_text(encoding="utf-8"))
        return here / case["model"], [here / f for f in (*case["data"], *case["held_out"])]

    return written


def _motor(seed: int) -> Callable[[Path, int], Files]:
    def written(folder: Path, samples: int) -> Files:
        job = task("motor", seed)
        model = folder / "model.toml"
        model.write_text(job.model, encoding="utf-8")
        files = [folder / r.name for r in job.recordings]
        for recording, file in zip(job.recordings, files, strict=True):
            write_csv(recording, file)
        return model, files

    return written


CASES: dict[str, Callable[[Path, int], Files]] = {
    "arm, stiffness": _demo("set2"),
    "arm, drag": _demo("set3"),
    "arm, nothing": _demo("set4"),
    "drive, friction": _planted("dc_motor", "white", "friction"),
    "drive, nothing": _planted("dc_motor", "white", "nothing"),
    "cart and pendulum, friction": _planted("cart_pendulum", "encoder", "friction"),
    "tanks, nothing": _planted("coupled_tanks", "white", "nothing"),
    "voice coil, elastic": _planted("voice_coil", "white", "elastic"),
    "two joints, drag": _planted("two_joints", "coloured", "drag"),
    "five masses, friction": _planted("five_masses", "white", "friction"),
    "motor 0": _motor(0),
    "motor 1": _motor(1),
    "motor 5": _motor(5),
}
QUICK = ("drive, nothing", "cart and pendulum, friction")


def weighed(name: str, samples: int, profiled: bool = False) -> dict[str, Any]:
    """Weigh a case in this process; return its row."""
    with tempfile.TemporaryDirectory() as place, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model, files = CASES[name](Path(place), samples)
        began = time.process_time()
        simulator = Simulator.from_file(model)
        prepared, _ = prepare_search(simulator.model, list(files), seconds=np.inf)
        read = time.process_time()
        profile = cProfile.Profile()
        if profiled:
            profile.enable()
        found = posterior(simulator.model, prepared)
        profile.disable()
        done = time.process_time()
    if profiled:
        for order in ("tottime", "cumulative"):
            pstats.Stats(profile).sort_stats(order).print_stats(45)
    row = {
        "case": name,
        "samples": [p.time.size for p in prepared],
        "states": len(simulator.model.states),
        "reading": read - began,
        "weighing": done - read,
    }
    if found is None:
        return row
    leader = found.leader
    return row | {
        "estimated": len(found.hypotheses),
        "leader": [found.candidates[i].label for i in leader.members],
        "log_evidence": leader.log_evidence,
        "probability": float(found.probabilities[0]),
    }


def said(row: dict[str, Any]) -> str:
    """One line of a row."""
    what = " + ".join(row["leader"]) or "nothing" if "leader" in row else "not followed"
    size = f"{row['states']} states, {'+'.join(map(str, row['samples']))} samples"
    log = f"log evidence {row['log_evidence']:.6f}, " if "leader" in row else ""
    count = f"{row['estimated']} sets" if "leader" in row else ""
    return (
        f"{row['case']:28} {row['weighing']:7.2f} s (reading {row['reading']:.2f}; {size}; "
        f"{count}) {log}{what}"
    )


def main() -> int:
    """Run; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.likelihood_times",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--only", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--out", type=Path, metavar="FILE", help="where rows go, as JSON")
    parser.add_argument("--profile", choices=list(CASES), metavar="CASE")
    parser.add_argument("--here", metavar="CASE", help=argparse.SUPPRESS)
    parser.add_argument("--quick", action="store_true", help="two small cases")
    options = parser.parse_args()
    samples = FEW if options.quick else SAMPLES
    if options.profile:
        print(said(weighed(options.profile, samples, profiled=True)))
        return 0
    if options.here:
        print(json.dumps(weighed(options.here, samples)))
        return 0
    rows = []
    for name in QUICK if options.quick else options.only:
        command = [sys.executable, "-m", "benchmarks.likelihood_times", "--here", name]
        command += ["--quick"] * options.quick
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        rows.append(json.loads(done.stdout.splitlines()[-1]))
        print(said(rows[-1]), flush=True)
    print(f"median {np.median([row['weighing'] for row in rows]):.2f} s of processor time")
    if options.out:
        atomic_write_text(options.out, dump_json({"rows": rows}))
    return int(any("leader" not in row for row in rows))


if __name__ == "__main__":
    sys.exit(main())
