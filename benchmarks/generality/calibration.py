"""Simulation-based calibration of the search by evidence on cheap plants.

    python -m benchmarks.generality.calibration [--plants N] [--seed S] [--jobs N] [--out FILE]
    python -m benchmarks.generality.calibration --quick

Talts, Betancourt, Simpson, Vehtari & Gelman, arXiv:1804.06788: a plant's edit and constants are
drawn from the prior that the engine publishes, its motion is integrated by laws written anew, and
the engine weighs what the sensor read. Then the ranks of the true constants among their posteriors
are uniform, and of the probabilities that it states so many come true. Ranks are taken under the
edit that was drawn, so that no selection bends them.

Drawn are no edit or one, half and half: the prior odds of the engine, sets of several left out.
What it offers and no law here stands for (`LEFT_OUT`) is never drawn.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import warnings
import zlib
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import kstest, norm

from benchmarks.concealed.rates import Rate
from benchmarks.generality.laws import LAWS
from benchmarks.generality.plant import LEAD, Effect, Escaped, Plant, Signal, excited
from benchmarks.generality.prior import (
    BOUNDS,
    LEFT_OUT,
    PLANT,
    SAMPLES,
    Prior,
    model,
    prior,
    recorded,
    truncated,
    workspace,
)
from benchmarks.generality.scoring import calibration_error
from benchmarks.provenance import write
from jaxsr._files import dump_json
from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis, hypothesis
from jaxsr.diagnosis.likelihood.posterior import posterior
from jaxsr.diagnosis.likelihood.table import tabled
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.setup import prepare
from jaxsr.models import Model
from jaxsr.recordings import Recording

DRAWS = 40
"""Constants that are drawn until a plant's motion stays within bounds."""
BINS = 20


def one(seed: int, number: int) -> dict[str, Any]:
    """Draw, integrate and weigh a plant; return ranks and stated probabilities."""
    rng = np.random.default_rng([seed, zlib.crc32(b"calibration"), number])
    began = time.process_time()
    row: dict[str, Any] = {"plant": number, "broke": ""}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            row |= _weighed(rng)
        except Escaped as error:
            row["skipped"] = str(error)
        except Exception as error:  # an engine that breaks is counted
            row["broke"] = f"{type(error).__name__}: {error}"[:200]
    return row | {"cpu_seconds": round(time.process_time() - began, 2)}


def _weighed(rng: np.random.Generator) -> dict[str, Any]:
    given = model()
    time_axis = PLANT.dt * np.arange(-LEAD, SAMPLES)
    signal = excited(rng, PLANT.drives, time_axis, PLANT.hold, 0)
    base = {n: c.low for n, c in PLANT.constants.items()}
    for name, (low, high) in BOUNDS.items():
        base[name] = truncated(rng, base[name], (high - low) / np.sqrt(12.0), low, high)
    plain = recorded(rng, Plant(PLANT, base), signal)
    before = prior(given, plain)
    label = str(rng.choice(before.labels)) if rng.uniform() < 0.5 else ""
    values, recording = base, plain
    constants: dict[str, float] = {}
    if label:
        values, constants, recording = _edited(rng, before, label, base, signal, plain)
    found = posterior(given, prepare(given, [recording]))
    if found is None:
        raise ArithmeticError("nothing can be followed")
    empty = float(
        sum(p for h, p in zip(found.hypotheses, found.probabilities, strict=True) if not h.members)
    )
    return {
        "truth": label,
        "constants": constants,
        "labels": {k: p for k, p in found.of_labels().items() if p > 0.01},
        "empty": empty,
        "leader": sorted({found.candidates[i].label for i in found.leader.members}),
        "ranks": ranks(given, recording, label, {**values, **constants}),
    }


def _edited(
    rng: np.random.Generator,
    before: Prior,
    label: str,
    base: dict[str, float],
    signal: Signal,
    plain: Recording,
) -> tuple[dict[str, float], dict[str, float], Recording]:
    """Draw constants of an edit until its motion stays within bounds, and record it."""
    alike = [(i, {s.name for s in c.parameters}) for i, c in enumerate(before.candidates)]
    alike = [(i, names) for i, names in alike if before.candidates[i].label == label]
    # Another law of that name (presliding is a hysteresis) is not the one that is drawn.
    numbers = [i for i, names in alike if names == alike[0][1]]
    reach = np.array([np.ptp(plain.channels["y"])] * 2) * np.array([3.0, 30.0])
    for _ in range(DRAWS):
        number = int(rng.choice(numbers))
        constants = before.constants(rng, number)
        if label.startswith("wrong_value"):
            values = {**base, **constants}
            effect = None
        else:
            values = base
            law = LAWS[label.partition("@")[0]]
            speeds = np.gradient(plain.channels["y"], PLANT.dt)
            soft = 0.01 * float(np.sqrt(np.mean(speeds**2)))
            effect = Effect(law, (0,), constants, soft)
        try:
            return values, constants, recorded(rng, Plant(PLANT, values, effect), signal, reach)
        except Escaped:
            continue
    raise Escaped(f"{label}: no constants leave the motion within bounds")


def ranks(
    given: Model, recording: Recording, label: str, truth: Mapping[str, float]
) -> dict[str, float]:
    """Return the posterior probability below every true constant, under the edit that was drawn."""
    work = workspace(given, recording)
    table = tabled(work, work.theta, work.narrow.segments.course)
    candidates = work.super_model.candidates
    sets = [(i,) for i, c in enumerate(candidates) if c.label == label] if label else [()]
    tried = [hypothesis(work, table, members) for members in sets]
    best = max((h for h in tried if h is not None), key=lambda h: h.log_evidence, default=None)
    return {} if best is None else _ranks_of(work, best, truth)


def _ranks_of(work: Workspace, best: Hypothesis, truth: Mapping[str, float]) -> dict[str, float]:
    names = {n: n for n in work.super_model.given.parameters}
    for member in best.members:
        names |= best.names[member]
    edit = {own for member in best.members for own in best.names[member]}
    return {
        ("edit:" if own in edit else "given:") + own: float(norm.cdf((truth[own] - value) / sigma))
        for own, full in names.items()
        if own in truth and full in best.constants
        for value, sigma in [best.constants[full]]
        if sigma > 0.0
    }


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return ranks against the uniform distribution, and probabilities against frequencies."""
    good = [r for r in rows if "truth" in r]
    found: dict[str, Any] = {
        "plants": len(rows),
        "weighed": len(good),
        "skipped": sum("skipped" in r for r in rows),
        "crashes": [r["broke"] for r in rows if r["broke"]],
        "cpu_seconds_median": float(np.median([r["cpu_seconds"] for r in rows])),
    }
    for kind in ("given", "edit"):
        values = [u for r in good for n, u in r["ranks"].items() if n.startswith(f"{kind}:")]
        found[f"ranks_{kind}"] = uniformity(values)
    stated = [(p, label == r["truth"]) for r in good for label, p in r["labels"].items()]
    stated += [(r["empty"], not r["truth"]) for r in good]
    leading = [
        (max([r["empty"], *r["labels"].values()]), r["leader"] == [t for t in [r["truth"]] if t])
        for r in good
    ]
    found["stated"] = {"calibration_error": calibration_error(stated), "bins": _bins(stated)}
    found["leading"] = {"calibration_error": calibration_error(leading), "bins": _bins(leading)}
    return found


def uniformity(values: Sequence[float]) -> dict[str, Any]:
    """Return a Kolmogorov-Smirnov test against the uniform distribution, and a histogram."""
    if not values:
        return {"count": 0}
    counts, _ = np.histogram(values, BINS, (0.0, 1.0))
    inside = [0.025 <= u <= 0.975 for u in values]
    return {
        "count": len(values),
        "p": float(kstest(values, "uniform").pvalue),
        "histogram": counts.tolist(),
        "covered_by_95": Rate.of(inside).document(),
    }


def _bins(stated: Sequence[tuple[float, bool]]) -> list[dict[str, Any]]:
    rows = []
    for low in np.arange(0.0, 1.0, 0.1):
        own = [(p, r) for p, r in stated if low <= p < low + 0.1 or (low > 0.85 and p >= 1.0)]
        if own:
            right = Rate.of([bool(r) for _, r in own]).document()
            mean = float(np.mean([p for p, _ in own]))
            rows.append({"from": round(float(low), 1), "stated": mean, "right": right})
    return rows


def weighed(seed: int, plants: Iterable[int], jobs: int, out: Path | None) -> list[dict[str, Any]]:
    """Weigh plants that are not in the file yet; a line a plant is added to it."""
    done = []
    if out is not None and out.exists():
        done = [json.loads(line) for line in out.read_text(encoding="utf-8").splitlines()]
    todo = [n for n in plants if n not in {r["plant"] for r in done}]
    rows = list(done)

    def kept(found: Iterable[dict[str, Any]]) -> None:
        for row in found:
            row = json.loads(dump_json(row))
            rows.append(row)
            if out is not None:
                with out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")

    if jobs == 1:
        kept(one(seed, n) for n in todo)
    else:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            kept(pool.map(one, [seed] * len(todo), todo))
    return rows


def text(found: Mapping[str, Any]) -> str:
    """Return the summary for a terminal."""
    lines = [
        f"{found['weighed']} of {found['plants']} plants weighed, {found['skipped']} skipped, "
        f"{len(found['crashes'])} crashes, {found['cpu_seconds_median']:.1f} s of the processor"
    ]
    for kind in ("given", "edit"):
        row = found[f"ranks_{kind}"]
        if row["count"]:
            covered = row["covered_by_95"]
            lines.append(
                f"ranks of {kind} constants: {row['count']}, uniform with p {row['p']:.2g}, "
                f"95 % intervals cover {covered['k']} of {covered['n']}; {row['histogram']}"
            )
    for key in ("stated", "leading"):
        part = found[key]
        if part["calibration_error"] is not None:
            lines.append(f"{key} probabilities, calibration error {part['calibration_error']:.3f}")
            lines += [
                f"  {b['stated']:.2f}: right {b['right']['k']} of {b['right']['n']}"
                for b in part["bins"]
            ]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Run; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.generality.calibration",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--plants", type=int, default=1000, metavar="N")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1, metavar="N")
    parser.add_argument("--out", type=Path, default=None, metavar="FILE")
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args(arguments)
    plants = range(3 if options.quick else options.plants)
    rows = weighed(options.seed, plants, options.jobs, options.out)
    found = summary(rows)
    print(text(found))
    if not options.quick:
        body = {**found, "left_out": list(LEFT_OUT)}
        write("generality_calibration", "cheap plants from the prior", [options.seed], body)
    return int(bool(options.quick and found["crashes"]))


if __name__ == "__main__":
    sys.exit(main())
