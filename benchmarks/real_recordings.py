"""Diagnoses of the real recordings against what the project promises to show on them.

    python -m benchmarks.real_recordings [--quick] [--only emps,balls]

Recordings come from the folder in JAXSR_DATA_DIR (by default ../shared/recordings beside the
repository, where it exists), else from their origin. A full run writes
``results/real_recordings.json``; --quick (EMPS and two balls) writes nothing and ends with
status 1 if a target that the committed results met is missed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

import jaxsr
from benchmarks import real_rigs
from benchmarks.provenance import origin_of
from benchmarks.recording_case import (
    ROOT,
    SEED,
    Case,
    alternatives,
    diagnose,
    effects,
    named,
    recalibrated,
    rmse,
    values_of,
)
from jaxsr._files import atomic_write_text, dump_json
from jaxsr._result import InputError
from jaxsr.datasets import fetch
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.result import Diagnosis
from jaxsr.diagnosis.setup import prepare, state_scale
from jaxsr.diagnosis.weak.weak_grid import WeakGrid
from jaxsr.diagnosis.weak.weak_system import WeakSystem, weak_system
from jaxsr.models import Model
from jaxsr.models.segments import Prepared
from jaxsr.views import WeakView

RESULT = Path(__file__).parent / "results" / "real_recordings.json"
HALF_WIDTH = 0.12  # s, of the test functions in which the promised force errors are stated

LIGHT = (
    *("tennis_ball", "whiffle_ball_1", "whiffle_ball_2", "yellow_whiffle_ball"),
    *("orange_whiffle_ball", "volleyball", "blue_basketball", "green_basketball"),
)
DENSE = ("bowling_ball", "golf_ball", "baseball")
QUICK_BALLS = ("tennis_ball", "bowling_ball")
DRAG = {"viscous_damping": "p = 1", "quadratic_drag": "p = 2", "power_law_drag": "p free"}
TRAP = {
    "nothing added": (),
    "constant force": ("constant_force",),
    "Coulomb": ("coulomb_friction",),
    "Coulomb + constant force": ("coulomb_friction", "constant_force"),
    "Coulomb + asymmetric": ("coulomb_friction", "asymmetric_friction"),
}


def whole_rmse(found: Diagnosis, path: Path) -> dict[str, float]:
    """Return the RMSE of the only output over the only held-out recording, in its unit."""
    scale = float(np.nanstd(prepare(found.given, [path])[0].outputs[:, 0]))
    roles = ("given", "recalibrated", "explained")
    return {name: scale * found.fit["held_out"][name][-1] for name in roles}


def emps(folder: Path, quick: bool) -> Case:
    """Run the prismatic drive with dry friction."""
    case = Case()
    files = folder / "emps_train.csv", folder / "emps_pulses.csv"
    found = diagnose(case, "emps", folder / "emps.toml", [files[0]], [files[1]])
    case.check("verdict", found.verdict, "structure", found.verdict == "structure")
    case.find(found, "coulomb_friction", "equation:v")
    fc = sum(r["parameters"]["Fc"]["value"] for r in found.findings if "Fc" in r["parameters"])
    case.check("Fc", f"{fc:.2f} N", "20.4 N within 3 %", abs(fc / 20.4 - 1.0) <= 0.03)
    offered = {r["mechanism"] for r in found.findings} | alternatives(found).keys()
    direction = sorted(offered & {"asymmetric_friction", "constant_force"})
    case.check("direction dependence", ", ".join(direction), "found or runner-up", bool(direction))
    force = found.fit["force"]["equation:v"]["held_out"]
    text = f"{force['explained']:.2%} (before {force['recalibrated']:.1%})"
    case.check("force error on PULSES", text, "<= 3 %", force["explained"] <= 0.03)

    train, held = prepare(found.given, files[:1]), prepare(found.given, files[1:])
    contract = found.fit["horizons_s"]
    options = [*contract[:-1], 1.0, None]
    models = {
        "given": (found.given, values_of(found.given)),
        "recalibrated": (found.given, recalibrated(found.given, train, found.fit["headline_s"])),
        "explained": (found.model, values_of(found.model)),
    }
    labels = [*(f"{h:.4g} s" for h in contract[:-1]), "exactly 1 s", "whole"]
    case.figures["position_rmse_mm"] = table = {}
    for name, (model, theta) in models.items():
        errors = [1e3 * e for e in rmse(model, theta, train, held, options)]
        table[name] = dict(zip(labels, errors, strict=True))
        print(f"    {name}: " + ", ".join(f"{e:.3g} mm at {h}" for h, e in table[name].items()))
    before, after = (table[name]["exactly 1 s"] for name in ("recalibrated", "explained"))
    text = f"{after:.2f} mm (re-calibrated {before:.2f})"
    case.check("position RMSE at 1 s", text, "<= 1.6 mm", after <= 1.6)
    if not quick:
        trap(case, found, train, held)
    return case


def trap(
    case: Case, found: Diagnosis, train: tuple[Prepared, ...], held: tuple[Prepared, ...]
) -> None:
    """Show that one free run over the whole length orders the sets wrongly."""
    wanted = {name for members in TRAP.values() for name in members}
    every = force_candidates(found.given, state_scale(found.given, train))
    candidates = [c for c in every if c.mechanism in wanted and c.site == "equation:v"]
    full = SuperModel.build(found.given, candidates)
    system = _weak(full.model, train, values_of(full.model))
    table, force = {}, {}
    for label, members in TRAP.items():
        own = [full.index(i) for i, c in enumerate(candidates) if c.mechanism in members]
        active = [*full.base_index(), *(j for index in own for j in index)]
        theta = system.theta.copy()
        columns = system.jacobian[:, active]
        theta[active] += np.linalg.lstsq(columns, -system.residual, rcond=None)[0]
        errors = rmse(full.model, theta, train, held, (0.25, 1.0, 5.0, None))
        table[label] = [1e3 * e for e in errors]
        after = _weak(full.model, held, theta)
        force[label] = float(np.sqrt(np.mean(after.residual**2) / np.mean(after.input_side**2)))
        text = ", ".join(f"{e:.3g}" for e in table[label])
        print(f"    {label}: {text} mm; force error {force[label]:.1%}")
    case.figures["trap_rmse_mm"] = {"horizons_s": [0.25, 1.0, 5.0, "whole"], **table}
    case.figures["weak_view_force_error_on_pulses"] = force
    whole = table["Coulomb"][-1] > table["nothing added"][-1]
    short = table["Coulomb"][1] < table["nothing added"][1]
    text = "whole run prefers no friction" if whole else "whole run prefers Coulomb"
    case.check("the trap is there", text, "whole run wrong, 1 s right", whole and short)
    judged = found.fit["headline_s"]
    avoided = ("coulomb_friction", "equation:v") in effects(found)
    avoided &= judged < found.fit["horizons_s"][-1]
    case.check("the trap is avoided", f"judged at {judged:.3g} s", "Coulomb found", avoided)


def silverbox(folder: Path, quick: bool) -> Case:
    """Run the circuit that imitates a hardening spring."""
    case = Case()
    train = [folder / f"silverbox_multisine_{k:02d}.csv" for k in (1, 2, 3)]
    arrow = folder / "silverbox_arrow.csv"
    found = diagnose(case, "silverbox", folder / "silverbox.toml", train, [arrow])
    case.find(found, "cubic_stiffness", "equation:v")
    errors = {name: 1e3 * volts for name, volts in whole_rmse(found, arrow).items()}
    case.figures["arrow_rmse_mV"] = errors
    text = f"{errors['explained']:.3f} mV (re-calibrated {errors['recalibrated']:.2f})"
    case.check("arrow RMSE, whole", text, "<= 0.6 mV", errors["explained"] <= 0.6)
    return case


def balls(folder: Path, quick: bool) -> Case:
    """Run the falling balls: drag on light ones, nothing detectable on dense ones."""
    case = Case()
    for ball in QUICK_BALLS if quick else (*LIGHT, *DENSE):
        drops = [folder / f"balls_{ball}_drop{k}.csv" for k in (1, 2)]
        found = diagnose(case, ball, folder / "falling_balls.toml", drops[:1], drops[1:])
        if ball in LIGHT:
            drag = {m for m, site in effects(found) if site == "equation:v"} & DRAG.keys()
            right = found.verdict == "structure" and bool(drag)
            case.check(ball, f"{found.verdict}, {named(found)}", "structure, drag", right)
            others = {m: p for m, p in alternatives(found).items() if m in DRAG and p >= 0.05}
            text = ", ".join(f"{DRAG[m]} {p:.2f}" for m, p in others.items()) or "none"
            chosen = ", ".join(DRAG[m] for m in drag) or "no drag"
            text = f"{chosen}; also {text}"
            case.check(f"{ball} exponent", text, "other exponents offered", bool(others))
            continue
        allowed = found.verdict in ("nothing", "undecided", "measurement")
        case.check(ball, found.verdict, "nothing, undecided or measurement", allowed)
        rows = found.document["smallest_detectable"]
        bounds = {m: rows.get(f"{m}@equation:v") for m in ("viscous_damping", "quadratic_drag")}
        text = ", ".join(f"{m} < {b['value']:.3g} {b['unit']}" for m, b in bounds.items() if b)
        case.check(f"{ball} bound", text or "none", "an upper bound on drag", bool(text))
    return case


def ur10e(folder: Path, quick: bool) -> Case:
    """Run joint 1 of the six-axis arm."""
    case = Case()
    files = [folder / f"ur10e_{name}.csv" for name in ("ident", "unloaded", "ptp")]
    found = diagnose(case, "ur10e", folder / "ur10e.toml", files[:1], files[1:])
    for mechanism in ("viscous_damping", "coulomb_friction"):
        case.find(found, mechanism, "equation:v1")
    case.figures["relative_current_error"] = errors = {}
    for path in files:
        errors[path.stem] = current_error(found.model, prepare(found.model, [path])[0])
        if path is not files[0]:
            text = f"{errors[path.stem]:.2%}"
            case.check(f"current error, {path.stem}", text, "<= 9.8 %", errors[path.stem] <= 0.098)
    return case


def _weak(model: Model, prepared: Sequence[Prepared], theta: np.ndarray) -> WeakSystem:
    """The weak view of a model over recordings."""
    grid = WeakGrid.build(model, prepared, HALF_WIDTH)
    return weak_system(jaxsr.Simulator(model), grid, theta)


def current_error(model: Model, item: Prepared) -> float:
    """Return rms of what the equation leaves over rms of the motor's side, K*i1, weak view."""
    system = _weak(model, [item], values_of(model))
    view = WeakView.build(item.time, HALF_WIDTH, HALF_WIDTH / 4)
    current = item.inputs[:, model.inputs.index("i1")]
    drive = model.parameters["K"].value * view.integrate(current)[view.valid]
    left = system.residual[system.state == model.states.index("v1")]
    return float(np.sqrt(np.mean(left**2) / np.mean(drive**2)))


def dfki(folder: Path, quick: bool) -> Case:
    """Run the torque-controlled pendulum; reported, no target."""
    case = Case()
    files = [folder / f"pendulum_{name}.csv" for name in ("ddp", "energy_shaping")]
    diagnose(case, "dfki_pendulum", folder / "dfki_pendulum.toml", files[:1], files[1:])
    return case


def tanks(folder: Path, quick: bool) -> Case:
    """Run the cascaded tanks."""
    case = Case()
    files = folder / "tanks_train.csv", folder / "tanks_validation.csv"
    found = diagnose(case, "tanks", folder / "cascaded_tanks.toml", [files[0]], [files[1]])
    case.find(found, "overflow", "equation:h1")
    case.figures["validation_rmse_V"] = errors = whole_rmse(found, files[1])
    print("    validation RMSE: " + ", ".join(f"{k} {v:.3f} V" for k, v in errors.items()))
    met = errors["explained"] <= 0.30
    case.check("validation RMSE", f"{errors['explained']:.3f} V", "<= 0.30 V", met)
    return case


CASES: dict[str, tuple[str, Callable[[Path, bool], Case]]] = {
    "emps": ("emps", emps),
    "silverbox": ("silverbox", silverbox),
    "balls": ("falling_balls", balls),
    "ur10e": ("ur10e", ur10e),
    "dfki": ("dfki_pendulum", dfki),
    "tanks": ("cascaded_tanks", tanks),
    **real_rigs.CASES,
}


def answered(run: Callable[[Path, bool], Case], folder: Path, quick: bool) -> Case:
    """Run a case; where it ends in an exception, that is its row."""
    try:
        return run(folder, quick)
    except Exception as error:
        case = Case()
        case.check("an answer", f"{type(error).__name__}: {error}"[:200], "an answer", False)
        return case


def commit() -> str:
    """Return the commit that is run, as far as Git knows it."""
    command = ["git", "rev-parse", "--short", "HEAD"]
    try:
        return subprocess.run(command, cwd=ROOT, capture_output=True, text=True).stdout.strip()
    except OSError:
        return ""


def missed(name: str, case: Case, committed: dict[str, Any]) -> list[str]:
    """Return the checks that the committed results met and this run does not."""
    before = {
        c["what"] + c["target"] for c in committed.get(name, {}).get("checks", []) if c["met"]
    }
    return [c.what for c in case.checks if not c.met and c.what + c.target in before]


def main() -> int:
    """Run the chosen cases; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="EMPS and two balls, writes nothing")
    parser.add_argument("--only", metavar="NAMES", help=",".join(CASES))
    arguments = parser.parse_args()
    chosen = arguments.only.split(",") if arguments.only else list(CASES)
    if arguments.quick and not arguments.only:
        chosen = ["emps", "balls"]
    if unknown := set(chosen) - CASES.keys():
        parser.error(f"unknown: {', '.join(sorted(unknown))}; known: {', '.join(CASES)}")
    local = ROOT.parent / "shared" / "recordings"
    if local.is_dir():
        os.environ.setdefault("JAXSR_DATA_DIR", str(local))
    committed = json.loads(RESULT.read_text())["cases"] if RESULT.exists() else {}
    origin, lost = {**origin_of(SEED), "commit": commit()}, []
    print(", ".join(f"{k} {v}" for k, v in origin.items()))
    for name in chosen:
        dataset, run = CASES[name]
        with tempfile.TemporaryDirectory() as scratch:
            try:
                fetch(dataset, scratch)
            except InputError as error:
                print(f"{name}: not run, the recordings are not to be had: {error}")
                continue
            case = answered(run, Path(scratch), arguments.quick)
        lost += [f"{name}: {what}" for what in missed(name, case, committed)]
        if not arguments.quick:
            row = asdict(case) | {"provenance": origin}
            committed = {key: row if key == name else committed.get(key) for key in CASES}
            committed = {key: value for key, value in committed.items() if value}
            RESULT.parent.mkdir(exist_ok=True)
            atomic_write_text(RESULT, dump_json({"cases": committed}))
    for line in lost:
        print(f"met in the committed results, missed now: {line}", file=sys.stderr)
    return 1 if lost and arguments.quick else 0


if __name__ == "__main__":
    sys.exit(main())
