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
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import kstest, norm

from benchmarks.concealed.rates import Rate
from benchmarks.generality.laws import LAWS
from benchmarks.generality.plant import (
    LEAD,
    Effect,
    Escaped,
    Plant,
    Signal,
    excited,
    readings,
)
from benchmarks.generality.scoring import calibration_error
from benchmarks.generality.system import Array, Axis, Constant, Drive, Gauge, System, Values
from benchmarks.provenance import write
from jaxsr._files import dump_json
from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis, hypothesis
from jaxsr.diagnosis.likelihood.offered import offered
from jaxsr.diagnosis.likelihood.posterior import UNSEEN, posterior
from jaxsr.diagnosis.likelihood.workspace import Table, Workspace, in_columns, tabled
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import prepare, sample_step, screen_all
from jaxsr.models import Model, parse_model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

SAMPLES = 200
NOISE = 4e-3
"""Of the reading's deviation."""
LEFT_OUT = ("position_dependent_friction", "backlash", "drift", "hidden_mode", "clipping")
DRAWS = 40
"""Constants that are drawn until a plant's motion stays within bounds."""
BINS = 20


def _oscillator(x: Array, u: Array, p: Values, f: Array) -> Any:
    place, speed = x
    return [speed, (u[0] - p["c"] * speed - p["k"] * place + f[0]) / p["m"]]


PLANT = System(
    name="cheap_oscillator",
    group="calibration",
    states=("q", "v"),
    tables="""
[equations]
q = "v"
v = "(u - c*v - k*q)/m"
""",
    field=_oscillator,
    constants={
        "m": Constant(1.0, 1.0),
        "c": Constant(1.0, 1.0, free=True),
        "k": Constant(30.0, 30.0, free=True),
    },
    drives={"u": Drive(8.0, (1.5, 12.0))},
    axes=(Axis("v", "q"),),
    gauges=(Gauge("q", "position"),),
    dt=0.02,
)
BOUNDS = {"c": (0.2, 1.8), "k": (15.0, 45.0)}
"""Of the free parameters: the prior is normal about the file's value, with the deviation of a
uniform one between the bounds."""


@dataclass(frozen=True, eq=False)
class Prior:
    """What the engine believes before it sees a plant, and what it offers."""

    work: Workspace
    table: Table

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """Everything that was offered."""
        return self.work.super_model.candidates

    @property
    def labels(self) -> list[str]:
        """Mechanisms at places that can be drawn."""
        names = dict.fromkeys(
            c.label for c in self.candidates if c.mechanism in (*LAWS, "wrong_value")
        )
        return [n for n in names if n.partition("@")[0] not in LEFT_OUT]

    def constants(self, rng: np.random.Generator, number: int) -> dict[str, float]:
        """Draw the constants of a candidate, by its own names."""
        candidate, model = self.candidates[number], self.work.super_model
        names, found = model.names[number], {}
        theta = model.seeded([number], self.work.theta)
        order = list(model.model.parameters)
        for spec in candidate.parameters:
            full = names[spec.name]
            mean, deviation = self._belief(number, spec.name, float(theta[order.index(full)]))
            low, high = model.model.parameters[full].bounds or (spec.low, spec.high)
            found[spec.name] = mean if spec.fixed else _truncated(rng, mean, deviation, low, high)
        return found

    def _belief(self, number: int, own: str, value: float) -> tuple[float, float]:
        """Return mean and deviation: those of the table of columns, else by the value itself."""
        if number in self.work.place:
            columns, at = self.work.columns, self.work.place.index(number)
            full = columns.names[at][own]
            names = list(columns.model.parameters)
            if full in names and names.index(full) in self.table.active:
                k = self.table.active.index(names.index(full))
                belief = self.table.belief
                # a limit far away is tried at its seed instead
                if abs(belief.mean[k]) < 1e6:
                    return float(belief.mean[k]), float(belief.deviation[k])
        return value, abs(value) or 1.0


def _truncated(
    rng: np.random.Generator, mean: float, deviation: float, low: float, high: float
) -> float:
    """Draw from a normal distribution cut at its bounds."""
    a, b = norm.cdf([(low - mean) / deviation, (high - mean) / deviation])
    return float(np.clip(norm.ppf(rng.uniform(a, b)) * deviation + mean, low, high))


def model() -> Model:
    """Return the model that the engine is given."""
    values = {n: c.low for n, c in PLANT.constants.items()}
    return parse_model(PLANT.model_text(values, BOUNDS, {"y": "q"}), "cheap.toml")


def recorded(
    rng: np.random.Generator, plant: Plant, signal: Signal, reach: Array | None = None
) -> Recording:
    """Integrate a plant and read its position."""
    time = signal.time[LEAD:]
    _, y = readings(plant, signal, PLANT.gauges, time, reach)
    noisy = y[0] + NOISE * y[0].std() * rng.normal(size=time.size)
    return Recording("run.csv", time, {"u": signal.values[0][LEAD:], "y": noisy})


def workspace(given: Model, recording: Recording) -> tuple[Workspace, tuple[Prepared, ...]]:
    """Return what the engine works with on a recording."""
    prepared = prepare(given, [recording])
    from jaxsr.models import Simulator

    screened = screen_all(Simulator(given), prepared)
    super_model = SuperModel.build(given, offered(given, prepared, screened))
    seconds = UNSEEN * sample_step(prepared) if screened is None else 0.5 * screened.half_width
    return Workspace.build(super_model, prepared, seconds), prepared


def prior(given: Model, recording: Recording) -> Prior:
    """Return the prior that the engine has on a motion without any edit."""
    work, _ = workspace(given, recording)
    table = tabled(work, in_columns(work, work.theta), work.narrow.segments.course)
    return Prior(work, table)


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
    from jaxsr.models import Simulator

    given = model()
    time_axis = PLANT.dt * np.arange(-LEAD, SAMPLES)
    signal = excited(rng, PLANT.drives, time_axis, PLANT.hold, 0)
    base = {n: c.low for n, c in PLANT.constants.items()}
    for name, (low, high) in BOUNDS.items():
        base[name] = _truncated(rng, base[name], (high - low) / np.sqrt(12.0), low, high)
    plain = recorded(rng, Plant(PLANT, base), signal)
    before = prior(given, plain)
    label = str(rng.choice(before.labels)) if rng.uniform() < 0.5 else ""
    values, recording = base, plain
    constants: dict[str, float] = {}
    if label:
        values, constants, recording = _edited(rng, before, label, base, signal, plain)
    prepared = prepare(given, [recording])
    found = posterior(given, prepared, screen_all(Simulator(given), prepared))
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
    numbers = [i for i, c in enumerate(before.candidates) if c.label == label]
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
    work, _ = workspace(given, recording)
    path = work.narrow.segments.course
    table = tabled(work, in_columns(work, work.theta), path)
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
        (max([r["empty"], *r["labels"].values()]), r["leader"] == ([r["truth"]] if r["truth"] else []))
        for r in good
    ]  # fmt: skip
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
