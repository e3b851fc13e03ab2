"""Rows of ``diagnosis.json`` in words and numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.diagnosis.explaining.acting import where_acting
from jaxsr.diagnosis.explaining.coarse import coarse_sensors, rounded_reading
from jaxsr.diagnosis.explaining.ingredients import Ingredients
from jaxsr.diagnosis.judging.refine import Estimate
from jaxsr.diagnosis.judging.weights import Alternative
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.shooting.uncertainty import RANK, Sensitivities
from jaxsr.models import Edit, Model, with_values
from jaxsr.report.formatting import digits_of, number, plainly, unit_text
from jaxsr.report.words import capital

CONFUSED = 30.0
"""Degrees below which two effects are listed as confusable."""
SAME = 1e-3
"""Degrees up to which two effects have one direction."""
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
    r"""What one finding matters.

    With the sums of squares G of the given values, E of the explained model and W of that
    without the finding, all else re-estimated:

    Attributes
    ----------
    share : float
        (W - E) / (G - E), clipped to [0, 1]: of the mismatch of the given model, what comes back.
        The rest of it, (G - W) / (G - E), other values make good.
    times : float
        W / E.
    """

    share: float
    times: float

    @staticmethod
    def of(given: float, without: float, explained: float) -> Weight:
        """Compare the three sums; a model that cannot be simulated without it lacks all."""
        if not np.isfinite(without) or not np.isfinite(given):
            return Weight(1.0, np.inf)
        least = max(explained, 1e-300)
        share = (without - explained) / max(given - explained, 1e-300)
        return Weight(float(np.clip(share, 0.0, 1.0)), without / least)

    def in_words(self) -> str:
        """Say what would be left without it, and what makes good the rest."""
        times = f"{number(self.times, 2)} times the squared error"
        if self.share < HARDLY and np.isfinite(self.times):
            return f"without it, {times} would be left"
        if self.share > 1.0 - HARDLY:
            return "without it, all of the given model's mismatch would come back"
        part = round(100 * self.share)
        return (
            f"without it, {part} % of the given model's mismatch would come back ({times} of the "
            f"explained model); values re-estimated without it make good the other {100 - part} %"
        )


def finding_row(
    parts: Ingredients,
    estimate: Estimate,
    position: int,
    number: int,
    probability: float,
    others: list[Alternative],
    weight: Weight,
) -> dict[str, Any]:
    """One finding in the form of docs/files.md."""
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
        "where": _where(parts, estimate, position),
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
    parts: Ingredients, estimate: Estimate, name: str, weight: Weight, probability: float
) -> dict[str, Any]:
    """A finding that a free parameter's given value is wrong."""
    given = parts.case.simulator.model
    row = parameter_row(estimate, name)
    before = given.parameters[name]
    changed = with_values(given, {name: row["value"]}).parameters[name]
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
        "share": weight.share,
        "explanation": f"The value of {name} in the model is {before.value:.4g}; the recordings "
        f"ask for {in_figures(row)}; {weight.in_words()}.",
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


def where(parts: Ingredients, _: str = "", quiet: tuple[str, ...] = ()) -> dict[str, Any]:
    """All recordings but the quiet ones, from beginning to end."""
    recordings = [p.recording for p in parts.case.prepared]
    if parts.whole is not None:
        recordings = list(parts.whole.recordings)
    recordings = [r for r in recordings if r.name not in quiet]
    return {
        "region": [],
        "recordings": [r.name for r in recordings],
        "times": [[float(r.time[0]), float(r.time[-1])] for r in recordings],
    }


def _where(parts: Ingredients, estimate: Estimate, position: int) -> dict[str, Any]:
    """Where a mechanism acts; of long recordings the search saw a part, and says all times."""
    candidate = estimate.named.candidates[position]
    found = where_acting(candidate, estimate, position)
    if parts.whole is None:
        return found
    return where(parts, candidate.site, candidate.quiet) | {"region": found["region"]}


def sentence_of(candidate: Candidate) -> str:
    """Say what a mechanism means, sites by the names of their signals."""
    kind, _, place = candidate.site.partition(":")
    text = candidate.sentence.format(site=f"input {place}" if kind == "input" else place)
    return capital(text.replace("equation:", ""))


def _explanation(candidate: Candidate, shown: dict[str, Any], weight: Weight) -> str:
    numbers = ", ".join(f"{n} = {in_figures(row)}" for n, row in shown.items())
    return f"{sentence_of(candidate)} {numbers}; {weight.in_words()}."


def in_figures(row: dict[str, Any]) -> str:
    """Return a value with its unit and interval, in the digits that this resolves."""
    value, (low, high) = row["value"], row["ci95"]
    unit = unit_text(row["unit"])
    digits = digits_of(value, low, high)
    text = " ".join((plainly(value, digits or 4), *([unit] if unit else [])))
    if digits is None:
        return text
    return f"{text} (95 % interval {plainly(low, digits)} to {plainly(high, digits)})"


def _contains(one: Candidate, other: Candidate) -> bool:
    """Whether one of two mechanisms at a site has coefficients beside those of the other."""
    count = [sum(spec.coefficient for spec in c.parameters) for c in (one, other)]
    return one.site == other.site and count[0] != count[1]


def confusable_rows(parts: Ingredients, table: Sensitivities) -> list[list[Any]]:
    """Pairs of mechanisms whose effects in the sensors lie close, angle in degrees.

    A mechanism that is compared at more than one site is told with its own. What the free
    parameters reproduce leaves no direction to compare, and a mechanism that contains another has
    its direction whatever was recorded.
    """
    candidates = parts.arena.super_model.candidates
    left = np.radians(table.angle_to_parameters) > np.sqrt(RANK)
    seen = [i for i, identified in zip(table.candidates, left, strict=True) if identified]
    rows: dict[tuple[str, str], float] = {}
    for a, i in enumerate(seen):
        for j in seen[a + 1 :]:
            angle = table.angle(i, j)
            if _contains(candidates[i], candidates[j]) and angle < SAME:
                continue
            if candidates[i].label != candidates[j].label and angle < CONFUSED:
                key = (candidates[i].label, candidates[j].label)
                rows[key] = min(angle, rows.get(key, 90.0))
    ordered = sorted(rows.items(), key=lambda item: item[1])[:12]
    sites: dict[str, set[str]] = {}
    for label in {c.label for c in candidates}:
        mechanism, _, site = label.partition("@")
        sites.setdefault(mechanism, set()).add(site)

    def told(label: str) -> str:
        mechanism = label.partition("@")[0]
        return label if len(sites[mechanism]) > 1 else mechanism

    return [[told(a), told(b), round(angle, 2)] for (a, b), angle in ordered]
