"""Real recordings through every door: EMPS as TOML, MJCF, URDF and FMU, the UR10e but as an FMU.

    python -m benchmarks.format_doors [--quick] [--only emps,ur10e] [--doors toml,mjcf,urdf,fmu]

The bundled model file of each rig is written as MJCF and as URDF by hand, EMPS in C as well and
compiled as an FMU where a compiler is, with a sidecar that frees the same parameters. First the
accelerations of all doors are compared at random states and inputs: they are one model. Then each
is diagnosed on the same recordings, and named are the findings with their constants, each of which
has to lie inside the other doors' intervals. ``results/format_doors.json`` keeps a row of every
door, written when it has been run; --quick compares the accelerations alone.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import jaxsr
from benchmarks.fmu_plants import cart_fmu, compiler
from benchmarks.provenance import RESULTS, origin_of
from benchmarks.real_recordings import ROOT
from jaxsr._files import atomic_write_text, dump_json
from jaxsr._result import InputError
from jaxsr.datasets import fetch
from jaxsr.datasets.drives import HEAVIEST_ROTOR, ROTOR
from jaxsr.datasets.fetch import _locate
from jaxsr.datasets.registry import DATASETS
from jaxsr.datasets.ur10e import GAINS
from jaxsr.expressions import evaluate
from jaxsr.models import Model
from jaxsr.models.formats.fmu import read_fmu
from jaxsr.models.formats.opening import read_robot
from jaxsr.models.formats.urdf import read_urdf
from jaxsr.models.formats.write_back import _welded
from jaxsr.recordings import Recording, read_recording
from jaxsr.recordings.decimation import decimated

SEED, BUDGET = 36, 400.0
SAME = 1e-6
"""Difference that an MJCF's six digits make, MuJoCo's own writer having made it of the URDF."""
DOORS = ("toml", "mjcf", "urdf", "fmu")
CART_XML = """\
<mujoco model="emps">
  <option gravity="0 0 0" timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" damping="200"/>
      <inertial pos="0 0 0" mass="95" diaginertia="1 1 1"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="slide"/></actuator>
</mujoco>
"""
CART_URDF = """\
<robot name="emps">
  <link name="rail"/>
  <joint name="slide" type="prismatic">
    <parent link="rail"/>
    <child link="cart"/>
    <axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" effort="1000" velocity="10"/>
    <dynamics damping="200" friction="0"/>
  </joint>
  <link name="cart">
    <inertial>
      <mass value="95"/>
      <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>
    </inertial>
  </link>
</robot>
"""
CART_TABLE = """\
[model]
base = "{base}"
input_hold = "linear"
[parameters]
mass_cart = {{ bounds = [50.0, 150.0] }}
damping_slide = {{ bounds = [0.0, 1000.0] }}
[columns]
{force} = "motor_force_N"
q_slide_meas = "position_m"
"""
CART_STARTS = "0, 0, 0, 0, 0, 95.0, 200.0, 0"
CART_UNIT = """\
[model]
base = "emps.fmu"
states = ["q", "v"]
inputs = ["F"]
outputs = ["q_meas"]
input_hold = "linear"
[readings]
q_meas = "q"
[parameters]
m = { value = 95.0, unit = "kg", bounds = [50.0, 150.0] }
c = { value = 200.0, unit = "N*s/m", bounds = [0.0, 1000.0] }
[columns]
F = "motor_force_N"
q_meas = "position_m"
"""
Door = tuple[Model, list[Recording], list[Recording]]


def emps(folder: Path) -> dict[str, Door]:
    """Return the prismatic drive behind each door: model, recordings, those held out."""
    # A twentieth of the samples, 20 ms apart: the motion's shortest time is a tenth of a second.
    names = "emps_train.csv", "emps_pulses.csv"
    data = [decimated(read_recording(folder / n), 20, {"motor_force_N": "linear"}) for n in names]
    doors: dict[str, Door] = {}
    given = jaxsr.Simulator.from_file(folder / "emps.toml").model
    doors["toml"] = given, data[:1], data[1:]
    for ending, text, force in (("xml", CART_XML, "motor"), ("urdf", CART_URDF, "slide")):
        path = _written(folder, f"emps.{ending}", text, CART_TABLE, force=force)
        doors["mjcf" if ending == "xml" else ending] = (
            read_robot(path, None, data[:1]).model,
            data[:1],
            data[1:],
        )
    if compiler() is None or importlib.util.find_spec("fmpy") is None:
        print("emps: no C compiler for Linux or no FMPy: not as an FMU")
        return doors
    unit = cart_fmu(folder, name="emps", starts=CART_STARTS)
    (folder / "emps_fmu.toml").write_text(CART_UNIT)
    opened = read_fmu(unit, folder / "emps_fmu.toml", data[:1])
    doors["fmu"] = opened.simulator.model, data[:1], data[1:]
    return doors


def _written(folder: Path, name: str, text: str, table: str, **fields: str) -> Path:
    """Write a robot and its sidecar into a folder of their own."""
    home = folder / Path(name).suffix[1:]
    home.mkdir(exist_ok=True)
    (home / name).write_text(text)
    (home / name).with_suffix(".toml").write_text(table.format(base=name, **fields))
    return home / name


def ur10e(folder: Path) -> dict[str, Door]:
    """Return the arm of six joints behind each door."""
    names = "ur10e_ident.csv", "ur10e_unloaded.csv", "ur10e_ptp.csv"
    data = [_with_torques(read_recording(folder / n)) for n in names]
    given = jaxsr.Simulator.from_file(folder / "ur10e_arm.toml").model
    doors: dict[str, Door] = {"toml": (given, data[:1], data[1:])}
    dataset = DATASETS["ur10e"]
    source = next(s for s in dataset.sources if s.path.endswith(".urdf"))
    text = _locate(dataset, source).read_text()
    (folder / "ur10e.urdf").write_text(text)
    plant, _ = read_urdf(folder / "ur10e.urdf")
    xml = plant.mjcf
    for name, gain in zip(plant.joint_names, GAINS, strict=True):
        start = xml.index(f'<joint name="{name}"')
        xml = f'{xml[:start]}<joint armature="{ROTOR}"{xml[start + 6 :]}'
        motor = xml.index(f'name="{name}"', xml.index("<actuator>"))
        end = xml.index("/>", motor)
        inner = xml[motor:end].replace('gear="1 0 0 0 0 0"', "").replace('gear="1"', "")
        xml = f'{xml[:motor]}{inner} gear="{gain}"{xml[end:]}'
    for ending, robot, column in (("xml", xml, "i"), ("urdf", text, "tau")):
        lines = ["[model]", 'base = "{base}"', 'input_hold = "linear"', "[parameters]"]
        lines += _masses(given, plant)
        for part in plant.joints:
            value = f"value = {ROTOR}, " if ending == "urdf" else ""
            lines.append(f"armature_{part} = {{{{ {value}bounds = [0.0, {HEAVIEST_ROTOR}] }}}}")
        lines.append("[columns]")
        for k, u in enumerate(plant.inputs, start=1):
            q, v = plant.positions[k - 1], plant.rates[k - 1]
            lines += [f'{u} = "{column}{k}"', f'{q}_meas = "q{k}"', f'{v}_meas = "qd{k}"']
        path = _written(folder, f"ur10e.{ending}", robot, "\n".join(lines) + "\n")
        doors["mjcf" if ending == "xml" else ending] = (
            read_robot(path, None, data[:1]).model,
            data[:1],
            data[1:],
        )
    return doors


def _masses(given: Model, plant: Any) -> list[str]:
    """Free the masses that the TOML frees, inside the same bounds."""
    lines = []
    for k in range(1, plant.m.njnt + 1):
        body = int(plant.m.jnt_bodyid[k - 1])
        bounds = given.parameters[f"m{k}"].bounds
        assert plant.m.body_mass[_welded(plant, body)].sum() > 0.0
        if bounds is not None:
            lines.append(f"mass_{plant.bodies[body]} = {{{{ bounds = {list(bounds)} }}}}")
    return lines


def _with_torques(recording: Recording) -> Recording:
    """Add torques at the joints: a URDF's effort is one, a current is not."""
    torques = {f"tau{k}": gain * recording.channels[f"i{k}"] for k, gain in enumerate(GAINS, 1)}
    return replace(recording, channels={**recording.channels, **torques})


CASES: dict[str, Callable[[Path], dict[str, Door]]] = {"emps": emps, "ur10e": ur10e}


def accelerations(model: Model, q: np.ndarray, v: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Return what the formulas say at random points, shapes (points, joints)."""
    n = q.shape[1]
    positions = [s for s in model.states if s[0] == "q"][:n]
    rates = [s for s in model.states if s not in positions][:n]
    env: dict[str, Any] = {model.time: 0.0, **{p: x.value for p, x in model.parameters.items()}}
    env |= dict(zip(positions, q.T, strict=True)) | dict(zip(rates, v.T, strict=True))
    scale = _scale(model)
    env |= {u: force[:, k] / scale[k] for k, u in enumerate(model.inputs)}
    shape = (len(q),)
    right = np.stack(
        [np.broadcast_to(evaluate(model.equation_terms[s], env, "numpy"), shape) for s in rates], 1
    )
    mass = np.zeros((len(q), n, n))
    if not model.inertia_terms:
        return right
    for i, row in enumerate(rates):
        for column, term in model.inertia_terms[row].items():
            mass[:, i, rates.index(column)] = evaluate(term, env, "numpy")
    return np.linalg.solve(mass, right[..., None])[..., 0]


def _scale(model: Model) -> list[float]:
    """Return the torque of a unit of each input: currents have the gains of the drives."""
    currents = len(model.inputs) == len(GAINS) and model.column(model.inputs[0])[0] == "i"
    return list(GAINS) if currents else [1.0] * len(model.inputs)


def alike(doors: dict[str, Door]) -> float:
    """Return the largest difference of accelerations between doors, relative to their size."""
    rng = np.random.default_rng(SEED)
    n = len(doors["toml"][0].inputs)
    q, v, force = (rng.uniform(-1.0, 1.0, (32, n)) * size for size in (2.0, 1.0, 30.0))
    found = [accelerations(model, q, v, force) for model, _, _ in doors.values()]
    size = np.abs(found[0]).max(axis=0)
    return float(max(np.max(np.abs(other - found[0]) / size) for other in found[1:]))


def diagnosed(door: Door) -> dict[str, Any]:
    """Diagnose one door."""
    model, train, held_out = door
    simulator = jaxsr.Simulator(model)
    found = jaxsr.diagnose(simulator, train, held_out=held_out, seed=SEED, budget=BUDGET)
    order = {s: k for k, s in enumerate(x for x in model.states)}
    rows = [
        {
            "joint": order.get(str(f["site"]).partition(":")[2], -1) % (len(order) // 2) + 1,
            "law": f["mechanism"],
            "probability": f["probability"],
            "constants": {
                n.partition("_")[0]: (p["value"], *p["ci95"])
                for n, p in f["parameters"].items()
                if p.get("ci95")
            },
        }
        for f in found.findings
    ]
    rows.sort(key=lambda r: (r["joint"], r["law"]))
    provenance = found.document["provenance"]
    keys = "seconds", "stopped_by"
    return {"verdict": found.verdict, **{k: provenance[k] for k in keys}, "findings": rows}


def agreed(rows: dict[str, dict[str, Any]]) -> dict[str, bool]:
    """Tell whether doors name the same, and whether constants lie in each other's intervals."""
    named = [[(r["joint"], r["law"]) for r in row["findings"]] for row in rows.values()]
    same = all(one == named[0] for one in named)
    inside = same and all(
        low <= other["constants"][name][0] <= high
        for a in rows.values()
        for b in rows.values()
        for own, other in zip(a["findings"], b["findings"], strict=True)
        for name, (_, low, high) in own["constants"].items()
    )
    return {"same": same, "inside": inside}


def main() -> int:
    """Run; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="accelerations alone, writes nothing")
    parser.add_argument("--only", default=",".join(CASES))
    parser.add_argument("--doors", default=",".join(DOORS))
    arguments = parser.parse_args()
    local = ROOT.parent / "shared" / "recordings"
    if local.is_dir():
        os.environ.setdefault("JAXSR_DATA_DIR", str(local))
    out = RESULTS / "format_doors.json"
    result: dict[str, Any] = json.loads(out.read_text()) if out.exists() else {}
    for name in arguments.only.split(","):
        with tempfile.TemporaryDirectory() as scratch:
            try:
                fetch(name, scratch)
            except InputError as error:
                print(f"{name} not run, the recordings are not to be had: {error}")
                continue
            doors = CASES[name](Path(scratch))
            difference = alike(doors)
            print(f"{name}: accelerations of all doors agree to {difference:.1g}", flush=True)
            if not difference <= SAME:
                return 1
            if arguments.quick:
                continue
            rows = result.get(name, {}).get("doors", {})
            for door in (d for d in arguments.doors.split(",") if d in doors):
                rows[door] = diagnosed(doors[door]) | {"provenance": origin_of(SEED)}
                print(f"  {door}: {rows[door]}", flush=True)
                result[name] = {"difference": difference, "doors": rows, **agreed(rows)}
                atomic_write_text(out, dump_json(result))
            print(f"  same {result[name]['same']}, inside {result[name]['inside']}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
