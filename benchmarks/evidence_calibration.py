"""Stated probabilities of the search by evidence against frequencies, on small seeded plants.

    python -m benchmarks.evidence_calibration [--cases 100] [--first 0] [--quick]

A case draws a plant (sprung cart, pendulum, two masses on a shaft), what is missing (nothing, dry
friction, viscous or quadratic drag, a cubic spring), its size (from far below to far above what the
sensor shows) and the sensor's noise. Truth by `evidence_plants`: dry friction is switched exactly.
Reported are, for the probability of the truth's label among all stated ones, reliability by bins
and the expected calibration error; how often intervals of 95 % cover; and processor time.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
import warnings
from typing import Any

import numpy as np

from benchmarks.evidence_plants import Dry, Plant, cart, drive, pendulum, two_mass
from benchmarks.provenance import write
from jaxsr.diagnosis.likelihood.posterior import Posterior, posterior
from jaxsr.diagnosis.setup import seen_by
from jaxsr.models.segments import Prepared

SAMPLES, RECORDINGS = 200, 1
CONSTANTS = {
    "nothing": ("", 0),
    "coulomb_friction": ("Fc", 0),
    "viscous_damping": ("Fv", 1),
    "quadratic_drag": ("kd", 2),
    "cubic_stiffness": ("k3", 3),
}
"""The constant of a law, and the power in which it grows."""
NOTHING, LEAST = "nothing", 0.01
EQUAL = {"viscous_damping@equation:v": "wrong_value@parameter:d"}
"""A damper along the driven joint stands in the given models: more of it is a wrong value."""
SIZES, NOISES = (-3.0, -0.5), (-4.0, -2.0)
"""Decades of the missing force, in the rms of the driving force, and of the noise, in the spread of
a position."""
BINS = (0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.0)
NORMAL = 1.959964
SETTINGS = {
    "cart": (cart, 1.3, 3.0, (1.1, 2.3, 4.7), 0.03, 1.0, 1.0),
    "pendulum": (pendulum, 0.12, 0.7, (1.3, 2.9, 5.1), 0.02, 3.0, 0.6),
    "two_mass": (two_mass, 1.5, 6.0, (0.9, 2.1, 3.7), 0.02, 1.5, 2.0),
}
"""Plant, inertia, size of the drive and its rates, interval, usual speed and displacement."""


def drawn(seed: int) -> tuple[Plant, list[Any], str, dict[str, float]]:
    """Return plant, recordings, label of what is missing ("" for nothing) and its constants."""
    rng = np.random.default_rng(seed)
    name, law = str(rng.choice(list(SETTINGS))), str(rng.choice(list(CONSTANTS)))
    make, inertia, size, rates, interval, speed, reach = SETTINGS[name]
    force = size * 10.0 ** rng.uniform(*SIZES)
    noise = 10.0 ** rng.uniform(*NOISES)
    joint = 1 if name == "two_mass" else 0
    constant, exponent = CONSTANTS[law]
    usual = reach if law == "cubic_stiffness" else speed
    value = force / usual**exponent
    dry = {joint: Dry(force / inertia, force / inertia)} if law == "coulomb_friction" else {}

    def more(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        shapes = {"cubic_stiffness": q**3, "quadratic_drag": v * np.abs(v), "viscous_damping": v}
        own = -value * shapes.get(law, 0.0 * v)
        return own * np.arange(2) if name == "two_mass" else own

    plant = make(force=more, dry=dry)
    records = [
        plant.recorded(rng, drive(rng, SAMPLES, interval, size, rates), interval, noise, f"r{k}")
        for k in range(RECORDINGS)
    ]
    if law == "nothing":
        return plant, records, NOTHING, {}
    if law == "viscous_damping" and name != "two_mass":  # the model has a damper: its value is off
        given = plant.simulator.model.parameters["d"].value
        return plant, records, "wrong_value@parameter:d", {"d": given + value}
    return plant, records, f"{law}@equation:{'w' if joint else 'v'}", {constant: value}


def stated(found: Posterior) -> dict[str, float]:
    """Return every label with its probability; a wrong value where nothing is missing."""
    mass = {EQUAL.get(k, k): p for k, p in found.of_labels().items()}
    null = sum(
        p for h, p in zip(found.hypotheses, found.probabilities, strict=True) if not h.members
    )
    for wrong in found.wrong:
        mass[f"wrong_value@parameter:{wrong.name}"] = float(null * wrong.probability)
        null *= 1.0 - wrong.probability
    return {**mass, NOTHING: float(null)}


def covered(found: Posterior, label: str, truth: dict[str, float]) -> bool | None:
    """Whether the interval of the leading finding's constant holds its true value."""
    for number in found.leader.members:
        if found.candidates[number].label == label:
            (name, value), names = next(iter(truth.items())), found.leader.names[number]
            estimate, deviation = found.leader.constants[names[name]]
            return bool(abs(estimate - value) <= NORMAL * deviation)
    for wrong in found.wrong:
        if label == f"wrong_value@parameter:{wrong.name}":
            return bool(abs(wrong.value - truth[wrong.name]) <= NORMAL * wrong.deviation)
    return None


def judged(seed: int) -> dict[str, Any]:
    """Search one case and return what it states, and the truth."""
    plant, records, label, truth = drawn(seed)
    simulator = plant.simulator
    prepared = [Prepared.build(simulator.model, r) for r in records]
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = posterior(simulator.model, prepared, seen_by(simulator, prepared))
    seconds = round(time.process_time() - start, 1)
    row = {"seed": seed, "states": len(plant.start) * 2, "truth": label, "cpu_seconds": seconds}
    if found is None:
        return row | {"stated": {}, "covered": None, "latent": None}
    said = {k: round(p, 4) for k, p in stated(found).items() if p > LEAST or k == label}
    return row | {
        "stated": said,
        "covered": covered(found, label, truth) if truth else None,
        "latent": found.leader.share,
    }


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return reliability by bins, calibration error, rates and coverage."""
    pairs = [(p, k == r["truth"]) for r in rows for k, p in r["stated"].items()]
    first = [max(r["stated"].items(), key=lambda x: x[1]) for r in rows if r["stated"]]
    right = [k == r["truth"] for (k, _), r in zip(first, rows, strict=False)]
    bins, error = [], 0.0
    for low, high in itertools.pairwise(BINS):
        own = [(p, t) for p, t in pairs if low < p <= high]
        if own:
            mean, rate = (float(np.mean(x)) for x in zip(*own, strict=True))
            bins.append({"up_to": high, "stated": mean, "right": rate, "count": len(own)})
            error += len(own) / len(pairs) * abs(mean - rate)
    sure = [ok for (_, p), ok in zip(first, right, strict=True) if p > 0.95]
    inside = [r["covered"] for r in rows if r["covered"] is not None]
    false = [
        bool(k != NOTHING) for (k, _), r in zip(first, rows, strict=False) if r["truth"] == NOTHING
    ]
    return {
        "reliability": bins,
        "expected_calibration_error": error,
        "first_right": [sum(right), len(right)],
        "right_above_0.95": [sum(sure), len(sure)],
        "claims_where_nothing_is": [sum(false), len(false)],
        "covered": [sum(inside), len(inside)],
        "cpu_seconds_median": float(np.median([r["cpu_seconds"] for r in rows])),
    }


def main() -> int:
    """Run; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="four cases, no file")
    options = parser.parse_args()
    seeds = range(options.first, options.first + (4 if options.quick else options.cases))
    rows = []
    for seed in seeds:
        rows.append(judged(seed))
        print(json.dumps(rows[-1]), flush=True)
    print(json.dumps(summary(rows), indent=1))
    if not options.quick:
        title = "probabilities of the search by evidence against frequencies"
        write("evidence_calibration", title, list(seeds), {"summary": summary(rows), "cases": rows})
    return 0


if __name__ == "__main__":
    sys.exit(main())
