"""Lost samples and slow sensors: the same diagnosis, from less data.

    python -m benchmarks.lost_samples [--quick]

Twenty plants (four systems, five seeds each) with a force left out. Each is diagnosed from the
whole recording, from one of whose sensors' samples 10 % are lost at random, and from one whose
sensor gives every tenth sample. A finding's constant may move by its interval's width (from lower
to upper end, in the whole recording); verdict and first mechanism are to stay.
Results: ``results/lost_samples.json``; --quick (one plant, no file) fails where a diagnosis does.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import jaxsr
from benchmarks.provenance import write
from jaxsr.recordings import Recording, write_csv

SEEDS, SAMPLES, STEP = range(5), 4000, 0.005
LOST, SLOW = 0.1, 10
BUDGET, QUICK_BUDGET = 30.0, 8.0


@dataclass(frozen=True)
class Plant:
    """A system with one degree of freedom: inertia * q'' = force + missing.

    Attributes
    ----------
    force : str
        Of the given model, in its grammar, with the input u.
    parameters : dict of str to (value, low, high)
    known, missing : callable
        The same force, and what is left out, as functions of q, v, u.
    noise : float
    """

    name: str
    force: str
    parameters: dict[str, tuple[float, float, float]]
    known: Callable[[float, float, float], float]
    missing: Callable[[float, float], float]
    noise: float

    def model(self) -> str:
        """The given model file."""
        rows = "\n".join(
            f"{name} = {{ value = {value}, bounds = [{low}, {high}] }}"
            for name, (value, low, high) in self.parameters.items()
        )
        return (
            f'[model]\nname = "{self.name}"\nstates = ["q", "v"]\ninputs = ["u"]\n'
            f'outputs = ["y"]\n[equations]\nq = "v"\nv = "{self.force}"\n'
            f'[inertia]\nv = {{ v = "M" }}\n[readings]\ny = "q"\n[parameters]\n{rows}\n'
        )

    def record(self, seed: int) -> Recording:
        """Simulate under four random sines, with noise on the reading of q."""
        rng = np.random.default_rng(seed)
        time = STEP * np.arange(SAMPLES)
        line, phase = rng.uniform(0.8, 8.0, 4), rng.uniform(0.0, 6.28, 4)

        def drive(t: float | np.ndarray) -> Any:
            return 3.0 * np.sin(np.multiply.outer(t, line) + phase).sum(-1)

        def rates(t: float, x: np.ndarray) -> list[float]:
            q, v = x
            return [v, (self.known(q, v, drive(t)) + self.missing(q, v)) / 2.0]

        found = solve_ivp(
            rates, (0.0, time[-1]), [0.05, 0.0], t_eval=time, rtol=1e-9, atol=1e-11, max_step=STEP
        )
        y = found.y[0] + self.noise * rng.normal(size=SAMPLES)
        return Recording(f"{self.name}-{seed}.csv", time, {"u": drive(time), "y": y})


MASS = {"M": (2.0, 0.5, 8.0), "c": (1.5, 0.0, 20.0)}
PLANTS = (
    Plant(
        "sprung",
        "u - k*q - c*v",
        {**MASS, "k": (30.0, 1.0, 200.0)},
        lambda q, v, u: u - 30.0 * q - 1.5 * v,
        lambda q, v: -1.2 * np.tanh(v / 1e-3),
        2e-4,
    ),
    Plant(
        "hardening",
        "u - k*q - c*v",
        {**MASS, "k": (20.0, 1.0, 200.0)},
        lambda q, v, u: u - 20.0 * q - 1.5 * v,
        lambda q, v: -60.0 * q**3,
        2e-4,
    ),
    Plant(
        "pendulum",
        "u - G*sin(q) - c*v",
        {**MASS, "G": (25.0, 1.0, 100.0)},
        lambda q, v, u: u - 25.0 * np.sin(q) - 1.5 * v,
        lambda q, v: -1.5 * v * abs(v),
        2e-4,
    ),
    Plant(
        "two laws",
        "u - k*q - c*v",
        {**MASS, "k": (40.0, 1.0, 200.0)},
        lambda q, v, u: u - 40.0 * q - 1.5 * v,
        lambda q, v: -1.0 * np.tanh(v / 1e-3) - 2.0 * v * abs(v),
        2e-4,
    ),
)


def with_lost(recording: Recording, seed: int) -> Recording:
    """A tenth of the readings empty."""
    gone = np.random.default_rng(1000 + seed).random(len(recording)) < LOST
    return _without(recording, gone)


def with_slow(recording: Recording) -> Recording:
    """Every tenth reading alone."""
    return _without(recording, np.arange(len(recording)) % SLOW != 0)


def _without(recording: Recording, gone: np.ndarray) -> Recording:
    y = np.where(gone, np.nan, recording.channels["y"])
    return Recording(recording.name, recording.time, {**recording.channels, "y": y})


def diagnosed(plant: Plant, recording: Recording, budget: float) -> dict[str, Any]:
    """Verdict, findings and the first one's constants, or how it ended."""
    with tempfile.TemporaryDirectory() as place:
        model, data = Path(place) / "model.toml", Path(place) / recording.name
        model.write_text(plant.model(), encoding="utf-8")
        write_csv(recording, data)
        found = jaxsr.diagnose(jaxsr.Simulator.from_file(model), [data], budget=budget)
    constants = {
        name: (row["value"], *row["ci95"])
        for finding in found.findings
        for name, row in finding["parameters"].items()
    }
    return {
        "verdict": found.verdict,
        "mechanisms": sorted(f"{f['mechanism']}@{f['site']}" for f in found.findings),
        "constants": constants,
    }


def compared(whole: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """Whether the answer is the same, and how far constants moved, in interval widths."""
    moved = [
        abs(other["constants"][name][0] - value) / max(high - low, 1e-300)
        for name, (value, low, high) in whole["constants"].items()
        if name in other["constants"]
    ]
    same = (whole["verdict"], whole["mechanisms"]) == (other["verdict"], other["mechanisms"])
    return {"same": same, "widths_moved": max(moved, default=None)}


def main() -> int:
    """Print the table; write it unless quick."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    budget = QUICK_BUDGET if quick else BUDGET
    rows = []
    for plant in PLANTS[:1] if quick else PLANTS:
        for seed in SEEDS[:1] if quick else SEEDS:
            recording = plant.record(seed)
            whole = diagnosed(plant, recording, budget)
            row: dict[str, Any] = {"plant": plant.name, "seed": seed, "whole": whole}
            for name, less in (
                ("lost", with_lost(recording, seed)),
                ("slow", with_slow(recording)),
            ):
                found = diagnosed(plant, less, budget)
                row[name] = {**found, **compared(whole, found)}
            rows.append(row)
            print(
                f"{plant.name:10} {seed}  {whole['verdict']:10} {' '.join(whole['mechanisms'])}"
                + "".join(
                    f" | {name}: {'same' if row[name]['same'] else row[name]['mechanisms']}"
                    f", moved {row[name]['widths_moved'] or 0.0:.2f} widths"
                    for name in ("lost", "slow")
                ),
                flush=True,
            )
    summary = {
        name: {
            "same": sum(r[name]["same"] for r in rows),
            "within_width": sum((r[name]["widths_moved"] or 0.0) <= 1.0 for r in rows),
            "of": len(rows),
        }
        for name in ("lost", "slow")
    }
    print(summary)
    if not quick:
        body = {"budget_s": budget, "summary": summary, "rows": rows}
        write("lost_samples", "Lost samples and slow sensors", SEEDS, body)
    return 0


if __name__ == "__main__":
    sys.exit(main())
