"""Laws of joints and sensors on real recordings, weighed against their nearest rivals.

    python -m benchmarks.joint_laws [emps bam pendulum roll drives]

Every set of laws is estimated to its mode on the recordings to learn from, beside forces that
nobody knows; its log evidence stands beside what it leaves of those (the size of the latent force,
in that of re-calibration alone). No search: these are the odds that a search decides by.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.bam_laws import GAINS, RUNS
from benchmarks.recording_case import ROOT
from jaxsr._result import InputError
from jaxsr.datasets import fetch
from jaxsr.diagnosis.likelihood.course import followed
from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis, hypothesis
from jaxsr.diagnosis.likelihood.loop import about, better
from jaxsr.diagnosis.likelihood.offered import offered
from jaxsr.diagnosis.likelihood.table import Table, tabled
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms import Candidate
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.rectified import signed
from jaxsr.diagnosis.setup import open_recording, prepare
from jaxsr.diagnosis.thinning import thinned
from jaxsr.diagnosis.unsigned import rectified_sensors
from jaxsr.models import Model, Simulator
from jaxsr.recordings import Recording

SAMPLES = 6_000
"""Samples times states from which recordings are thinned."""
Sets = Sequence[Sequence[str]]
PRESLIDING = "presliding"
"""What the variants of hysteresis that bend before they slip are called here."""


@dataclass(frozen=True)
class Rig:
    """A model file, the recordings to learn from, and sets of laws."""

    dataset: str
    model: str
    files: tuple[str, ...]
    sets: Sets


EMPS = (
    *(["coulomb_friction"], ["stribeck_friction"], [PRESLIDING], ["load_dependent_friction"]),
    *(["coulomb_friction", "asymmetric_friction"], [PRESLIDING, "asymmetric_friction"]),
    ["coulomb_friction", "asymmetric_friction", "drift@equation"],
    [PRESLIDING, "asymmetric_friction", "drift@equation"],
    ["coulomb_friction", "asymmetric_friction", "hysteresis"],
)
BAM = (
    *(["load_dependent_friction"], ["position_dependent_friction"], ["stribeck_friction"]),
    *([PRESLIDING], ["quadratic_drag"], ["input_gain@input:duty"]),
)
SWING = (
    *(["coulomb_friction"], ["quadratic_drag"], ["load_dependent_friction"], ["power_law_drag"]),
    *(["coulomb_friction", "quadratic_drag"], ["load_dependent_friction", "quadratic_drag"]),
    *(["position_dependent_friction", "quadratic_drag"], ["hysteresis", "quadratic_drag"]),
)
ROLL = (
    *(["cubic_stiffness"], ["cubic_stiffness", "quadratic_drag"]),
    *(["cubic_stiffness", "power_law_drag"], ["cubic_stiffness", "coulomb_friction"]),
    ["cubic_stiffness", "load_dependent_friction"],
)
DRIVES = (
    *(["input_deadzone"], ["input_curve"], ["input_saturation"], ["input_gain_by_state"]),
    *(["coulomb_friction@equation:f"], ["coulomb_friction@equation:a"]),
    *(["input_deadzone", "coulomb_friction@equation:f"], ["input_deadzone", "input_curve"]),
)
RIGS = {
    "emps": Rig("emps", "emps.toml", ("emps_train.csv",), EMPS),
    "bam": Rig(
        "bam_xl330",
        "bam_xl330.toml",
        tuple(f"bam_kp{gain}_{run}.csv" for gain in GAINS for run in RUNS),
        BAM,
    ),
    "pendulum": Rig("multiarm_pendulum", "multiarm_pendulum.toml", ("single_id.csv",), SWING),
    "roll": Rig("kvlcc2", "kvlcc2.toml", ("kvlcc2_21337.csv",), ROLL),
    "drives": Rig("ced", "ced.toml", tuple(f"ced_prbs{k}.csv" for k in (1, 2, 3)), DRIVES),
}


def weigh(rig: Rig, folder: Path) -> None:
    """Estimate the sets of a rig and print their evidence."""
    begun = time.process_time()
    model = Simulator.from_file(folder / rig.model).model.pinned()
    recordings = [open_recording(model, folder / file) for file in rig.files]
    recordings = _with_signs(model, recordings)
    few = sum(len(r) for r in recordings) * len(model.states) <= SAMPLES
    prepared = prepare(model, recordings) if few else thinned(model, recordings, SAMPLES)[0]
    course = followed(model, prepared)
    if course is None:
        print("  re-calibration cannot be followed")
        return
    every = offered(model, course)
    wanted = {name for names in rig.sets for name in names} | {"constant_force"}
    chosen = [c for c in every if any(_meant(c, name) for name in wanted)]
    super_model = SuperModel.build(model, chosen)
    work = Workspace.build(super_model, course.prepared, course.seconds, course.null.noise)
    null = course.null
    table = tabled(work, _theta(work, null), null.path, null.noise, null.decay)
    null = hypothesis(work, table, (), null) or null
    known: dict[str, Hypothesis] = {}
    for names in rig.sets:
        found = _best(super_model, work, table, names, null)
        if found is None:
            print(f"  {' + '.join(names)}: not offered, or nothing finite", flush=True)
        else:
            known[" + ".join(names)] = found
    # Beside the noise of the most probable, as the search does with its rivals.
    leader = max([null, *known.values()], key=lambda h: h.log_evidence)
    null = better(null, hypothesis(work, table, (), leader)) or null
    print(f"  re-calibration: {null.log_evidence:.1f}", flush=True)
    for name, found in known.items():
        if found is not leader:
            found = better(found, hypothesis(work, table, found.members, leader)) or found
        gain, left = found.log_evidence - null.log_evidence, found.share / max(null.share, 1e-12)
        values = ", ".join(
            f"{own} {found.constants[full][0]:.4g}({found.constants[full][1]:.1g})"
            for i in found.members
            for own, full in found.names[i].items()
            if full in found.constants
        )
        print(f"  {name}: {gain:+.1f}, left {left:.2g}; {values}", flush=True)
    print(f"  {time.process_time() - begun:.0f} s of processor time", flush=True)


def _with_signs(model: Model, recordings: list[Recording]) -> list[Recording]:
    """Return recordings in which rectified readings have their signs; say which those are."""
    sensors = rectified_sensors(Simulator(model), prepare(model, recordings))
    for sensor in sensors:
        print(f"  {sensor.output} is rectified: log odds {sensor.log_odds:.1f}")
    return signed(model, recordings, sensors) if sensors else recordings


def _meant(candidate: Candidate, name: str) -> bool:
    kind, _, place = name.partition("@")
    bends = any("{b}*(" in s.equation for s in candidate.states)
    if kind == PRESLIDING:
        return candidate.mechanism == "hysteresis" and bends
    same = candidate.mechanism == kind and not bends
    return same and candidate.site.startswith(place)


def _theta(work: Workspace, null: Hypothesis) -> np.ndarray:
    theta, base = work.theta.copy(), work.super_model.base_index()
    theta[base] = null.theta[base]
    return theta


def _best(
    super_model: SuperModel, work: Workspace, table: Table, names: Sequence[str], null: Hypothesis
) -> Hypothesis | None:
    """Estimate the laws one after another, of each the variants that promise most beside others."""
    best: Hypothesis | None = null
    members: tuple[int, ...] = ()
    for name in names:
        assert best is not None
        here = table
        if members:
            here = about(work, best)
        base = [*here.base, *(k for i in members for k in here.own.get(i, ()))]
        variants = [
            (here.best(list(dict.fromkeys([*base, *here.own[i]]))), i)
            for i, c in enumerate(super_model.candidates)
            if i not in members and _meant(c, name) and here.own.get(i)
        ]
        tried = [
            hypothesis(work, table, (*members, i), best)
            for _, i in sorted(variants, reverse=True)[:2]
        ]
        found = [h for h in tried if h is not None]
        if not found:
            return None
        best = max(found, key=lambda h: h.log_evidence)
        members = best.members
    return best


def main(arguments: Sequence[str]) -> int:
    """Weigh the rigs named, all by default; return the exit status."""
    local = ROOT.parent / "shared" / "recordings"
    if local.is_dir():
        os.environ.setdefault("JAXSR_DATA_DIR", str(local))
    with tempfile.TemporaryDirectory() as scratch:
        for name in arguments or RIGS:
            print(name, flush=True)
            try:
                fetch(RIGS[name].dataset, scratch)
            except InputError as error:
                print(f"  not run, the recordings are not to be had: {error}")
                continue
            weigh(RIGS[name], Path(scratch))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
