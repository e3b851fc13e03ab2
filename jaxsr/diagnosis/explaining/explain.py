"""Rows of ``diagnosis.json`` in words and numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxsr.diagnosis.contest.uncertainty import DETECTION, Sensitivities
from jaxsr.diagnosis.explaining.coarse import coarse_sensors, rounded_reading
from jaxsr.diagnosis.explaining.experiment import best_experiment
from jaxsr.diagnosis.judging.alternatives import Alternative
from jaxsr.diagnosis.judging.refine import Estimate
from jaxsr.models import Edit, Model, with_values

if TYPE_CHECKING:
    from jaxsr.diagnosis.explaining.judge import Ingredients

CONFUSED = 30.0
"""Degrees below which two effects are listed as confusable."""
HARDLY = 0.005
"""Share of the mismatch below which the error left without a finding is told in its place."""


def parameter_row(estimate: Estimate, name: str) -> dict[str, Any]:
    """Value, 95 % interval and unit of one parameter."""
    value, half = estimate.interval(name)
    unit = estimate.named.model.parameters[name].unit
    # what is known beforehand is known afterwards: an interval keeps to the bounds
    low, high = (float(bound[estimate.positions[name]]) for bound in estimate.arena.bounds)
    ends = [min(max(value - half, low), value), max(min(value + half, high), value)]
    return {"value": value, "ci95": ends, "unit": unit}


def calibration_rows(estimate: Estimate, given: Model) -> dict[str, Any]:
    """The given model's free parameters as re-estimated."""
    rows = {}
    for name in given.free_parameters:
        row = parameter_row(estimate, name)
        rows[name] = {"value": row["value"], "ci95": row["ci95"]}
    return rows


@dataclass(frozen=True)
class Weight:
    """What one finding matters.

    Attributes
    ----------
    share : float
        Share of the mismatch that is lost without it.
    times : float
        Squared error left without it, relative to that of the explained model.
    """

    share: float
    times: float

    def in_words(self) -> str:
        """Say the share, or the other where the given model is so far off that it says nothing."""
        if self.share < HARDLY and np.isfinite(self.times):
            return f"without it, {self.times:.2g} times the squared error would be left"
        return f"it accounts for {100 * self.share:.0f} % of the explained mismatch"


def finding_row(
    parts: Ingredients,
    estimate: Estimate,
    position: int,
    number: int,
    probability: float,
    others: list[Alternative],
    weight: Weight,
) -> dict[str, Any]:
    """One finding in the form of CONTRACT.md, section 4."""
    candidate, names = estimate.named.candidates[position], estimate.named.names[position]
    given = estimate.named.given
    own = {spec: estimate.interval(name)[0] for spec, name in names.items()}
    # Relative to the given file alone: the names must be free there as well.
    edit = {} if candidate.passing else candidate.edit(given, names, own).as_json()
    borrowed = [(own, full) for own, full in candidate.borrowed if full in estimate.positions]
    shown = {own: parameter_row(estimate, full) for own, full in borrowed}
    shown |= {full: parameter_row(estimate, full) for full in names.values()}
    return {
        "site": candidate.site,
        "mechanism": candidate.mechanism,
        "family": candidate.family,
        "probability": probability,
        "alternatives": [_alternative(parts, a) for a in others[:4]],
        "edit": edit,
        "term": candidate.term_text(names),
        "parameters": shown,
        "where": where(parts, candidate.site, candidate.quiet),
        "share": weight.share,
        "explanation": _explanation(candidate, shown, weight),
    }


def _alternative(parts: Ingredients, other: Alternative) -> dict[str, Any]:
    super_model = parts.arena.super_model
    candidate = super_model.candidates[other.number]
    return {
        "mechanism": candidate.mechanism,
        "site": candidate.site,
        "probability": other.probability,
        "parameters": super_model.own_values(other.number, other.entry.fit.theta),
    }


def wrong_value_row(
    parts: Ingredients, estimate: Estimate, name: str, given_cost: float, probability: float
) -> dict[str, Any]:
    """A finding that a free parameter's given value is wrong."""
    given = parts.case.simulator.model
    row = parameter_row(estimate, name)
    before = given.parameters[name].value
    changed = with_values(given, {name: row["value"]}).parameters[name]
    total = max(given_cost - estimate.entry.fit.cost, 1e-300)
    i = estimate.positions[name]
    k = int(np.flatnonzero(estimate.entry.fit.active == i)[0])
    hessian = estimate.entry.fit.normal_equations()[0].sum(0)
    alone = float(hessian[k, k] * (row["value"] - before) ** 2)
    return {
        "site": f"parameter:{name}",
        "mechanism": "wrong_value",
        "family": "parameter",
        "probability": probability,
        "alternatives": [],
        "edit": Edit({f"parameters.{name}": changed}).as_json(),
        "term": name,
        "parameters": {name: row},
        "where": where(parts, ""),
        "share": float(np.clip(alone / total, 0.0, 1.0)),
        "explanation": f"The value of {name} in the model is {before:.4g}; the recordings "
        f"ask for {row['value']:.4g} (95 % interval {row['ci95'][0]:.4g} to {row['ci95'][1]:.4g}).",
    }


def rounding_rows(
    parts: Ingredients, estimate: Estimate, given_cost: float
) -> tuple[list[dict[str, Any]], list[Edit]]:
    """Findings that a sensor's converter is coarser than stated, with edits of the estimate.

    That readings lie on a grid, and what a file states of it, are certain. What rounding the
    simulated readings would save is the power of the steps.
    """
    given, problem, model = parts.case.simulator.model, estimate.arena.problem, estimate.model
    rows, edits = [], []
    for coarse in coarse_sensors(given, parts.case.prepared):
        k = list(given.outputs).index(coarse.output)
        saved = coarse.variance * problem.segments.weights[k].sum() / problem.scale[k] ** 2
        share = float(np.clip(saved / max(given_cost, 1e-300), 0.0, 1.0))
        taken = {
            *given.symbols,
            *model.symbols,
            *model.definitions,
            *(n for row in rows for n in row["parameters"]),
        }
        name = next(n for n in ("step", *(f"step_{k}" for k in range(1000))) if n not in taken)
        edit = rounded_reading(given, coarse, name)
        edits.append(rounded_reading(model, coarse, name))
        unit = given.units.get(coarse.output)
        size = f"{coarse.step:.4g}{' ' + unit if unit else ''}"
        rows.append(
            {
                "site": f"output:{coarse.output}",
                "mechanism": "quantisation",
                "family": "measurement",
                "probability": 1.0,
                "alternatives": [],
                "edit": edit.as_json(),
                "term": edit.changes[f"readings.{coarse.output}"],
                "parameters": {
                    name: {
                        "value": coarse.step,
                        "ci95": [coarse.step - coarse.half, coarse.step + coarse.half],
                        "unit": unit,
                    }
                },
                "where": where(parts, ""),
                "share": share,
                "explanation": f"Sensor {coarse.output} reads in steps of {size}, where the model "
                f"states {coarse.stated}.",
            }
        )
    return rows, edits


def where(parts: Ingredients, site: str, quiet: tuple[str, ...] = ()) -> dict[str, Any]:
    """Recordings, times, and the range of the state in which most of the mismatch lies."""
    prepared = parts.case.prepared
    acting = [p for p in prepared if p.recording.name not in quiet]
    region: list[dict[str, Any]] = []
    state = site.partition(":")[2]
    model = parts.case.simulator.model
    if parts.case.screened is not None and state in model.states:
        screened = parts.case.screened
        rows = screened.system.state == model.states.index(state)
        residual = screened.system.at(screened.screening.empty.values)[rows]
        position = np.empty(rows.sum())
        for r in np.unique(screened.system.recording[rows]):
            mine = screened.system.recording[rows] == r
            item = prepared[int(r)]
            signal = item.states.values[:, model.states.index(state)]
            position[mine] = np.interp(screened.system.centre[rows][mine], item.time, signal)
        if position.size:
            low, high = _densest(position, residual**2)
            region = [{"variable": state, "from": low, "to": high}]
    recordings = [p.recording for p in acting]
    if parts.whole is not None:
        recordings = [r for r in parts.whole.recordings if r.name not in quiet]
    return {
        "region": region,
        "recordings": [r.name for r in recordings],
        "times": [[float(r.time[0]), float(r.time[-1])] for r in recordings],
    }


def _densest(position: np.ndarray, power: np.ndarray) -> tuple[float, float]:
    """Shortest interval that holds two thirds of the residual's power."""
    order = np.argsort(position)
    cumulated = np.concatenate([[0.0], np.cumsum(power[order])])
    cumulated /= cumulated[-1] + 1e-300
    ends = np.searchsorted(cumulated, cumulated + 2.0 / 3.0)
    valid = np.flatnonzero(ends < cumulated.size)
    x = np.concatenate([position[order], position[order][-1:]])
    if valid.size == 0:
        return float(x[0]), float(x[-1])
    best = valid[np.argmin(x[np.minimum(ends[valid], x.size - 1)] - x[valid])]
    return float(x[best]), float(x[min(ends[best], x.size - 1)])


def _explanation(candidate: Any, shown: dict, weight: Weight) -> str:
    units = {n: row["unit"] if row["unit"] != "1" else "" for n, row in shown.items()}
    numbers = ", ".join(
        f"{n} = {r['value']:.4g} {units[n] or ''}".rstrip() for n, r in shown.items()
    )
    return f"{candidate.sentence.format(site=candidate.site)} {numbers}; {weight.in_words()}."


def confusable_rows(parts: Ingredients, table: Sensitivities) -> list[list[Any]]:
    """Pairs of mechanisms whose effects in the sensors lie close, angle in degrees."""
    candidates = parts.arena.super_model.candidates
    rows: dict[tuple[str, str], float] = {}
    for a, i in enumerate(table.candidates):
        for j in table.candidates[a + 1 :]:
            angle = table.angle(i, j)
            if candidates[i].label != candidates[j].label and angle < CONFUSED:
                key = (candidates[i].label, candidates[j].label)
                rows[key] = min(angle, rows.get(key, 90.0))
    ordered = sorted(rows.items(), key=lambda item: item[1])[:12]
    return [[_short(a), _short(b), round(angle, 2)] for (a, b), angle in ordered]


def _short(label: str) -> str:
    """Return the mechanism of a label."""
    return label.partition("@")[0]


def detectable_rows(parts: Ingredients, table: Sensitivities) -> dict[str, Any]:
    """Smallest effect of each mechanism that these recordings would show."""
    super_model = parts.arena.super_model
    rows: dict[str, Any] = {}
    for k, number in enumerate(table.candidates):
        candidate = super_model.candidates[number]
        spec = next((s for s in candidate.parameters if s.coefficient), None)
        error = float(table.error[k])
        if spec is None or not np.isfinite(error) or error > 1e30:
            continue
        value = DETECTION * error
        if candidate.label in rows and rows[candidate.label]["value"] < value:
            continue
        rows[candidate.label] = {
            "parameter": spec.name,
            "value": value,
            "unit": spec.unit,
        }
    return rows


_ADVICE = {
    "dissipative": "slow reversals and long runs at constant high speed",
    "elastic": "displacements well beyond those recorded, held at several positions",
    "inertial": "the same motion at another attitude or with faster accelerations",
    "coupling": "one axis moved while the other is held, then the reverse",
    "measurement": "a static calibration of the sensor against a reference",
    "parameter": "a bench measurement of the parameter",
}
TOLD_APART = 0.3
"""Separation, in standard deviations a sample, from which an experiment is worth its time."""


def next_experiment(parts: Ingredients, rivals: list[tuple[int, list[Alternative]]]) -> str | None:
    """Say which recording would separate the leading explanation from its runner-up."""
    candidates = parts.arena.super_model.candidates
    best = [(others[0].probability, number, others[0]) for number, others in rivals if others]
    if not best:
        return None
    _, number, other = max(best, key=lambda item: item[:2])
    first, second = candidates[number], candidates[other.number]
    found = best_experiment(parts, other.entry)
    if found is not None and found.separation > TOLD_APART:
        return (
            f"Record {found.text}: there {first.label} and {second.label}, as estimated, would "
            f"differ by {found.separation:.2g} standard deviations of what is left, sample by "
            "sample, after re-calibration."
        )
    advice = [_ADVICE.get(c.family, "a richer excitation") for c in (first, second)]
    text = " and ".join(dict.fromkeys(advice))
    return f"{text[0].upper()}{text[1:]} would separate {first.label} from {second.label}."
