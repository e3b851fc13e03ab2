"""Robots as users have them: MJCF files diagnosed, explained in their own words, and run again.

    python -m benchmarks.mjcf_doors [--quick] [--doors] [--files NAME ...] [--seeds N]

*Doors*: one plant as a TOML written by hand and as MJCF, the same recordings: both must name the
same law, each constant inside the other's interval. *Zoo*: files of dm_control and gymnasium, an
effect planted in one joint by MuJoCo's own editor, encoders with noise. Counted are the joint, the
law named first, findings beside it, and by how much ``explained.xml``, loaded and run by MuJoCo
with its callback, brings the error of the given file down on a recording held out. A full run
writes ``results/mjcf_doors.json`` after every case; --quick takes one door and one case and checks
both.
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
from benchmarks.mjcf_files import FILES, SUITE, File
from benchmarks.mjcf_plants import DRY, EFFECTS, NOISE, Run, edited, run, write
from benchmarks.provenance import RESULTS, origin_of
from jaxsr._files import atomic_write_text, dump_json
from jaxsr.models.formats.loading import read_plant_file
from jaxsr.models.formats.opening import Opened, read_robot
from jaxsr.models.formats.plant import Plant
from jaxsr.models.formats.running import held, run_steps

SAMPLES, SEED, BUDGET = 400, 35, 240.0
HORIZON = 1.0
"""Length in s of the runs by which a file is compared with what was recorded."""
PENDULUM = """\
<mujoco model="pendulum">
  <compiler angle="radian"/>
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <body name="rod" pos="0 0 1">
      <joint name="hinge" axis="0 1 0" damping="0.02"/>
      <inertial pos="0 0 -0.4" mass="0.7" diaginertia="0.02 0.02 0.001"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="drive" joint="hinge" gear="2" ctrlrange="-2 2" ctrllimited="true"/>
  </actuator>
</mujoco>
"""
BY_HAND = """\
[model]
name = "pendulum"
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
input_hold = "zero"
[equations]
q = "v"
v = "k*u - d*v - m*g*l*sin(q)"
[inertia]
v = { v = "J + m*l**2" }
[readings]
y = "q"
[parameters]
k = { value = 2.0, unit = "N*m", bounds = [1.0, 4.0] }
d = { value = 0.02, unit = "N*m*s", bounds = [0.0, 0.2] }
m = { value = 0.7, unit = "kg" }
l = { value = 0.4, unit = "m" }
J = { value = 0.02, unit = "kg*m^2" }
g = { value = 9.81, unit = "m/s^2" }
[units]
q = "rad"
v = "rad/s"
u = "1"
y = "rad"
[columns]
u = "drive_ctrl"
y = "hinge_pos"
"""


def doors(folder: Path, seed: int) -> dict[str, Any]:
    """Diagnose one plant through both doors."""
    m = mujoco.MjModel.from_xml_string(PENDULUM)
    m.opt.timestep = 0.0005
    m.dof_frictionloss[0] = 0.15
    m.dof_solref[0], m.dof_solimp[0] = DRY
    rng, files = np.random.default_rng(seed), []
    (folder / "pendulum.xml").write_text(PENDULUM)
    (folder / "pendulum_by_hand.toml").write_text(BY_HAND)
    for k in range(3):
        found = run(_door_file(folder), m, rng, SAMPLES)
        files.append(folder / f"run{k}.csv")
        write(m, found, rng, files[-1])
    by_hand = jaxsr.Simulator.from_file(folder / "pendulum_by_hand.toml")
    robot = read_robot(folder / "pendulum.xml", None, files[:2])
    rows = {}
    for name, simulator in (("toml", by_hand), ("mjcf", jaxsr.Simulator(robot.model))):
        diagnosis = jaxsr.diagnose(simulator, files[:2], seed=seed, budget=BUDGET)
        rows[name] = [
            {"law": f["mechanism"], "site": f["site"], "constants": _constants(f)}
            for f in diagnosis.findings
        ]
    same = [r["law"] for r in rows["toml"]] == [r["law"] for r in rows["mjcf"]]
    inside = same and all(
        low <= other["constants"][name][0] <= high
        for a, b in ((rows["toml"], rows["mjcf"]), (rows["mjcf"], rows["toml"]))
        for own, other in zip(a, b, strict=True)
        for name, (_, low, high) in own["constants"].items()
    )
    return {"seed": seed, **rows, "same": same, "inside": inside}


def _door_file(folder: Path) -> Any:
    class Here(File):
        """A file that lies in a folder of its own."""

        where = folder / "pendulum.xml"

    return Here("", "", ("hinge",))


def _constants(finding: dict[str, Any]) -> dict[str, Any]:
    return {n: (p["value"], *p["ci95"]) for n, p in finding["parameters"].items() if p.get("ci95")}


def case(name: str, effect_name: str, seed: int, folder: Path) -> dict[str, Any]:
    """Plant an effect in a file, diagnose it, write it back and run what was written."""
    file, effect = FILES[name], EFFECTS[effect_name]
    rng = np.random.default_rng([seed, sum(map(ord, name + effect_name))])
    path = file.given(folder)
    given = file.spec().compile()
    joint = file.joints[int(rng.integers(len(file.joints)))]
    size = run(file, file.spec().compile(), rng, SAMPLES).size[joint]
    truth, value = given, 0.0
    if effect is not None:
        value = effect.size(size)
        truth = edited(file, {joint: value}, effect)
    runs = [run(file, truth, rng, SAMPLES) for _ in range(3)]
    paths = [folder / f"run{k}.csv" for k in range(3)]
    for found, recording in zip(runs, paths, strict=True):
        write(truth, found, rng, recording)
    began = time.process_time()
    robot = read_robot(path, None, paths[:2])
    simulator = jaxsr.Simulator(robot.model)
    diagnosis = jaxsr.diagnose(simulator, paths[:2], seed=seed, budget=BUDGET)
    seconds = time.process_time() - began
    files = Opened(simulator, robot).written_back(diagnosis, folder)
    for key, text in files.items():
        (folder / key).write_text(text)
    plain = read_plant_file(path)[0]
    before = error_of(plain, runs[2])
    after = error_of(explained(folder), runs[2])
    mujoco.set_mjcb_passive(None)
    return _scored(
        {
            "file": name,
            "effect": effect_name,
            "joint": joint,
            "value": value,
            "seed": seed,
            "verdict": diagnosis.verdict,
            "seconds": round(seconds, 1),
            "found": [
                [f["mechanism"], f["site"], round(f["probability"] or 0.0, 3)]
                for f in diagnosis.findings
            ],
            "constants": [_constants(f) for f in diagnosis.findings],
            "written": sorted(files),
            "before": before,
            "after": after,
        }
    )


def _scored(row: dict[str, Any]) -> dict[str, Any]:
    """Return the row of a case with its marks; a finding that was not planted is a false one."""
    effect, findings, joint = EFFECTS[row["effect"]], row["found"], row["joint"]
    if effect is None:
        return {**row, "right": row["verdict"] == "nothing", "false": len(findings)}
    values = ("damping", "armature", "stiffness")
    sites = {f"equation:v_{joint}", *(f"parameter:{value}_{joint}" for value in values)}
    if row["effect"] == "rotor":
        file = FILES[row["file"]]
        sites |= {f"parameter:gain_{gain}" for j, gain in file.gains.items() if j == joint}
        sites |= {f"parameter:mass_{body}" for j, body in file.bodies.items() if j == joint}
    there = [f for f in findings if f[1] in sites]
    planted = [f for f in there if f[0] in effect.names]
    law = bool(findings) and findings[0] in planted
    closed = 1.0 - max(row["after"] - NOISE, 0.0) / max(row["before"] - NOISE, 1e-12)
    return {
        **row,
        "joint_right": bool(there),
        "law_first": law,
        "false": len(findings) - len(planted),
        "closed": round(closed, 4),
        "right": law and row["verdict"] != "undecided",
    }


def explained(folder: Path) -> Plant:
    """Load ``explained.xml``, and let its callback act."""
    plant, path = read_plant_file(folder / "explained.xml")[0], folder / "explained.py"
    if path.exists():
        spec = importlib.util.spec_from_file_location("explained", path)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        module.install(plant.m)
    return plant


def error_of(plant: Plant, found: Run) -> float:
    """Return the error of positions in runs of `HORIZON`, by the motion."""
    length = max(round(HORIZON / (found.time[1] - found.time[0])), 2)
    n, total, count = plant.m.nv, 0.0, 0
    scale = found.states[:, :n].std(axis=0)
    # The error is that of the file, not of its integrator.
    refine = max(1, round(plant.m.opt.timestep / 5e-4))
    controls = held(found.time, found.controls, "zero")
    for start in range(0, found.time.size - length + 1, length):
        part = slice(start, start + length)
        path = run_steps(plant, found.states[start], found.time[part], controls, refine)
        error = (path[:, :n] - found.states[part, :n]) / scale
        total += float(np.sum(np.minimum(np.nan_to_num(error, nan=10.0) ** 2, 100.0)))
        count += error.size
    return float(np.sqrt(total / count))


def main() -> int:
    """Run the cases and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--doors", action="store_true", help="the doors alone")
    parser.add_argument("--files", nargs="*", default=list(FILES), choices=list(FILES))
    parser.add_argument("--effects", nargs="*", default=list(EFFECTS), choices=list(EFFECTS))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--skip-doors", action="store_true", help="the zoo alone")
    parser.add_argument("--resume", action="store_true", help="keep the cases of the result file")
    parser.add_argument("--out", type=Path, help="file for the result; results/ by default")
    arguments = parser.parse_args()
    # Answers are judged, and must not depend on what runs beside.
    os.environ.setdefault("JAXSR_CLOCK", "processor")
    with tempfile.TemporaryDirectory() as root:
        return _all(arguments, Path(root))


def _all(arguments: argparse.Namespace, root: Path) -> int:
    seeds = range(SEED, SEED + arguments.seeds)
    through = []
    for seed in [] if arguments.skip_doors else seeds:
        folder = root / f"doors{seed}"
        folder.mkdir()
        through.append(doors(folder, seed))
        print(
            f"doors {seed}: same {through[-1]['same']}, inside {through[-1]['inside']}", flush=True
        )
    names = ["pendulum"] if arguments.quick else [] if arguments.doors else arguments.files
    if arguments.quick and importlib.util.find_spec(SUITE) is None:
        print(f"{SUITE} is not installed: the doors alone")
        names = []
    effects = ["quadratic"] if arguments.quick else arguments.effects
    wanted = [(s, n, e) for s in seeds for n in names for e in effects]
    out = arguments.out or RESULTS / "mjcf_doors.json"
    cases = _there(out) if arguments.resume else []
    done = {(c["seed"], c["file"], c["effect"]) for c in cases}
    for seed, name, effect in wanted:
        if (seed, name, effect) in done:
            continue
        folder = root / f"{name}_{effect}_{seed}"
        folder.mkdir()
        cases.append(case(name, effect, seed, folder))
        print(_line(cases[-1]), flush=True)
        if not arguments.quick:  # a run that is ended early leaves what it has
            summary = {**_summary(cases), "left": len(wanted) - len(cases)}
            result = {**origin_of(SEED), "doors": through, "summary": summary, "cases": cases}
            atomic_write_text(out, dump_json(result))
    if cases:
        print(_summary(cases))
    if arguments.quick:
        good = through[0]["same"] and through[0]["inside"]
        return 0 if good and all(c["right"] and c["closed"] > 0.9 for c in cases) else 1
    return 0


def _there(path: Path) -> list[dict[str, Any]]:
    """Return the cases of an earlier run, with the marks of today."""
    if not path.exists():
        return []
    return [_scored(row) for row in json.loads(path.read_text())["cases"]]


def _line(row: dict[str, Any]) -> str:
    closed = f"closed {row['closed']:.1%}" if "closed" in row else ""
    found = ", ".join(f"{m} at {s} {p}" for m, s, p in row["found"]) or row["verdict"]
    mark = "+" if row["right"] else "-"
    head = f"{mark} {row['file']:16} {row['effect']:10} {row['joint']:9}"
    return f"{head} {row['seconds']:5.0f} s {closed:14} {found}"


def _summary(cases: list[dict[str, Any]]) -> dict[str, Any]:
    planted = [c for c in cases if "closed" in c]
    nothing = [c for c in cases if "closed" not in c]
    out: dict[str, Any] = {"cases": len(cases), "files": len({c["file"] for c in cases})}
    if planted:
        out |= {
            k: f"{sum(c[k] for c in planted)} of {len(planted)}"
            for k in ("joint_right", "law_first")
        }
        out["closed_median"] = float(np.median([c["closed"] for c in planted]))
    out["nothing"] = f"{sum(c['right'] for c in nothing)} of {len(nothing)}"
    out["with_false_findings"] = f"{sum(c['false'] > 0 for c in cases)} of {len(cases)}"
    out["findings"] = sum(len(c["found"]) for c in cases)
    out["false_findings"] = sum(c["false"] for c in cases)
    out["seconds_median"] = float(np.median([c["seconds"] for c in cases]))
    return out


if __name__ == "__main__":
    sys.exit(main())
