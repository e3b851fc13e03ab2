"""Gravity fixed at 9.81 m/s^2 beside a wrong coefficient of an actuator: the coefficient is found.

    python -m benchmarks.gravity_fixed [--quick] [--jobs N] [--only NAME]

A planar quadcopter held by a controller, a rocket that hovers and a motor that swings a weight,
each with every parameter fixed and one of them wrong by 10 to 30 %. Right is the verdict
`parameter` with that coefficient as the one finding. A full run (20 seeds each) writes
``results/gravity_fixed.json`` as it goes; --quick (one rocket) writes nothing. Ends with status 1
if one is wrong.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

import numpy as np

import jaxsr
from benchmarks.provenance import RESULTS, origin_of
from jaxsr._files import atomic_write_text, dump_json
from jaxsr.expressions import to_numpy
from jaxsr.models import Simulator, parse_model
from jaxsr.recordings import Recording

RESULT = RESULTS / "gravity_fixed.json"
SEEDS, BUDGET = 20, 240.0
STEP, SAMPLES, SUBSTEPS = 0.02, 350, 8
NOISE = 1e-3
Control = Callable[[float, np.ndarray, np.ndarray], list[float]]


@dataclass(frozen=True)
class Machine:
    """A model file, its wrong coefficient, and the controller that flies it.

    Attributes
    ----------
    text : str
        With ``{wrong}`` where the value of `coefficient` stands.
    start : tuple of float
    control : callable
        Time, state and random phases to inputs, held over a sample.
    """

    text: str
    coefficient: str
    value: float
    start: tuple[float, ...]
    control: Control


ROCKET = """
[model]
states = ["h", "v"]
inputs = ["u"]
outputs = ["y", "w"]
input_hold = "zero"
[equations]
h = "v"
v = "kT*u/m - g - kd/m*v*Abs(v)"
[readings]
y = "h"
w = "v"
[parameters]
kT = {{ value = {wrong}, unit = "N" }}
m = {{ value = 1.2, unit = "kg" }}
g = {{ value = 9.81, unit = "m/s^2" }}
kd = {{ value = 0.4, unit = "N*s^2/m^2" }}
[units]
h = "m"
v = "m/s"
u = "1"
y = "m"
w = "m/s"
"""
SWING = """
[model]
states = ["q", "v"]
inputs = ["i"]
outputs = ["y", "w"]
input_hold = "zero"
[equations]
q = "v"
v = "(kt*i - b*v - m*g*l*sin(q))/J"
[readings]
y = "q"
w = "v"
[parameters]
kt = {{ value = {wrong}, unit = "N*m/A" }}
b = {{ value = 0.06, unit = "N*m*s/rad" }}
m = {{ value = 0.5, unit = "kg" }}
l = {{ value = 0.3, unit = "m" }}
J = {{ value = 0.06, unit = "kg*m^2" }}
g = {{ value = 9.81, unit = "m/s^2" }}
[units]
q = "rad"
v = "rad/s"
i = "A"
y = "rad"
w = "rad/s"
"""
QUADCOPTER = """
[model]
states = ["x", "z", "a", "vx", "vz", "w"]
inputs = ["u1", "u2"]
outputs = ["yx", "yz", "ya"]
input_hold = "zero"
[equations]
x = "vx"
z = "vz"
a = "w"
vx = "-kT*(u1 + u2)*sin(a)/m"
vz = "kT*(u1 + u2)*cos(a)/m - g"
w = "kT*l*(u2 - u1)/J"
[readings]
yx = "x"
yz = "z"
ya = "a"
[parameters]
kT = {{ value = {wrong}, unit = "N" }}
m = {{ value = 0.8, unit = "kg" }}
l = {{ value = 0.2, unit = "m" }}
J = {{ value = 0.02, unit = "kg*m^2" }}
g = {{ value = 9.81, unit = "m/s^2" }}
[units]
x = "m"
z = "m"
a = "rad"
vx = "m/s"
vz = "m/s"
w = "rad/s"
u1 = "1"
u2 = "1"
yx = "m"
yz = "m"
ya = "rad"
"""


def _wander(t: float, phases: np.ndarray) -> float:
    """A reference between -1 and 1."""
    return float(np.sin(np.array([0.7, 1.6, 2.9]) * t + phases[:3]).mean())


def _hover(t: float, x: np.ndarray, phases: np.ndarray) -> list[float]:
    h, v = x
    return [float(np.clip(0.6 + 0.5 * (_wander(t, phases) - h) - 0.25 * v, 0.1, 1.0))]


def _shake(t: float, x: np.ndarray, phases: np.ndarray) -> list[float]:
    return [2.5 * _wander(1.7 * t, phases)]


def _fly(t: float, x: np.ndarray, phases: np.ndarray) -> list[float]:
    lift = 0.49 + 0.25 * (_wander(t, phases) - x[1]) - 0.18 * x[4]
    lean = np.clip(-0.25 * (_wander(1.3 * t, phases[3:]) - x[0]) + 0.25 * x[3], -0.4, 0.4)
    turn = 0.12 * (lean - x[2]) - 0.03 * x[5]
    return [float(np.clip(lift - turn, 0.05, 1.0)), float(np.clip(lift + turn, 0.05, 1.0))]


MACHINES = {
    "rocket": Machine(ROCKET, "kT", 20.0, (0.0, 0.0), _hover),
    "swing": Machine(SWING, "kt", 0.5, (0.1, 0.0), _shake),
    "quadcopter": Machine(QUADCOPTER, "kT", 8.0, (0.0,) * 6, _fly),
}


def recordings(machine: Machine, seed: int) -> list[Recording]:
    """Return two recordings of the machine with its true coefficient."""
    rng = np.random.default_rng(seed)
    return [_run(machine, rng, f"run{k}.csv") for k in range(2)]


def _run(machine: Machine, rng: np.random.Generator, name: str) -> Recording:
    model = parse_model(machine.text.format(wrong=machine.value))
    simulator = Simulator(model)
    values = simulator.values()
    terms = [simulator.model.equation_terms[s] for s in model.states]

    rates = [to_numpy(term) for term in terms]
    known = dict(zip(model.parameters, values, strict=True))
    phases, x = rng.uniform(0.0, 6.28, 6), np.array(machine.start)
    states, inputs = np.zeros((SAMPLES, x.size)), np.zeros((SAMPLES, len(model.inputs)))

    def rate(own: np.ndarray) -> np.ndarray:
        env = {**known, **dict(zip(model.states, own, strict=True)), **held}
        return np.array([float(f(env)) for f in rates])

    for k in range(SAMPLES):
        u = machine.control(k * STEP, x, phases)
        held = dict(zip(model.inputs, u, strict=True))
        states[k], inputs[k] = x, u
        h = STEP / SUBSTEPS
        for _ in range(SUBSTEPS):  # RK4: smooth between samples
            a = rate(x)
            b = rate(x + 0.5 * h * a)
            c = rate(x + 0.5 * h * b)
            d = rate(x + h * c)
            x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    channels = dict(zip(model.inputs, inputs.T, strict=True))
    for output, column in zip(model.outputs, states.T, strict=False):
        channels[output] = column + NOISE * column.std() * rng.normal(size=SAMPLES)
    return Recording(name, STEP * np.arange(SAMPLES), channels)


ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
}


def run(name: str, seed: int) -> dict[str, Any]:
    """Diagnose one machine, and judge the answer."""
    machine, begin = MACHINES[name], time.perf_counter()
    rng = np.random.default_rng(1000 + seed)
    wrong = machine.value * (1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.3))
    model = parse_model(machine.text.format(wrong=f"{wrong:.4g}"))
    found = jaxsr.diagnose(Simulator(model), recordings(machine, seed), seed=seed, budget=BUDGET)
    sites = [f["site"] for f in found.findings]
    return {
        "machine": name,
        "seed": seed,
        "given": round(wrong, 5),
        "truth": machine.value,
        "verdict": found.verdict,
        "findings": [
            {k: f[k] for k in ("site", "mechanism", "parameters")} for f in found.findings
        ],
        "right": found.verdict == "parameter" and sites == [f"parameter:{machine.coefficient}"],
        "gravity": any("parameter:g" == s for s in sites),
        "seconds": round(time.perf_counter() - begin, 1),
    }


def main() -> int:
    """Run the machines; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="one rocket, writes nothing")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--only", help="two seeds of one machine, writes nothing")
    args = parser.parse_args()
    os.environ |= ONE_THREAD  # of every process
    cases = [(name, seed) for name in MACHINES for seed in range(SEEDS)]
    if args.quick or args.only:
        cases = [(args.only or "rocket", seed) for seed in range(1 + bool(args.only))]
    rows: list[dict[str, Any]] = []
    with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn")) as pool:
        for future in as_completed([pool.submit(run, *case) for case in cases]):
            rows.append(row := future.result())
            findings = [(f["site"], f["mechanism"]) for f in row["findings"]]
            print(f"{row['machine']} {row['seed']}: {row['verdict']} {findings} "
                  f"{'right' if row['right'] else 'WRONG'} ({row['seconds']} s)")  # fmt: skip
            if not (args.quick or args.only):
                _write(rows)
    right = sum(row["right"] for row in rows)
    print(f"right: {right} of {len(rows)}")
    return int(right < len(rows))


def _write(rows: list[dict[str, Any]]) -> None:
    RESULT.parent.mkdir(exist_ok=True)
    ordered = sorted(rows, key=lambda r: (r["machine"], r["seed"]))
    right = {n: sum(r["right"] for r in rows if r["machine"] == n) for n in MACHINES}
    document = {"provenance": origin_of(0), "right": right, "rows": ordered}
    atomic_write_text(RESULT, dump_json(document))


if __name__ == "__main__":
    sys.exit(main())
