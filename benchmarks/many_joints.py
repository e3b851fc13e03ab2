"""Robots that lack dry friction in every joint: how many joints a diagnosis names.

    python -m benchmarks.many_joints [--quick] [--one-by-one] [--files NAME ...] [--seeds N]

MJCF files of dm_control and gymnasium with four to eight joints, their bases held. Friction of a
seventh of each joint's inertial force is planted in all joints by MuJoCo's own editor; encoders
have noise. Counted are the joints of which a law of dry friction is named first, names of something
else, and by how much ``explained.xml`` brings the error of the given file down on a recording held
out. --one-by-one takes away that laws at several joints are asked about at once. A full run writes
``results/many_joints.json`` after every case, or ``many_joints_one_by_one.json``; --quick takes the
hopper and fails where fewer joints are named than in the committed results.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import jaxsr
from benchmarks.mjcf_doors import error_of, explained
from benchmarks.mjcf_files import FILES, SUITE
from benchmarks.mjcf_plants import EFFECTS, NOISE, edited, run, write
from benchmarks.provenance import RESULTS, origin_of
from jaxsr._files import atomic_write_text, dump_json
from jaxsr.diagnosis.likelihood import loop
from jaxsr.models.formats.loading import read_plant_file
from jaxsr.models.formats.opening import Opened, read_robot

ROBOTS = "hopper", "walker", "cheetah", "pusher", "ant"
SAMPLES, SEED, BUDGET = 400, 35, 240.0
DRY_LAWS = (
    *("coulomb_friction", "stribeck_friction", "position_dependent_friction"),
    "load_dependent_friction",
)
"""Laws of dry friction: named first is any of them."""
RESULT = RESULTS / "many_joints.json"
ABLATED = RESULTS / "many_joints_one_by_one.json"


def case(name: str, seed: int, folder: Path) -> dict[str, Any]:
    """Plant friction in every joint of a file, diagnose it, write it back and run what it says."""
    file, effect = FILES[name], EFFECTS["coulomb"]
    assert effect is not None
    rng = np.random.default_rng([seed, sum(map(ord, name))])
    path = file.given(folder)
    size = run(file, file.spec().compile(), rng, SAMPLES).size
    values = {joint: effect.size(size[joint]) for joint in file.joints}
    truth = edited(file, values, effect)
    runs = [run(file, truth, rng, SAMPLES) for _ in range(3)]
    paths = [folder / f"run{k}.csv" for k in range(3)]
    for found, recording in zip(runs, paths, strict=True):
        write(truth, found, rng, recording)
    began = time.process_time()
    robot = read_robot(path, None, paths[:2])
    simulator = jaxsr.Simulator(robot.model)
    diagnosis = jaxsr.diagnose(simulator, paths[:2], seed=seed, budget=BUDGET)
    seconds = time.process_time() - began
    for key, text in Opened(simulator, robot).written_back(diagnosis, folder).items():
        (folder / key).write_text(text)
    before = error_of(read_plant_file(path)[0], runs[2])
    after = error_of(explained(folder), runs[2])
    mujoco.set_mjcb_passive(None)
    found = [
        (f["mechanism"], f["site"], round(f["probability"] or 0.0, 3)) for f in diagnosis.findings
    ]
    sites = {f"equation:v_{joint}" for joint in file.joints}
    named = {site for law, site, _ in found if law in DRY_LAWS and site in sites}
    return {
        "file": name,
        "seed": seed,
        "joints": len(file.joints),
        "named": len(named),
        "others": sum(law not in DRY_LAWS or site not in sites for law, site, _ in found),
        "verdict": diagnosis.verdict,
        "seconds": round(seconds, 1),
        "before": before,
        "after": after,
        "closed": round(1.0 - max(after - NOISE, 0.0) / max(before - NOISE, 1e-12), 4),
        "found": found,
    }


def main() -> int:
    """Run the cases and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--files", nargs="*", default=list(ROBOTS), choices=list(ROBOTS))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument(
        "--one-by-one", action="store_true", help="no laws at several joints at once"
    )
    parser.add_argument("--out", type=Path, help="file for the result; results/ by default")
    arguments = parser.parse_args()
    out = arguments.out or (ABLATED if arguments.one_by_one else RESULT)
    if arguments.quick and importlib.util.find_spec(SUITE) is None:
        print(f"{SUITE} is not installed: nothing to run")
        return 0
    if arguments.one_by_one:
        loop.abreast = lambda *_: []
    os.environ.setdefault("JAXSR_CLOCK", "processor")  # answers must not depend on other work
    names, cases = ["hopper"] if arguments.quick else arguments.files, list[dict[str, Any]]()
    with tempfile.TemporaryDirectory() as root:
        for seed in range(SEED, SEED + arguments.seeds):
            for name in names:
                folder = Path(root) / f"{name}{seed}"
                folder.mkdir()
                cases.append(case(name, seed, folder))
                print(_line(cases[-1]), flush=True)
                if not arguments.quick:  # a run that is ended early leaves what it has
                    result = {**origin_of(SEED), "summary": _summary(cases), "cases": cases}
                    atomic_write_text(out, dump_json(result))
    print(_summary(cases))
    if arguments.quick:
        known = json.loads(RESULT.read_text())["cases"]
        wanted = next(c["named"] for c in known if c["file"] == "hopper")
        return 0 if cases[0]["named"] >= wanted else 1
    return 0


def _line(row: dict[str, Any]) -> str:
    head = f"{row['file']:9} {row['named']} of {row['joints']} joints, {row['others']} others"
    return f"{head}, {row['verdict']}, {row['seconds']:.0f} s, closed {row['closed']:.1%}"


def _summary(cases: list[dict[str, Any]]) -> dict[str, Any]:
    joints = sum(c["joints"] for c in cases)
    return {
        "robots": len(cases),
        "joints_named": f"{sum(c['named'] for c in cases)} of {joints}",
        "other_findings": sum(c["others"] for c in cases),
        "undecided": sum(c["verdict"] == "undecided" for c in cases),
        "closed_median": float(np.median([c["closed"] for c in cases])),
        "seconds_median": float(np.median([c["seconds"] for c in cases])),
    }


if __name__ == "__main__":
    sys.exit(main())
