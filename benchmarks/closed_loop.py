"""Closed loop: where a controller made the input from the measured output.

    python -m benchmarks.closed_loop [--quick]

Noise of the sensor then reaches the input, and least squares on differentiated readings is
biased. Compared over seeds on a planted drive: least squares, instruments (the reference
filtered through the same differences), joint estimation in free run with the recorded input, and
with the controller in the model and the reference as its input (there it is continuous; the
drive's is sampled, which biases more the fewer samples its loop gets). Then EMPS, whose reference
and gains are known: the same diagnosis with the recorded motor force, and with the loop closed in
the model. Results: ``results/closed_loop.json``; --quick (3 seeds, no EMPS) writes nothing and ends
with status 1 if the joint estimates leave 2 %.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

import jaxsr
from benchmarks.provenance import origin_of
from benchmarks.real_recordings import SEED, named, recalibrated
from jaxsr._files import atomic_write_text, dump_json
from jaxsr._result import InputError
from jaxsr.datasets import fetch
from jaxsr.diagnosis.setup import prepare
from jaxsr.models import parse_model
from jaxsr.recordings import Recording

ROOT = Path(__file__).resolve().parents[1]
RESULT = ROOT / "benchmarks" / "results" / "closed_loop.json"
SEEDS, QUICK_SEEDS = 20, 3
MASS, DAMPING = 2.0, 3.0
KP, KV = 60.0, 12.0
STEP, SAMPLES, NOISE = 0.002, 5000, 3e-4

OPEN = """
[model]
name = "drive"
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
input_hold = "zero"
[equations]
q = "v"
v = "u - Fv*v"
[inertia]
v = { v = "M" }
[readings]
y = "q"
[parameters]
M = { value = 1.5, bounds = [0.2, 10.0] }
Fv = { value = 1.0, bounds = [0.0, 20.0] }
"""
CLOSED = (
    OPEN.replace('inputs = ["u"]', 'inputs = ["r", "dr"]')
    .replace('input_hold = "zero"', 'input_hold = "linear"')
    .replace('"u - Fv*v"', f'"{KP}*(r - q) + {KV}*(dr - v) - Fv*v"')
)
"""The controller in the model: the force follows from the reference and the states."""
EMPS_GAINS = """[parameters]
kp = { value = 160.18, unit = "1/s" }
kf = { value = 8557.5, unit = "N*s/m" }
"""
"""Gains of EMPS by its authors: kp, and kv = 243.45 V s/m times the drive's 35.15 N/V."""


def drive(seed: int) -> Recording:
    """A drive under position and rate control that differentiates its noisy sensor."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(SAMPLES)
    w, phase = rng.uniform(1.0, 9.0, 6), rng.uniform(0.0, 6.3, 6)
    wave = np.multiply.outer(t, w) + phase
    r, dr = np.sin(wave).sum(1) / 6.0, (w * np.cos(wave)).sum(1) / 6.0
    noise = NOISE * rng.normal(size=SAMPLES)
    q = v = 0.0
    y, u, last = np.zeros(SAMPLES), np.zeros(SAMPLES), 0.0
    decay = np.exp(-DAMPING / MASS * STEP)
    for k in range(SAMPLES):
        y[k] = q + noise[k]
        u[k] = KP * (r[k] - y[k]) + KV * (dr[k] - (y[k] - last) / STEP)
        last = y[k]
        # Exact under a constant force: v' = (u - Fv v)/M.
        limit = u[k] / DAMPING
        q += limit * STEP + (v - limit) * (1.0 - decay) * MASS / DAMPING
        v = limit + (v - limit) * decay
    return Recording(f"drive{seed}.csv", t, {"y": y, "u": u, "r": r, "dr": dr})


def differences(signal: np.ndarray) -> np.ndarray:
    """Rate and acceleration by central differences, shape (samples - 2, 2)."""
    rate = (signal[2:] - signal[:-2]) / (2.0 * STEP)
    bend = (signal[2:] - 2.0 * signal[1:-1] + signal[:-2]) / STEP**2
    return np.stack([bend, rate], axis=1)


def by_equation_error(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """M and Fv by least squares, and by instruments that the reference makes.

    theta = (Z' X)^-1 Z' u with Z the differences of the reference, which carry no noise
    (Soderstrom & Stoica, Instrumental variable methods (1983), chapter 3).
    """
    c = recording.channels
    x, z = differences(c["y"]), differences(c["r"])
    # A force is held over a step: half of each of its neighbours acts at a sample.
    u = 0.5 * (c["u"][:-2] + c["u"][1:-1])
    return np.linalg.lstsq(x, u, rcond=None)[0], np.linalg.solve(z.T @ x, z.T @ u)


def planted(seeds: int) -> dict[str, dict[str, list[float]]]:
    """Relative errors of both constants, by method."""
    errors: dict[str, dict[str, list[float]]] = {}
    truth = {"M": MASS, "Fv": DAMPING}
    for seed in range(seeds):
        recording = drive(seed)
        plain, instruments = by_equation_error(recording)
        found = {"least squares": plain, "instruments": instruments}
        for name, text in (("joint, recorded input", OPEN), ("joint, controller", CLOSED)):
            model = parse_model(text)
            found[name] = recalibrated(model, prepare(model, [recording]), 15.0)
        for name, values in found.items():
            row = errors.setdefault(name, {k: [] for k in truth})
            for key, value in zip(truth, values, strict=True):
                row[key].append(float(value / truth[key] - 1.0))
    print(f"planted drive in closed loop, {seeds} seeds: error of M and Fv, mean +- deviation")
    for name, row in errors.items():
        parts = [f"{k} {100 * np.mean(e):+6.2f} +- {100 * np.std(e):.2f} %" for k, e in row.items()]
        print(f"  {name:24s} {'   '.join(parts)}")
    return errors


def emps() -> dict[str, dict]:
    """EMPS with the recorded motor force, and with its controller in the model."""
    local = ROOT.parent / "shared" / "recordings"
    if local.is_dir():
        os.environ.setdefault("JAXSR_DATA_DIR", str(local))
    rows: dict[str, dict] = {}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        try:
            fetch("emps", folder)
        except InputError as error:
            print(f"EMPS: not run, the recordings are not to be had: {error}")
            return rows
        text = (folder / "emps.toml").read_text()
        force = "kf*(kp*(ref - q) - v)"
        closed = (
            text.replace('inputs = ["force"]', 'inputs = ["ref"]')
            .replace('"force - Fv*v"', f'"{force} - Fv*v"')
            .replace('outputs = ["q_meas"]', 'outputs = ["q_meas", "force"]')
            .replace('q_meas = "q"', f'q_meas = "q"\nforce = "{force}"')
            .replace("[parameters]\n", EMPS_GAINS)
            .replace('force = "N"', 'force = "N"\nref = "m"')
            .replace('force = "motor_force_N"', 'force = "motor_force_N"\nref = "reference_m"')
        )
        (folder / "closed.toml").write_text(closed)
        for name, model in (("recorded force", "emps.toml"), ("controller", "closed.toml")):
            found = jaxsr.diagnose(
                jaxsr.Simulator.from_file(folder / model),
                [folder / "emps_train.csv"],
                held_out=[folder / "emps_pulses.csv"],
                seed=0,
                budget=120,
            )
            calibration = {k: row["value"] for k, row in found.document["calibration"].items()}
            values = ", ".join(f"{k} {v:.4g}" for k, v in calibration.items())
            print(f"EMPS, {name}: {found.verdict}, {named(found)}; {values}")
            rows[name] = {
                "verdict": found.verdict,
                "findings": [
                    {k: row[k] for k in ("site", "mechanism", "probability", "parameters")}
                    for row in found.findings
                ],
                "calibration": found.document["calibration"],
                "fit": found.document["fit"],
            }
    return rows


def main() -> int:
    """Run the planted drive, then EMPS; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="3 seeds, no EMPS, writes nothing")
    quick = parser.parse_args().quick
    errors = planted(QUICK_SEEDS if quick else SEEDS)
    joint = [errors[name] for name in errors if name.startswith("joint")]
    worst = max(abs(np.mean(e)) for row in joint for e in row.values())
    if not quick:
        rows = {"planted": errors, "emps": emps(), "provenance": origin_of(SEED)}
        atomic_write_text(RESULT, dump_json(rows))
    return 1 if quick and worst > 0.02 else 0


if __name__ == "__main__":
    sys.exit(main())
