"""False alarms of a monitor in normal running, and how soon it notices what changes.

    python -m benchmarks.monitor [--quick] [--only PLANT]

Four machines (`benchmarks.monitor_plants`): white noise, noise that is correlated from sample to
sample, an encoder, a force that no model knows. They run normally for 102 hours, each under three
monitors, which learnt what is normal from another 8,000 samples; they may raise one false alarm per
hour. Then five effects begin, one at a time, under monitors that may raise one in ten
hours, twenty runs each. A full run writes ``results/monitor.json``; --quick (less of all, and
fewer false alarms allowed) writes nothing. Ends with status 1 where more false alarms come than
chance makes of the stated rate in one run of a thousand, or an effect is missed more often than in
one run of ten.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from typing import Any

import numpy as np
from scipy.stats import poisson

from benchmarks.monitor_plants import EFFECTS, PLANTS, TANKS, Plant
from benchmarks.provenance import RESULTS, origin_of
from jaxsr._files import atomic_write_text, dump_json
from jaxsr.monitoring import Monitor, monitor

RESULT = RESULTS / "monitor.json"
SEED = 37
NORMAL, LITTLE = 8000, 2000
"""Samples of normal running that a monitor learns from; the same with --quick."""
MONITORS = 3
"""Monitors of a machine, each of which watches one run."""
HOURS = {
    "drive with gear": 4.0,
    "machine mount": 4.0,
    "pendulum in the wind": 4.0,
    "two tanks": 22.0,
}
"""Length of a run: 102 hours in all, over half of them of the machine that is sampled slowly."""
RATE, RARE = 1.0, 0.1
"""False alarms per hour: stated for normal running, and while an effect is awaited."""
TRIALS = 20
QUICK = ("softer", "leak")
BEGINS, AFTER = 2000, 4000
"""Samples before an effect begins and behind it."""


def watchers(
    plant: Plant, rate: float, count: int, rng: np.random.Generator, samples: int
) -> list[Monitor]:
    """Return monitors of a machine, each with normal running of its own."""
    runs = plant.runs(rng, count, samples)
    return [monitor(plant.model, [run], false_alarms_per_hour=rate) for run in runs]


def false_alarms(plant: Plant, monitors: int, hours: float, learnt: int) -> dict[str, Any]:
    """Count the alarms in normal running; monitors learn from so many samples."""
    rng = np.random.default_rng([SEED, PLANTS.index(plant)])
    begin = time.process_time()
    watching = watchers(plant, RATE, monitors, rng, learnt)
    samples = round(hours * 3600.0 / plant.interval)
    alarms = 0
    for watch, run in zip(watching, plant.runs(rng, monitors, samples), strict=True):
        alarms += len(watch.read(run))
    judged = sum(w.hours for w in watching)
    return {
        "plant": plant.model.name,
        "hours": round(judged, 2),
        "stated_per_hour": RATE,
        "alarms": alarms,
        "per_hour": alarms / judged,
        "exponents": [round(w.exponent, 3) for w in watching],
        "seconds": round(time.process_time() - begin, 1),
    }


def delays(plant: Plant, effect: str, words: str, trials: int, learnt: int) -> dict[str, Any]:
    """Return how soon an effect is noticed, in samples and seconds, and where it is seen."""
    rng = np.random.default_rng([SEED, 1, [e[1] for e in EFFECTS].index(effect)])
    (watch,) = watchers(plant, RARE, 1, rng, learnt)
    begins = BEGINS * plant.interval
    found, early, first = [], 0, []
    for run in plant.runs(rng, trials, BEGINS + AFTER, effect, BEGINS):
        alarms = watch.read(run)
        watch.reset()
        early += sum(a.time < begins for a in alarms)
        late = [a for a in alarms if a.time >= begins]
        if late:
            found.append(late[0].time - begins)
            first.append(late[0].suspects[0][0])
    sites = {site: first.count(site) for site in sorted(set(first))}
    quantiles = np.quantile(found, [0.5, 0.9]) if found else (None, None)
    return {
        "plant": plant.model.name,
        "effect": words,
        "runs": trials,
        "noticed": len(found),
        "before": early,
        "median_s": quantiles[0],
        "ninth_decile_s": quantiles[1],
        "interval_s": plant.interval,
        "first_suspects": sites,
        "stated_per_hour": RARE,
    }


def main() -> int:
    """Run the machines; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="less of all, writes nothing")
    parser.add_argument("--only", help="one machine by name, writes nothing")
    args = parser.parse_args()
    warnings.filterwarnings("error", category=RuntimeWarning)
    count, learnt = (1, LITTLE) if args.quick else (MONITORS, NORMAL)
    normal, effects = [], []
    for plant in PLANTS:
        if args.only in (None, plant.name) and not (args.quick and plant is not TANKS):
            hours = 2.0 if args.quick else HOURS[plant.model.name]
            normal.append(false_alarms(plant, count, hours, learnt))
            row = normal[-1]
            print(
                f"{row['plant']}: {row['alarms']} false alarms in {row['hours']:.4g} h, "
                f"{RATE:g} per hour stated, exponents {row['exponents']} ({row['seconds']} s)",
                flush=True,
            )
    for plant, effect, words in EFFECTS:
        if args.only in (None, plant.name) and (not args.quick or effect in QUICK):
            effects.append(delays(plant, effect, words, 2 if args.quick else TRIALS, learnt))
            row = effects[-1]
            print(
                f"{words}: {row['noticed']} of {row['runs']} noticed, {row['before']} early alarms,"
                f" median {row['median_s']} s, {row['first_suspects']}",
                flush=True,
            )
    hours, alarms = (sum(r[key] for r in normal) for key in ("hours", "alarms"))
    print(f"{alarms} false alarms in {hours:.4g} h")
    if not (args.quick or args.only):
        document = {"provenance": origin_of(SEED), "normal": normal, "effects": effects}
        atomic_write_text(RESULT, dump_json(document))
    missed = any(r["noticed"] < 0.9 * r["runs"] for r in effects)
    return int(alarms > poisson.ppf(0.999, RATE * hours) or missed)


if __name__ == "__main__":
    sys.exit(main())
