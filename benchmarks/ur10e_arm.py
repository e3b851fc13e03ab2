"""Six joints of the UR10e in one rigid-body model: what friction explains, joint by joint.

    python -m benchmarks.ur10e_arm [--quick]

The model is written from the owners' URDF; links' masses and drives' inertias are free. Friction
is estimated on the identification file in the weak view, all joints at once, and judged on the two
held-out files by the relative current error: rms of what an equation leaves over rms of the motor's
torque. Then `jaxsr.diagnose` gets the rigid arm and the identification file, and nothing else. A
full run writes ``results/ur10e_arm.json``; --quick takes the rigid arm and the whole set on the
identification file alone, and fails if that misses its committed errors by a tenth.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

import jaxsr
from benchmarks.provenance import origin_of
from benchmarks.real_recordings import HALF_WIDTH, ROOT, SEED
from jaxsr._files import atomic_write_text, dump_json
from jaxsr._result import InputError
from jaxsr.datasets import fetch
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import prepare, state_scale
from jaxsr.diagnosis.shooting.arena import neutral_values, parameter_bounds
from jaxsr.diagnosis.shooting.enter import active_parameters
from jaxsr.diagnosis.weak.weak_grid import WeakGrid
from jaxsr.diagnosis.weak.weak_system import WeakSystem, weak_system

RESULT = Path(__file__).parent / "results" / "ur10e_arm.json"
FILES = ("ur10e_ident.csv", "ur10e_unloaded.csv", "ur10e_ptp.csv")
ADDED = {
    "rigid": (),
    "+ viscous": ("viscous_damping",),
    "+ Coulomb": ("viscous_damping", "coulomb_friction"),
}
OWNERS = {
    "Fv": (21.26, 20.22, 10.38, 3.58, 2.49, 3.03),
    "Fc": (12.55, 13.27, 4.99, 2.00, 2.69, 2.30),
}
"""Published by the owners of the arm, from the same identification file, N m s/rad and N m."""
ROUNDS, TOLERANCE = 4, 0.1
BUDGET = 300.0
"""Seconds for the diagnosis; free runs on recordings held out come on top."""


def estimate(system: WeakSystem, super_model: SuperModel, members: tuple[int, ...]) -> np.ndarray:
    """Least squares within bounds, every equation weighed by what it leaves."""
    active = np.asarray(active_parameters(super_model, members))
    low, high = (bound[active] for bound in parameter_bounds(super_model))
    theta, equations = system.theta.copy(), np.unique(system.state)
    size = {k: 1.0 for k in equations}
    for _ in range(ROUNDS):
        weight = 1.0 / np.array([size[k] for k in system.state])
        start = system.theta[active]
        found = lsq_linear(
            system.jacobian[:, active] * weight[:, None],
            -system.residual * weight,
            (low - start - 1e-9, high - start + 1e-9),
        )
        theta[active] = start + found.x
        left = system.at(theta)
        size = {k: float(np.sqrt(np.mean(left[system.state == k] ** 2))) for k in equations}
    return theta


def relative_errors(system: WeakSystem, theta: np.ndarray) -> list[float]:
    """Return rms of what an equation leaves over rms of its input side, joint by joint."""
    left = system.at(theta)
    rows = [system.state == k for k in np.unique(system.state)]
    return [
        float(np.sqrt(np.mean(left[r] ** 2) / np.mean(system.input_side[r] ** 2))) for r in rows
    ]


def run(folder: Path, quick: bool) -> dict[str, Any]:
    """Estimate on the first file; return errors on all, and the constants."""
    model = jaxsr.Simulator.from_file(folder / "ur10e_arm.toml").model
    files = FILES[:1] if quick else FILES
    prepared = [prepare(model, [folder / name]) for name in files]
    offered = force_candidates(model, state_scale(model, prepared[0]))
    wanted = [c for c in offered if c.mechanism in ADDED["+ Coulomb"]]
    super_model = SuperModel.build(model, wanted)
    simulator, start = jaxsr.Simulator(super_model.model), neutral_values(super_model)
    grids = [WeakGrid.build(model, items, HALF_WIDTH) for items in prepared]
    systems = [weak_system(simulator, grid, start) for grid in grids]
    errors, constants = {}, {}
    for name, mechanisms in ADDED.items():
        if quick and name == "+ viscous":
            continue
        members = tuple(i for i, c in enumerate(wanted) if c.mechanism in mechanisms)
        theta = estimate(systems[0], super_model, members)
        errors[name] = {
            file: relative_errors(system, theta)
            for file, system in zip(files, systems, strict=True)
        }
        constants[name] = values(super_model, members, theta)
    return {"relative_current_error": errors, "constants": constants, "owners": OWNERS}


def diagnosed(folder: Path) -> dict[str, Any]:
    """What `diagnose` finds by itself, and its force errors on the files held out."""
    simulator = jaxsr.Simulator.from_file(folder / "ur10e_arm.toml")
    train, held = [folder / FILES[0]], [folder / name for name in FILES[1:]]
    found = jaxsr.diagnose(simulator, train, held_out=held, seed=SEED, budget=BUDGET)
    kept = "site", "mechanism", "probability", "parameters", "alternatives"
    return {
        "verdict": found.verdict,
        "budget_s": BUDGET,
        "seconds": found.document["provenance"]["seconds"],
        "findings": [{k: row[k] for k in kept} for row in found.findings],
        "fit": found.fit,
    }


def values(
    super_model: SuperModel, members: tuple[int, ...], theta: np.ndarray
) -> dict[str, list[float]]:
    """Constants of friction by joint."""
    found: dict[str, dict[str, float]] = {}
    for i in members:
        for name, value in super_model.own_values(i, theta).items():
            found.setdefault(name, {})[super_model.candidates[i].site] = value
    return {name: [by_site[site] for site in sorted(by_site)] for name, by_site in found.items()}


def show(result: dict[str, Any]) -> None:
    """Print the tables."""
    print("relative current error, joints 1 to 6")
    for name, by_file in result["relative_current_error"].items():
        for file, errors in by_file.items():
            print(f"  {name:10s} {file:20s} " + " ".join(f"{e:6.3f}" for e in errors))
    if "diagnosis" in result:
        print(f"diagnose: {result['diagnosis']['verdict']}")
        for row in sorted(result["diagnosis"]["findings"], key=lambda r: r["site"]):
            constants = ", ".join(f"{k} {v['value']:.3g}" for k, v in row["parameters"].items())
            print(f"  {row['site']} {row['mechanism']} ({constants}), {row['probability']:.2f}")
        for site, error in sorted(result["diagnosis"]["fit"]["force"].items()):
            pairs = [
                f"{s} {p['recalibrated']:.3f} to {p['explained']:.3f}"
                for s, p in error.items()
                if isinstance(p, dict)
            ]
            print(f"  {site} relative force error: {', '.join(pairs)}")
    for name, own in result["constants"]["+ Coulomb"].items():
        print(f"{name}       " + " ".join(f"{v:7.2f}" for v in own))
        print(f"{name} owners" + " ".join(f"{v:7.2f}" for v in OWNERS[name]))


def missed(result: dict[str, Any]) -> list[str]:
    """Return the joints whose error on the identification file is above the committed one."""
    if not RESULT.exists():
        return []
    committed = json.loads(RESULT.read_text())["relative_current_error"]["+ Coulomb"][FILES[0]]
    errors = result["relative_current_error"]["+ Coulomb"][FILES[0]]
    pairs = enumerate(zip(errors, committed, strict=True), start=1)
    return [f"joint {k}: {new:.3f} {old:.3f}" for k, (new, old) in pairs if new > old * 1.1]


def main() -> int:
    """Run; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="identification file, writes nothing")
    quick = parser.parse_args().quick
    local = ROOT.parent / "shared" / "recordings"
    if local.is_dir():
        os.environ.setdefault("JAXSR_DATA_DIR", str(local))
    with tempfile.TemporaryDirectory() as scratch:
        try:
            fetch("ur10e", scratch)
        except InputError as error:
            print(f"not run, the recordings are not to be had: {error}")
            return 0
        result = run(Path(scratch), quick)
        if not quick:
            result["diagnosis"] = diagnosed(Path(scratch))
    show(result)
    if not quick:
        atomic_write_text(RESULT, dump_json({**result, "provenance": origin_of(SEED)}))
        return 0
    lost = missed(result)
    for line in lost:
        print(f"more is left than in the committed results: {line}", file=sys.stderr)
    return 1 if lost else 0


if __name__ == "__main__":
    sys.exit(main())
