"""Documents and evidence to report on, made by simulating a drive with friction."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.report import (
    Considered,
    DiffRow,
    EquationFit,
    Evidence,
    ForceResidual,
    Trajectory,
)

STEP = 0.005  # s
DURATION = 24.8  # s
HEADLINE = 2.5  # s


@dataclass(frozen=True)
class Drive:
    """M v' = force - Fv v - Fc sign(v)."""

    mass: float = 95.1
    viscous: float = 203.5
    coulomb: float = 20.4

    def rate(self, force: float, v: float) -> float:
        return (force - self.viscous * v - self.coulomb * np.tanh(v / 1e-3)) / self.mass


TRUTH = Drive()
RECALIBRATED = Drive(mass=110.2, viscous=426.0, coulomb=0.0)
GIVEN = Drive(mass=95.0, viscous=200.0, coulomb=0.0)


def record(period: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return time, position, rate and force of the drive under a position controller."""
    time = np.arange(0.0, DURATION, STEP)
    target = 0.12 * (1 - np.cos(2 * np.pi * time / period)) * np.sin(0.35 * time)
    q, v = np.zeros_like(time), np.zeros_like(time)
    force = np.zeros_like(time)
    for i in range(len(time) - 1):
        force[i] = np.clip(4000 * (target[i] - q[i]) - 600 * v[i], -160, 160)
        v[i + 1] = v[i] + STEP * TRUTH.rate(force[i], v[i])
        q[i + 1] = q[i] + STEP * v[i + 1]
    return time, q, v, force


def free_run(drive: Drive, q: np.ndarray, v: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Simulate in segments of the headline horizon from the true state at each start."""
    run, rate = q.copy(), v.copy()
    samples = round(HEADLINE / STEP)
    for i in range(len(q) - 1):
        if i % samples == 0:
            run[i], rate[i] = q[i], v[i]
        if (i + 1) % samples:
            rate[i + 1] = rate[i] + STEP * drive.rate(force[i], rate[i])
            run[i + 1] = run[i] + STEP * rate[i + 1]
    return run


def drive_evidence() -> Evidence:
    """Return evidence of a drive whose Coulomb friction was left out."""
    rng = np.random.default_rng(3)
    trajectories, residuals = [], []
    for name, role, period in (("a.csv", "train", 6.2), ("b.csv", "held_out", 4.1)):
        time, q, v, force = record(period)
        explained = Drive(95.3, 204.4, 20.3)
        trajectories.append(
            Trajectory(
                recording=name,
                role=role,
                output="q_meas",
                unit="m",
                horizon_s=HEADLINE,
                time=time,
                measured=q + 1e-6 * rng.standard_normal(len(q)),
                given=free_run(GIVEN, q, v, force),
                recalibrated=free_run(RECALIBRATED, q, v, force),
                explained=free_run(explained, q, v, force),
            )
        )
        centres = slice(20, -20, 8)
        noise = rng.standard_normal((2, len(time[centres])))
        acceleration = np.gradient(v, STEP)
        left = force - RECALIBRATED.mass * acceleration - RECALIBRATED.viscous * v
        residuals.append(
            ForceResidual(
                site="equation:v",
                recording=name,
                unit="N",
                time=time[centres],
                recalibrated=left[centres] + 0.5 * noise[0],
                explained=0.7 * noise[1],
                state_name="v",
                state=v[centres],
                state_unit="m/s",
                role=role,
            )
        )
    considered = [
        Considered(
            ("coulomb_friction@equation:v",), 0.0123, 0.087, True, "Simplest of the best three."
        ),
        Considered(
            ("coulomb_friction@equation:v", "asymmetric_friction@equation:v"),
            0.0121,
            0.085,
            False,
            "Gains less than its doubt over Coulomb friction alone.",
        ),
        Considered(
            ("stribeck_friction@equation:v",), 0.0124, 0.088, False, "Two values more, no gain."
        ),
        Considered(
            ("quadratic_drag@equation:v",), 0.0713, 0.505, False, "Leaves the step at reversal."
        ),
        Considered((), 0.1412, 1.0, False, "A mismatch stands above the noise."),
    ]
    coulomb = {"value": 20.4, "unit": "N", "bounds": [0, 100]}
    diff = [
        DiffRow("equations.v", "force - Fv*v", "force - Fv*v - Fc*sign(v)"),
        DiffRow("parameters.M", parameter(95.0, "kg", 200.0), parameter(95.3, "kg", 200.0)),
        DiffRow("parameters.Fv", viscous(200.0), viscous(204.4)),
        DiffRow("parameters.Fc", None, coulomb),
    ]
    return Evidence("EMPS prismatic drive", diff, trajectories, residuals, considered)


def parameter(value: float, unit: str, largest: float) -> dict[str, Any]:
    """Return a parameter's entry of a model file."""
    return {"value": value, "unit": unit, "bounds": [0.0, largest]}


def viscous(value: float) -> dict[str, Any]:
    """Return the entry of the viscous friction."""
    return parameter(value, "N*s/m", 1000.0)


def drive_document() -> dict[str, Any]:
    """Return the diagnosis of that drive, as its JSON would be read."""
    finding = {
        "site": "equation:v",
        "mechanism": "coulomb_friction",
        "family": "dissipative",
        "probability": 0.93,
        "alternatives": [
            {
                "mechanism": "stribeck_friction",
                "site": "equation:v",
                "probability": 0.06,
                "parameters": {},
            }
        ],
        "edit": {
            "equations.v": "force - Fv*v - Fc*sign(v)",
            "parameters.Fc": {"value": 20.4, "unit": "N", "bounds": [0, 100]},
        },
        "term": "-Fc*sign(v)",
        "parameters": {"Fc": {"value": 20.3974, "ci95": [20.1142, 20.6931], "unit": "N"}},
        "where": {
            "region": [{"variable": "v", "from": -0.02, "to": 0.02}],
            "recordings": ["a.csv"],
            "times": [[0.0, 24.8]],
        },
        "share": 0.81,
        "explanation": "The drive needs a force of constant size against its motion. It shows at "
        "every reversal, where the given model has none.",
    }
    fit = {
        "measure": "free-run NRMSE",
        "horizons_s": [0.25, 2.5, 24.8],
        "headline_s": HEADLINE,
        "train": {
            "given": [0.0213, 0.144, 0.4131],
            "recalibrated": [0.0195, 0.1049, 0.3017],
            "explained": [0.0011, 0.0102, 0.0208],
        },
        "held_out": {
            "given": [0.0226, 0.1533, 0.4333],
            "recalibrated": [0.0202, 0.1127, 1.13],
            "explained": [0.0012, 0.0119, 0.0311],
            "files": ["b.csv"],
        },
        "force": {
            "equation:v": {
                "half_width_s": 0.12,
                "train": {"recalibrated": 0.196, "explained": 0.017},
                "held_out": {"recalibrated": 0.198, "explained": 0.029},
            }
        },
    }
    document = {
        "schema": "jaxsr.diagnosis/1",
        "verdict": "structure",
        "findings": [finding],
        "calibration": {
            "M": {"value": 110.23, "ci95": [109.81, 110.64]},
            "Fv": {"value": 426.31, "ci95": [421.2, 431.4]},
        },
        "fit": fit,
        "confusable": [["coulomb_friction", "stribeck_friction", 12.3]],
        "smallest_detectable": {
            "coulomb_friction@equation:v": {"parameter": "Fc", "value": 0.41, "unit": "N"},
            "quadratic_drag@equation:v": {"parameter": "kd", "value": 37.0, "unit": "N*s**2/m**2"},
        },
        "next_experiment": "Reversals below 0.02 m/s would tell Coulomb from Stribeck friction.",
        "data_checks": [
            {
                "file": "a.csv",
                "channel": "position_m",
                "check": "quantisation",
                "message": "step 2e-6 m",
            }
        ],
        "provenance": {
            "version": "0.1.0",
            "seed": 0,
            "command": "jaxsr diagnose emps.toml a.csv --held-out b.csv --out out",
            "seconds": 31.2,
            "stopped_by": "converged",
            "data_sha256": {"a.csv": "ab" * 32, "b.csv": "cd" * 32},
        },
    }
    return json.loads(json.dumps(document))


def chain_document() -> dict[str, Any]:
    """Return the discovery of a chain of two masses, as its JSON would be read."""
    z3 = "20.0001*sin(2.0*t) + 30.0002*z2 - 50.0003*z1"
    z4 = "20.0*sin(5.0*t + 1.0472) + 60.0*z1 - 100.0*z2"
    names = (("sin(2.0*t)", 20.0001), ("z2", 30.0002), ("z1", -50.0003))
    terms = [
        {"expression": text, "coefficient": value, "ci95": [value - 0.01, value + 0.01]}
        for text, value in names
    ]
    errors = {"train_mse": 1.2e-9, "validation_mse": 2.3e-9, "held_out_mse": None}
    front = [
        {"complexity": 1, "mse": 60.1, "expression": "-21.3*z1"},
        {"complexity": 2, "mse": 11.7, "expression": "31.2*z2 - 47.0*z1"},
        {"complexity": 3, "mse": 1.3e-9, "expression": z3},
        {"complexity": 4, "mse": 1.2e-9, "expression": f"{z3} + 1.0e-6*z1**2"},
    ]
    document = {
        "schema": "jaxsr.discovery/1",
        "equations": [
            {"state": "z3", "expression": z3, "terms": terms, "complexity": 3, "operators": 3}
            | errors,
            {"state": "z4", "expression": z4, "terms": [], "complexity": 3, "operators": 4}
            | errors,
        ],
        "pareto": {"z3": front, "z4": [{"complexity": 3, "mse": 2e-9, "expression": z4}]},
        "modes": [],
        "switching": {},
        "provenance": {"version": "0.1.0", "seed": 0, "seconds": 12.5, "stopped_by": "target"},
    }
    return json.loads(json.dumps(document))


def chain_fits() -> list[EquationFit]:
    """Return derivatives and predictions of that chain."""
    rng = np.random.default_rng(5)
    time = np.linspace(0, 10, 1500)
    fits = []
    for state, pitch in (("z3", 2.0), ("z4", 5.0)):
        exact = 20 * np.sin(pitch * time) + 8 * np.cos(9.1 * time)
        target = exact + 0.4 * rng.standard_normal(len(time))
        fits.append(EquationFit(state, time, target, exact, "run1.csv"))
    return fits
