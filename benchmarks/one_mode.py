"""Diagnosis of systems that switch: what is missing acts in one mode only, in all, or nothing is.

    python -m benchmarks.one_mode [--quick] [--seeds N]

Three models that switch (a hopper on its leg, a slider against a pad, a shaft with a governor) are
given without a resistance that the recordings hold. It is planted in one mode alone, or in all
modes, or left out; its size is drawn from a seed, the sensors are noisy. Counted: mechanism and
site right, the side of the switch right (no switch where it acts always), the constant inside its
interval. Results: ``results/one_mode.json``; --quick (1 seed) writes nothing and ends with status 1
if an answer is wrong.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import jaxsr
from benchmarks import provenance
from jaxsr import Recording, Simulator
from jaxsr.expressions import parse, to_numpy, to_text
from jaxsr.models import parse_model

SEEDS, NOISE, BUDGET = 5, 2e-3, 60.0


@dataclass(frozen=True)
class Switching:
    """A model that switches, and the resistance it lacks.

    Attributes
    ----------
    law : str
        Of the rate v of q, as the model has it, with a free stiffness k.
    k : float
        Its true value.
    mode : str
        Condition in which the resistance acts.
    mechanism : str
    resistance : str
        Force of unit size.
    sizes : tuple of float
        Range from which its size is drawn.
    drive : str
        The input u as a function of t.
    starts : tuple of (q, v)
        Of the recordings to learn from; the last one is held out.
    """

    name: str
    law: str
    k: float
    mode: str
    mechanism: str
    resistance: str
    sizes: tuple[float, float]
    drive: str
    starts: tuple[tuple[float, float], ...]
    end: float
    step: float

    def model(self) -> str:
        """Return the model file."""
        return f"""
[model]
name = "{self.name}"
states = ["q", "v"]
inputs = ["u"]
outputs = ["q_meas", "v_meas"]
[equations]
q = "v"
v = "{self.law}"
[readings]
q_meas = "q"
v_meas = "v"
[parameters]
k = {{ value = {self.k}, bounds = [1.0, 2000.0] }}
"""

    def record(self, size: float, mode: str, rng: np.random.Generator) -> list[Recording]:
        """Return recordings of the motion with the resistance in a mode ("True": in all).

        Between samples the input runs straight, as the model takes it: a curved one would be a
        gain of the input in truth.
        """
        plain, held = to_numpy(parse(self.law)), to_numpy(parse(mode))
        resistance, drive = to_numpy(parse(self.resistance)), to_numpy(parse(self.drive))
        t = np.arange(0.0, self.end, self.step)
        u = np.broadcast_to(drive({"t": t}), t.shape)

        def rate(s: float, x: np.ndarray) -> list[float]:
            now = {"t": s, "q": x[0], "v": x[1], "u": float(np.interp(s, t, u)), "k": self.k}
            friction = size * float(resistance(now)) if held(now) else 0.0
            return [x[1], float(plain(now)) - friction]

        out = []
        for number, start in enumerate(self.starts):
            run = solve_ivp(
                rate, (0.0, t[-1]), start, "LSODA", t, rtol=1e-9, atol=1e-10, max_step=self.step
            ).y
            noise = NOISE * np.std(run, axis=1, keepdims=True) * rng.normal(size=run.shape)
            q, v = run + noise
            out.append(Recording(f"run{number}.csv", t, {"u": u, "q_meas": q, "v_meas": v}))
        return out


SYSTEMS = (
    Switching(
        "hopper",
        "-9.81 + u - Piecewise((k*(q - 1.0), q < 1.0), (0, True))", 300.0,
        "q < 1.0", "viscous_damping", "v", (0.3, 3.0), "2*sin(3*t)",
        ((1.3, 0.0), (1.15, 0.5), (1.2, -1.0)), 4.0, 0.01,
    ),
    Switching(
        "slider",
        "u - 50*q - Piecewise((k*(q - 0.1), q > 0.1), (0, True))", 300.0,
        "q > 0.1", "coulomb_friction", "tanh(v/1e-3)", (0.3, 2.0),
        "6*sin(4*t) + 4*sin(9.1*t) + 3*sin(1.3*t)",
        ((0.0, 0.0), (0.1, 0.5), (-0.1, 0.3)), 10.0, 0.01,
    ),
    Switching(
        "governor",
        "u - 0.4*v - Piecewise((k*(v - 1.0), v > 1.0), (0, True))", 50.0,
        "v <= 1.0", "quadratic_drag", "v*Abs(v)", (0.3, 2.0),
        "3 + 9*sin(1.7*t) + 5*sin(4.3*t)",
        ((0.0, 0.0), (0.0, 0.8), (0.0, -0.5)), 10.0, 0.01,
    ),
)  # fmt: skip


def same_side(mode: str, system: Switching) -> bool:
    """Tell whether a condition holds where the planted one does."""
    rng = np.random.default_rng(0)
    points = {n: rng.uniform(-2.0, 2.0, 500) for n in ("q", "v", "u", "t")}
    one, other = (np.asarray(to_numpy(parse(m))(points)) for m in (mode, system.mode))
    return bool(np.mean(one == other) > 0.99)


def condition(term: str) -> str:
    """Return the condition of a term; "True" where it has none."""
    found = next((n for n in parse(term).walk() if n.op == "piecewise"), None)
    return "True" if found is None else to_text(found.args[1])


def one(system: Switching, planted: str, seed: int) -> dict[str, Any]:
    """Diagnose one planted case: in one "mode", "always", or "nothing"."""
    rng = np.random.default_rng(seed)
    low, high = np.log(system.sizes)
    size = 0.0 if planted == "nothing" else float(np.exp(rng.uniform(low, high)))
    *train, held = system.record(size, system.mode if planted == "mode" else "True", rng)
    began = time.perf_counter()
    found = jaxsr.diagnose(
        Simulator(parse_model(system.model())), train, held_out=[held], seed=seed, budget=BUDGET
    )
    row: dict[str, Any] = {
        "system": system.name, "planted": planted, "seed": seed, "size": size,
        "verdict": str(found.verdict), "seconds": time.perf_counter() - began,
        "found": [f"{f['mechanism']}: {f['term']}" for f in found.findings],
    }  # fmt: skip
    if planted == "nothing":
        return row | {"right": row["verdict"] == "nothing"}
    rows = [f for f in found.findings if f["mechanism"] == system.mechanism]
    row["mechanism"] = len(found.findings) == 1 == len(rows)
    if rows:
        where = condition(rows[0]["term"])
        row["mode"] = same_side(where, system) if planted == "mode" else where == "True"
        (value,) = rows[0]["parameters"].values()
        row["error"] = abs(value["value"] / size - 1.0)
        row["covered"] = value["ci95"][0] <= size <= value["ci95"][1]
    return row | {"right": bool(row["mechanism"] and row.get("mode"))}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark and print a line for each case."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.one_mode", description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    options = parser.parse_args(arguments)
    seeds = range(1 if options.quick else options.seeds)
    rows = []
    for system in SYSTEMS:
        for planted in ("mode", "always", "nothing"):
            for seed in seeds:
                rows.append(one(system, planted, seed))
                row = rows[-1]
                print(
                    f"{system.name:9s} {planted:8s} seed {seed:2d}  "
                    f"{'right' if row['right'] else 'WRONG'}  {row['seconds']:4.0f} s  "
                    f"{row['verdict']}: {'; '.join(row['found'])}",
                    flush=True,
                )
    for planted in ("mode", "always", "nothing"):
        part = [r for r in rows if r["planted"] == planted]
        covered = [r["covered"] for r in part if "covered" in r]
        print(
            f"{planted:8s} right {sum(r['right'] for r in part)} of {len(part)}, intervals cover "
            f"{sum(covered)} of {len(covered)}"
        )
    if options.quick:
        return int(not all(r["right"] for r in rows))
    provenance.write("one_mode", "diagnosis of models that switch", seeds, {"rows": rows})
    return 0


if __name__ == "__main__":
    sys.exit(main())
