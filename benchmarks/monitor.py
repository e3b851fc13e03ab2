"""False alarms of a monitor in normal running, and how soon it notices what changes.

    python -m benchmarks.monitor [--quick | --resume]

Four machines (`benchmarks.monitor_plants`): white noise, noise that is correlated from sample to
sample, an encoder, a force that no model knows. They run normally for 102 hours, each under three
monitors, which learnt what is normal from another 4,000 samples; they may raise one false alarm per
hour. Then five effects begin, one at a time, under monitors that may raise one in ten hours, twenty
runs each. A full run writes ``results/monitor.json`` machine by machine, and --resume goes on with
those that are left; --quick (two machines, less of all) writes nothing. Ends with
status 1 where more false alarms come than chance makes of the stated rate in one run of a thousand,
or an effect is missed more often than in one run of ten.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import warnings
from typing import Any

import numpy as np
from scipy.stats import poisson

from benchmarks.monitor_plants import EFFECTS, MOUNT, PLANTS, TANKS, Plant
from benchmarks.provenance import RESULTS, origin_of
from jaxsr._files import atomic_write_text, dump_json
from jaxsr.monitoring import Monitor, monitor

RESULT = RESULTS / "monitor.json"
SEED = 38
NORMAL, LITTLE = 4000, 2000
"""Samples of normal running that a monitor learns from; the same with --quick."""
QUICK_HOURS = 1.0
MONITORS = 3
"""Monitors of a machine, each of which watches one run."""
HOURS = {
    "drive with gear": 2.0,
    "machine mount": 2.0,
    "pendulum in the wind": 2.0,
    "two tanks": 28.0,
}
"""Length of a run: 102 hours in all, most of them of the machine that is sampled slowly."""
RATE, RARE = 1.0, 0.1
"""False alarms per hour: stated for normal running, and while an effect is awaited."""
TRIALS = 20
BEGINS, AFTER = 2000, 4000
"""Samples before an effect begins and behind it."""


def watchers(plant: Plant, count: int, samples: int) -> list[Monitor]:
    """Return monitors of a machine, each with normal running of its own."""
    rng = np.random.default_rng([SEED, PLANTS.index(plant)])
    runs = plant.runs(rng, count, samples)
    return [monitor(plant.model, [run], false_alarms_per_hour=RATE) for run in runs]


def false_alarms(plant: Plant, watching: list[Monitor], hours: float) -> dict[str, Any]:
    """Count the alarms in normal running."""
    rng = np.random.default_rng([SEED, PLANTS.index(plant), 1])
    begin, alarms = time.process_time(), 0
    samples = round(hours * 3600.0 / plant.interval)
    for watch, run in zip(watching, plant.runs(rng, len(watching), samples), strict=True):
        alarms += len(watch.read(run))
    judged = sum(w.hours for w in watching)
    return {
        "plant": plant.model.name,
        "hours": round(judged, 2),
        "blocks": round(judged * 3600.0 / plant.interval / watching[0].rhythm.block),
        "stated_per_hour": RATE,
        "alarms": alarms,
        "exponents": [round(w.exponent, 3) for w in watching],
        "seconds": round(time.process_time() - begin, 1),
    }


def delays(plant: Plant, learnt: Monitor, effect: str, words: str, trials: int) -> dict[str, Any]:
    """Return how soon an effect is noticed, in s, and where it is seen."""
    rng = np.random.default_rng([SEED, 2, [e[1] for e in EFFECTS].index(effect)])
    watch, begins = learnt.at_rate(RARE), BEGINS * plant.interval
    found, early, first = [], 0, []
    for run in plant.runs(rng, trials, BEGINS + AFTER, effect, BEGINS):
        alarms = watch.read(run)
        watch.reset()
        early += sum(a.time < begins for a in alarms)
        late = [a for a in alarms if a.time >= begins]
        if late:
            found.append(late[0].time - begins)
            first.append(late[0].suspects[0][0])
    quantiles = np.quantile(found, [0.5, 0.9]) if found else (None, None)
    return {
        "plant": plant.model.name,
        "effect": words,
        "runs": trials,
        "noticed": len(found),
        "before": early,
        "median_s": quantiles[0],
        "ninth_decile_s": quantiles[1],
        "block_s": watch.rhythm.block * plant.interval,
        "first_suspects": {site: first.count(site) for site in sorted(set(first))},
        "stated_per_hour": RARE,
    }


def rows_of(plant: Plant, quick: bool) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return what normal running and the effects of one machine show, and print it."""
    count, learnt, trials = (1, LITTLE, 2) if quick else (MONITORS, NORMAL, TRIALS)
    begin = time.process_time()
    watching = watchers(plant, count, learnt)
    spent = time.process_time() - begin
    normal = false_alarms(plant, watching, QUICK_HOURS if quick else HOURS[plant.model.name])
    print(
        f"{normal['plant']}: {normal['alarms']} false alarms in {normal['hours']:.4g} h, "
        f"{RATE:g} per hour stated, exponents {normal['exponents']} "
        f"({spent:.1f} + {normal['seconds']} s)",
        flush=True,
    )
    effects = []
    for own, effect, words in EFFECTS:
        if own is plant:
            effects.append(delays(plant, watching[0], effect, words, trials))
            row = effects[-1]
            print(
                f"{words}: {row['noticed']} of {row['runs']} noticed, {row['before']} early alarms,"
                f" median {row['median_s']:.3g} s, {row['first_suspects']}",
                flush=True,
            )
    return normal, effects


def main() -> int:
    """Run the machines; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="less of all, writes nothing")
    parser.add_argument("--resume", action="store_true", help="leave out machines that are done")
    args = parser.parse_args()
    warnings.filterwarnings("error", category=RuntimeWarning)
    normal: list[dict[str, Any]] = []
    effects: list[dict[str, Any]] = []
    if args.resume and RESULT.exists():
        known = json.loads(RESULT.read_text(encoding="utf-8"))
        normal, effects = known["normal"], known["effects"]
    done = {row["plant"] for row in normal}
    for plant in (TANKS, MOUNT) if args.quick else PLANTS[::-1]:
        if plant.model.name in done:
            continue
        row, more = rows_of(plant, args.quick)
        normal, effects = [*normal, row], [*effects, *more]
        if not args.quick:
            document = {"provenance": origin_of(SEED), "normal": normal, "effects": effects}
            atomic_write_text(RESULT, dump_json(document))
    hours, alarms = (sum(r[key] for r in normal) for key in ("hours", "alarms"))
    print(f"{alarms} false alarms in {hours:.4g} h")
    missed = any(r["noticed"] < 0.9 * r["runs"] for r in effects)
    return int(alarms > poisson.ppf(0.999, RATE * hours) or missed)


if __name__ == "__main__":
    sys.exit(main())
