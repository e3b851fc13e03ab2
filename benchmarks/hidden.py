"""Search by evidence where sensors do not read every state, where something has a memory, and where
a sensor is at fault.

    python -m benchmarks.hidden [--seeds N] [--only NAME ...] [--quick]

Every case is a small plant (`benchmarks.hidden_plants`) with one thing left out, one fault of a
sensor, or nothing. Counted are leading sets that are exactly the truth, and 95 % intervals that
hold its constants. --quick: three cases, one seed.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.hidden_plants import CART, MOTOR, QUARTER_CAR, TANKS, Missing, Plant, chain
from benchmarks.provenance import write
from jaxsr.diagnosis.likelihood.posterior import Posterior, posterior
from jaxsr.diagnosis.thinning import prepare_search
from jaxsr.models import Simulator, parse_model

NORMAL = 1.959964
LOOP = {"hysteresis_kz": 15.0, "hysteresis_b": 6.0, "hysteresis_g": 3.0}
MODE = {"mode_mh": 0.3, "mode_wh": 9.0, "mode_zh": 0.06}
QUICK = ("motor, current: coulomb", "cart, acceleration: hysteresis", "tanks, second: overflow")


@dataclass(frozen=True, eq=False)
class Case:
    """A plant, what its model lacks, and the answers that are right.

    Attributes
    ----------
    truth : tuple of str
        Labels, each of which alone is right; nothing where empty.
    constants : dict of str to float
        By their own names.
    """

    plant: Plant
    sensors: tuple[str, ...]
    missing: Missing
    truth: tuple[str, ...] = ()
    constants: dict[str, float] | None = None


def cases() -> dict[str, Case]:
    """Return all cases by name."""
    found: dict[str, Case] = {}
    for sensor in ("current", "speed"):
        what = (sensor,)
        found[f"motor, {sensor}: nothing"] = Case(MOTOR, what, Missing())
        for name, label, own, size in (
            ("coulomb", "coulomb_friction", "Fc", 0.06),
            ("drag", "quadratic_drag", "kd", 0.01),
        ):
            missing = Missing({name: size})
            truth, known = (f"{label}@equation:w",), {own: size}
            found[f"motor, {sensor}: {name}"] = Case(MOTOR, what, missing, truth, known)
    for sensor, title in (("y", "position"), ("a", "acceleration"), ("s", "speed")):
        v, what = "@equation:v", (sensor,)
        loop, mode = ({k.partition("_")[2]: x for k, x in w.items()} for w in (LOOP, MODE))
        lag = Case(CART, what, Missing(lag=0.08), ("actuator_lag@input:u",), {"tau": 0.08})
        found |= {
            f"cart, {title}: nothing": Case(CART, what, Missing()),
            f"cart, {title}: hysteresis": Case(
                CART, what, Missing(LOOP), ("hysteresis" + v,), loop
            ),
            f"cart, {title}: resonator": Case(
                CART, what, Missing(MODE), ("hidden_mode" + v,), mode
            ),
            f"cart, {title}: lag": lag,
        }
    loop = {"hysteresis_kz": 60.0, "hysteresis_b": 25.0, "hysteresis_g": 10.0}
    for what in (("body",), ("acceleration", "travel")):
        name, truth = f"quarter car, {' and '.join(what)}", ("hysteresis@equation:vs",)
        found[f"{name}: nothing"] = Case(QUARTER_CAR, what, Missing())
        found[f"{name}: hysteresis"] = Case(
            QUARTER_CAR, what, Missing(loop), truth, {"kz": 60.0, "b": 25.0, "g": 10.0}
        )
    row, truth = chain(3, 1), ("cubic_stiffness@equation:v1",)
    cubic = Missing({"cubic": 40.0})
    found["three masses, the last: cubic"] = Case(row, ("y2",), cubic, truth, {"k3": 40.0})
    every, truth = tuple(f"y{i}" for i in range(10)), ("cubic_stiffness@equation:v5",)
    found["ten masses: cubic"] = Case(chain(10, 5), every, cubic, truth, {"k3": 40.0})
    found["tanks, second: nothing"] = Case(TANKS, ("second",), Missing())
    truth = ("overflow@equation:h1",)
    found["tanks, second: overflow"] = Case(
        TANKS, ("second",), Missing(level=2.3), truth, {"ko": 2.0, "xo": 2.3}
    )
    lag = Missing(lag=3.0)
    found["tanks, second: lag"] = Case(TANKS, ("second",), lag, ("actuator_lag@input:u",))
    return found | _faults()


def _faults() -> dict[str, Case]:
    """Return faults of the first sensor of plants with two or three of them."""
    plants = (
        (CART, ("y", "s")),
        (MOTOR, ("current", "speed")),
        (TANKS, ("first", "second")),
        (chain(3, 1), ("y0", "y1", "y2")),
    )
    found = {}
    for plant, sensors in plants:
        for fault, size, mechanism in (
            ("clip", 1.4, "clipping"),
            ("gain", 1.15, "sensor_gain"),
            ("bias", 0.3, "sensor_bias"),
            ("drift", 0.5, "drift"),
            ("delay", 2.5 * plant.step, "sensor_delay"),
            ("skew", -4e-3, "clock_skew"),
        ):
            truth = (f"{mechanism}@output:{sensors[0]}",)
            missing = Missing(fault={fault: size})
            found[f"{plant.name}, sensor: {fault}"] = Case(plant, sensors, missing, truth)
    return found


def searched(case: Case, seed: int) -> Posterior | None:
    """Record a case and search it."""
    recordings = case.plant.records(np.random.default_rng(seed), case.sensors, case.missing)
    model = Simulator(parse_model(case.plant.model(case.sensors))).model
    return posterior(model, prepare_search(model, recordings, seconds=np.inf)[0])


def row_of(name: str, case: Case, seed: int) -> dict[str, Any]:
    """Search a case and judge what leads."""
    start = time.process_time()
    try:
        found = searched(case, seed)
    except Exception as error:  # a case that breaks is a case that is wrong
        return {"case": name, "seed": seed, "right": False, "says": [f"{type(error).__name__}"]}
    seconds = round(time.process_time() - start, 1)
    if found is None:
        return {"case": name, "seed": seed, "right": False, "says": ["nothing can be followed"]}
    leader, mass = found.leader, found.of_labels()
    says = [found.candidates[i].label for i in leader.members] + [w.name for w in found.wrong]
    right = says == [] if not case.truth else len(says) == 1 and says[0] in case.truth
    inside = []
    for own, value in (case.constants or {}).items() if right else ():
        estimate, deviation = leader.constants[leader.names[leader.members[0]][own]]
        inside.append(bool(abs(estimate - value) <= NORMAL * deviation))
    return {
        "case": name,
        "seed": seed,
        "right": right,
        "says": says,
        "probability": [round(mass.get(s, 0.0), 3) for s in says],
        "inside": inside,
        "latent": leader.share,
        "cpu_seconds": seconds,
    }


def main() -> int:
    """Run; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", nargs="*", default=[], metavar="NAME")
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    every = cases()
    names = QUICK if options.quick else [n for n in every if _asked(n, options.only)]
    rows = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in names:
            for seed in range(1 if options.quick else options.seeds):
                rows.append(row_of(name, every[name], seed))
                print(rows[-1], flush=True)
    right, inside = sum(r["right"] for r in rows), [x for r in rows for x in r.get("inside", [])]
    print(f"right {right} of {len(rows)}, constants inside {sum(inside)} of {len(inside)}")
    if not options.quick and not options.only:
        seeds = list(range(options.seeds))
        write("hidden", "hidden states, memories, sensors by evidence", seeds, {"cases": rows})
    return int(options.quick and right < len(rows))


def _asked(name: str, only: list[str]) -> bool:
    return not only or any(part in name for part in only)


if __name__ == "__main__":
    sys.exit(main())
