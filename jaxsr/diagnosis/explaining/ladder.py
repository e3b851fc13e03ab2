"""How a verdict came about, step by step: data, calibration, detection, place, kind, decision."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxsr._deadline import OutOfTime
from jaxsr.diagnosis.mechanisms.motion import Motion
from jaxsr.diagnosis.setup import motion_of_case
from jaxsr.diagnosis.shooting.arena import Arena
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.uncertainty import NORMAL, half_widths
from jaxsr.models import Model
from jaxsr.report.formatting import digits_of, plainly
from jaxsr.report.words import capital, mechanism_at

if TYPE_CHECKING:
    from jaxsr.diagnosis.explaining.ingredients import Ingredients
    from jaxsr.diagnosis.explaining.judge import Judged

NAMED = 0.05
"""Share of the residual's power from which a dependence is named."""
LEFT = 0.15
"""Share of the time budget without which the halves are not estimated."""
AGREE = 3.0
"""Standard errors within which two halves agree."""


def ladder(
    parts: Ingredients, judged: Judged, checks: int, scores: dict[str, float]
) -> list[tuple[str, str]]:
    """Return the steps as (name, what was found).

    `scores` holds the free-run errors on DATA of the given, re-calibrated and explained model.
    """
    count, samples = len(parts.case.prepared), sum(p.time.size for p in parts.case.prepared)
    if parts.whole is not None:
        count, samples = len(parts.whole.recordings), parts.whole.samples
    files = "recording" if count == 1 else "recordings"
    remarks = f"{checks} remarks" if checks != 1 else "1 remark"
    steps = [
        ("Data", f"{count} {files}, {samples} samples; {remarks}."),
        (
            "Calibrate",
            f"Free-run error {_percent(scores['given'])} with the given values, "
            f"{_percent(scores['recalibrated'])} re-calibrated.",
        ),
        ("Detect", _detected(parts)),
    ]
    steps += [("Locate and characterise", text) for text in characters(parts)]
    steps.append(("Propose", _proposed(parts)))
    steps.append(("Decide", _decided(parts, judged, scores)))
    if parts.chosen.members:
        steps.append(("Halves", _halves(parts)))
    return steps


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"


def _detected(parts: Ingredients) -> str:
    found = parts.detection
    outcome = "found" if found.detected else "not found"
    factor = np.exp(0.5 * found.log_gain)
    tail = "below 1e-300" if found.p == 0.0 else f"= {found.p:.2g}"
    return (
        f"An effect was {outcome}: the best set lowers the error {factor:.3g} times, p {tail} "
        f"against {found.threshold:.2g}, one false alarm in {1.0 / found.rate:.0f} diagnoses."
    )


def characters(parts: Ingredients) -> list[str]:
    """Return, for every equation seen in the weak view, what the missing force depends on.

    The share of the residual force's power that functions of one variable remove, the free
    parameters projected out: odd and even ones of the velocity, and functions of the position.
    """
    case = parts.case
    if case.seen is None:
        return ["A state hides: no equation can be read off the sensors alone."]
    try:
        motion = motion_of_case(case.simulator, case.prepared, case.seen.half_width)
        if motion is None:
            return ["Narrow test functions hold too few samples to tell what the forces depend on."]
        return _characters(case.simulator.model, motion)
    except OutOfTime:
        return ["No time was left to tell what the missing forces depend on."]


def _characters(model: Model, motion: Motion) -> list[str]:
    texts = []
    power = {s: float(np.mean(r**2)) for s, r in motion.residual.items()}
    for state in sorted(power, key=lambda s: -power[s]):
        kinds = []
        for words, columns in _kinds(motion.signals, model.kinematic_parent(state), state):
            share = motion.share(state, columns)[0]
            if share > NAMED:
                resists = "odd" in words and motion.share(state, columns[:, :1])[1][0] < 0
                energy = " (it takes energy)" if resists else ""
                variable = model.kinematic_parent(state) if words == "a function" else state
                kinds.append(f"{words} of {variable} takes {100 * share:.0f} %{energy}")
        text = ", ".join(kinds) if kinds else "no function of its own variables takes any"
        texts.append(f"Equation of {state}: of the force that is left, {text}.")
    return texts


def _kinds(signals: Any, position: str | None, rate: str) -> list[tuple[str, np.ndarray]]:
    v = signals[rate] / (np.std(signals[rate]) + 1e-300)
    found = [
        ("an odd function", np.stack([v, np.tanh(10.0 * v), v**3], axis=1)),
        ("an even function", np.stack([np.abs(v), v**2], axis=1)),
    ]
    if position is not None:
        q = signals[position] - np.mean(signals[position])
        q = q / (np.std(q) + 1e-300)
        found.append(("a function", np.stack([q, q**2, q**3], axis=1)))
    return found


def _proposed(parts: Ingredients) -> str:
    super_model = parts.arena.super_model
    kinds = len({c.mechanism for c in super_model.candidates})
    places = len({c.label for c in super_model.candidates})
    count, runs = len(parts.weights.of), len(parts.entries)
    weighed = f"{count} sets weighed by their evidence, {runs} of them in free run"
    return f"{kinds} mechanisms at {places} places tried; {weighed}."


def _decided(parts: Ingredients, judged: Judged, scores: dict[str, float]) -> str:
    labels = [parts.arena.super_model.candidates[i].label for i in parts.chosen.members]
    if not labels:
        return "No set beats re-calibration."
    named = " and ".join(mechanism_at(label) for label in labels)
    return (
        f"{capital(named)}; free-run error {_percent(scores['explained'])}, all constants "
        f"estimated together. Verdict: {judged.verdict.value}."
    )


def halves(parts: Ingredients) -> list[tuple[str, float, float, float]]:
    """Estimate the chosen set on each half of the segments.

    Returns rows of parameter, value on the first and on the second half, and their distance in
    standard errors.
    """
    arena, chosen = parts.arena, parts.chosen
    segments = arena.problem.segments.number
    if segments < 4:
        return []
    found = []
    for part in (0, 1):
        half = _without(arena, np.arange(segments) * 2 // segments != part)
        entry: Entry = enter(half, chosen.members, chosen.fit.theta, chosen.fit.path, near=True)
        if not entry.fit.usable:
            return []
        found.append(entry.fit)
    error = half_widths(arena, chosen.fit) / NORMAL
    names, rows = list(arena.super_model.model.parameters), []
    for k, j in enumerate(chosen.fit.active):
        first, second = (float(f.theta[j]) for f in found)
        # Each half has twice the variance of the whole, their difference four times.
        rows.append((names[j], first, second, abs(first - second) / (2.0 * error[k] + 1e-300)))
    return rows


def _without(arena: Arena, out: np.ndarray) -> Arena:
    """An arena in which the segments `out` hold no readings."""
    segments = arena.problem.segments
    readings = np.where(out[None, None, :], np.nan, segments.outputs)
    problem = replace(arena.problem, segments=replace(segments, outputs=readings))
    wide = arena.wide
    if wide is not None:
        readings = np.where(out[None, None, :], np.nan, wide.segments.outputs)
        wide = replace(wide, segments=replace(wide.segments, outputs=readings))
    return replace(arena, problem=problem, wide=wide)


def _halves(parts: Ingredients) -> str:
    budget = parts.case.budget
    if budget.remaining < LEFT * budget.seconds:
        return "No time was left to estimate on each half of the segments."
    try:
        rows = halves(parts)
    except OutOfTime:
        return "No time was left to estimate on each half of the segments."
    if not rows:
        return "Too few segments to estimate on halves."
    worst = max(rows, key=lambda row: row[3])
    words = "agree" if worst[3] < AGREE else "do not agree"
    name = worst[0].partition("__")[0]
    digits = digits_of(worst[1], worst[1], worst[2]) or 4
    first, second = (plainly(value, digits) for value in worst[1:3])
    return (
        f"Estimated on each half of the segments the constants {words}: {name}, the farthest "
        f"apart, is {first} and {second}, {worst[3]:.2g} standard errors."
    )
