"""Evidence for the report: trajectories, residuals and what else was considered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxsr._deadline import ask
from jaxsr.diagnosis.explaining.ladder import ladder
from jaxsr.diagnosis.explaining.rival_runs import RivalRuns, rival_runs
from jaxsr.diagnosis.explaining.whole_runs import Runs
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.shooting.arena import neutral_values
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.weak.weak_system import WeakSystem
from jaxsr.models import Model, difference
from jaxsr.models.segments import Prepared
from jaxsr.models.states import input_table, output_table, spread
from jaxsr.recordings import Recording, noise_level
from jaxsr.report.formatting import number

if TYPE_CHECKING:
    from jaxsr.diagnosis.explaining.ingredients import Ingredients
    from jaxsr.diagnosis.explaining.judge import Judged

FEWEST_FOR_NOISE = 20
"""Samples of a sensor from which neighbours tell its noise."""
MOST_DRAWN = 20_000
"""Samples of a course that a figure needs."""


@dataclass(frozen=True, eq=False)
class Forces:
    """The weak view of one role's recordings, before and after."""

    prepared: tuple[Prepared, ...]
    recalibrated: WeakSystem
    explained: WeakSystem

    @classmethod
    def of(cls, judged: Judged, prepared: Sequence[Prepared], half_width: float) -> Forces:
        """Build the weak view at both estimates, once where they are the same."""
        before, after = judged.recalibrated, judged.explained
        first = before.system(tuple(prepared), half_width)
        second = first if after is before else after.system(tuple(prepared), half_width)
        both = np.intersect1d(first.state, second.state)  # a mechanism may need a hidden state
        return cls(tuple(prepared), first.only(both), second.only(both))


def force_errors(model: Model, train: Forces | None, held: Forces | None) -> dict[str, Any] | None:
    """Relative force errors per equation in the weak view, before and after."""
    rows: dict[str, Any] = {}
    for role, forces in (("train", train), ("held_out", held)):
        if forces is None:
            continue
        for name, system in (
            ("recalibrated", forces.recalibrated),
            ("explained", forces.explained),
        ):
            # Where a memory stands between, an explained equation has no input of its own.
            brought = forces.recalibrated.input_side
            for site, error in relative_force_errors(model, system, brought).items():
                row = rows.setdefault(site, {"half_width_s": system.half_width, "held_out": None})
                row[role] = {**(row.get(role) or {}), name: error}
    return rows or None


def relative_force_errors(
    model: Model, system: WeakSystem, brought: np.ndarray
) -> dict[str, float | None]:
    """rms of what an equation leaves over rms of what inputs have `brought` to it, by site."""
    errors: dict[str, float | None] = {}
    for state in np.unique(system.state):
        rows = system.state == state
        power = float(np.mean(brought[rows] ** 2))
        left = float(np.mean(system.residual[rows] ** 2))
        name = f"equation:{model.states[state]}"
        errors[name] = float(np.sqrt(left / power)) if power > 0 else None
    return errors


def build_evidence(
    parts: Ingredients,
    judged: Judged,
    explained_model: Model,
    train: Runs,
    held_runs: Runs | None,
    forces: tuple[Forces | None, Forces | None],
    checks: int,
) -> Any:
    """Collect what the report draws; `forces` are those of training and of held-out recordings."""
    from jaxsr.report.evidence import Evidence

    given = parts.case.simulator.model
    at = parts.horizons.index(parts.headline)
    scores = {name: runs[at].nrmse for name, runs in train.models.items()}
    rivals = parts.case.failures.attempt("running rivals", lambda: rival_runs(parts), {})
    trajectories = _trajectories(parts, "train", train, rivals)
    roles = {"train": train.recordings}
    if held_runs is not None:
        roles["held_out"] = held_runs.recordings
        trajectories += _trajectories(parts, "held_out", held_runs)
    return Evidence(
        model_name=given.name,
        units=dict(given.units),
        diff=_diff(given, explained_model),
        trajectories=trajectories,
        residuals=[
            row
            for role, own in zip(("train", "held_out"), forces, strict=True)
            if own is not None
            for row in _residuals(given, role, own)
        ],
        considered=_considered(parts, judged.open.factor),
        ladder=ladder(parts, judged, checks, scores),
        lengths={
            role: tuple(float(r.time[-1] - r.time[0]) for r in found)
            for role, found in roles.items()
        },
        noise=parts.case.failures.attempt("telling noise", lambda: _floors(given, roles), {}),
    )


def _floors(model: Model, roles: Mapping[str, Sequence[Recording]]) -> dict[str, float]:
    """Return the `noise_floor` of the recordings of each role, where it is told."""
    floors = {role: noise_floor(model, found) for role, found in roles.items()}
    return {role: floor for role, floor in floors.items() if floor is not None}


def noise_floor(model: Model, recordings: Sequence[Recording]) -> float | None:
    r"""Return the free-run NRMSE that the noise of the sensors alone makes.

    As in the free run's own score, the mean over recordings of

    .. math:: \sqrt{\operatorname{mean}_k \sigma_k^2 / \operatorname{var} y_k}

    with the noise that the model states, else that of neighbouring samples; None where the
    latter is told by no recording.
    """
    scores = []
    for recording in recordings:
        ask()
        table = output_table(model, recording)
        deviation, shares = spread(table), []
        for k, output in enumerate(model.outputs):
            if np.count_nonzero(np.isfinite(table[:, k])) > FEWEST_FOR_NOISE:
                noise = model.noise.get(output)
                noise = noise_level(recording.time, table[:, k]) if noise is None else noise
                shares.append((noise / deviation[k]) ** 2)
        if shares:
            scores.append(np.sqrt(np.mean(shares)))
    return float(np.mean(scores)) if scores and np.mean(scores) > 0.0 else None


def _diff(before: Model, after: Model) -> list[Any]:
    from jaxsr.report.evidence import DiffRow

    rows = []
    changes = difference(before, after).as_json()
    for key, value in changes.items():
        table, _, name = key.partition(".")
        head, _, tail = name.partition(".")
        old: Any = getattr(before, table, {}) if table != "model" else getattr(before, name)
        if table != "model":
            old = old.get(head)
            if tail and old is not None:
                old = old.get(tail)
        if table == "parameters" and old is not None:
            old = {"value": old.value, "unit": old.unit, "bounds": list(old.bounds or [])}
        rows.append(DiffRow(key, old, value))
    return rows


def _trajectories(
    parts: Ingredients, role: Any, runs: Runs, rivals: RivalRuns | None = None
) -> list[Any]:
    from jaxsr.report.evidence import Trajectory

    model = parts.case.simulator.model
    at = parts.horizons.index(parts.headline)
    rows = []
    last = at == len(parts.horizons) - 1
    for r, recording in enumerate(runs.recordings):
        measured = output_table(model, recording)
        length = float(recording.time[-1] - recording.time[0])
        drawn = slice(None, None, -(-len(recording) // MOST_DRAWN))
        inputs = dict(zip(model.inputs, input_table(model, recording)[drawn].T, strict=True))
        for k, output in enumerate(model.outputs):
            series = {
                name: found[at].simulated[r][drawn, k].copy() for name, found in runs.models.items()
            }
            rows.append(
                Trajectory(
                    recording=recording.name,
                    role=role,
                    output=output,
                    unit=model.units.get(output),
                    horizon_s=parts.headline,
                    time=recording.time[drawn],
                    measured=measured[drawn, k],
                    **series,
                    whole=last or parts.headline >= length * (1.0 - 1e-9),
                    inputs=inputs,
                    rivals={m: run[r][drawn, k] for m, run in (rivals or {}).items()},
                )
            )
    return rows


def _residuals(model: Model, role: Any, forces: Forces) -> list[Any]:
    from jaxsr.report.evidence import ForceResidual

    before, after = forces.recalibrated, forces.explained
    units = {s.state: s.force_unit for s in sites_of(model, {})}
    rows = []
    for index in np.unique(before.state):
        name = model.states[index]
        for r, item in enumerate(forces.prepared):
            mine = (before.state == index) & (before.recording == r)
            centre = before.centre[mine]
            columns = zip(
                [*model.states, *model.inputs], [*item.states.values.T, *item.inputs.T], strict=True
            )
            variables = {n: np.interp(centre, item.time, values) for n, values in columns}
            rows.append(
                ForceResidual(
                    site=f"equation:{name}",
                    recording=item.recording.name,
                    unit=units.get(name),
                    time=centre,
                    recalibrated=before.residual[mine],
                    explained=after.residual[mine],
                    state_name=name,
                    state=np.interp(centre, item.time, item.states.values[:, index]),
                    state_unit=model.units.get(name),
                    variables=variables,
                    role=role,
                )
            )
    return rows


def _considered(parts: Ingredients, factor: float) -> list[Any]:
    """Return what was compared; of all probability it has `factor`, what was not has the rest."""
    from jaxsr.report.evidence import Considered

    candidates = parts.arena.super_model.candidates
    null = parts.null.fit.cost
    samples = max(float(parts.arena.problem.segments.weights.sum()), 1.0)
    rows, seen = [], set()
    for entry in sorted(parts.entries, key=lambda e: e.fit.cost):
        labels = tuple(sorted(candidates[i].label for i in entry.members))
        if labels in seen:
            continue
        seen.add(labels)
        told = _probability(parts, entry)
        rows.append(
            Considered(
                mechanisms=labels,
                error=float(np.sqrt(entry.fit.cost / samples)),
                relative=float(np.sqrt(entry.fit.cost / max(null, 1e-300))),
                chosen=entry is parts.chosen,
                reason=_reason(parts, entry),
                probability=None if told is None else factor * told,
            )
        )
    return rows


def _probability(parts: Ingredients, entry: Entry) -> float | None:
    """Return the probability of a set over what was compared; None where no evidence tells it."""
    candidates = parts.arena.super_model.candidates
    return parts.weights.of.get(frozenset(candidates[i].label for i in entry.members))


def _richer(parts: Ingredients, entry: Entry) -> bool:
    """Whether a set counts as one with a simpler law in the place of one of its own."""
    candidates = parts.arena.super_model.candidates
    labels = {candidates[i].label for i in entry.members}
    return not labels.isdisjoint(parts.weights.renamed)


def _by_evidence(told: float | None, taken: float | None) -> str:
    """Say how probable a set is beside the one that was taken."""
    if told is None:
        return "Its evidence was not told: other sets came nearer."
    if not taken or told > taken:
        return "Not sure enough to be claimed."
    if told == 0.0:
        return "Far less probable than what was taken."
    return f"{number(taken / told, 2)} times less probable than what was taken."


def _reason(parts: Ingredients, entry: Entry) -> str:
    if entry is parts.chosen:
        return "By the evidence of the recordings."
    if _richer(parts, entry):
        return "Explains less beyond the simpler law than nobody named: counted with that one."
    return _by_evidence(_probability(parts, entry), _probability(parts, parts.chosen))


__all__ = ["build_evidence", "force_errors", "neutral_values", "relative_force_errors"]
