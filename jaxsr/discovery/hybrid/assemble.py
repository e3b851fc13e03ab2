"""From a tree of guards and submodels to modes, estimated on all rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.discovery.equation import Equation
from jaxsr.discovery.experiments import Experiments
from jaxsr.discovery.find import Task, final_estimate
from jaxsr.discovery.hybrid.guards import Region, region_term
from jaxsr.discovery.hybrid.intervals import joined_regions
from jaxsr.discovery.hybrid.piecewise import Mode, piecewise_equation
from jaxsr.discovery.hybrid.submodels import is_explained, relative_loss
from jaxsr.discovery.hybrid.switching import (
    Row,
    dwell_times,
    joined,
    labels,
    next_to_switch,
    sequence,
)
from jaxsr.discovery.hybrid.table import ClusterTable, cluster_table
from jaxsr.discovery.hybrid.tree import Node
from jaxsr.discovery.samples import Samples

_STENCIL = 4  # samples on either side that a difference of order 8 joins
_SAME = 1.1  # rise of the mean square up to which two regions have one law


@dataclass(frozen=True, eq=False)
class Hybrid:
    """Modes of a system.

    Attributes
    ----------
    modes : tuple of Mode
        The most frequent first.
    regions : tuple of tuple of Region
        Of each mode.
    equations : tuple of Equation
        Piecewise over the modes, one for each state.
    switching : dict of str to list of (float, float, int)
        By recording rows (from, to, mode), in seconds.
    switched : tuple of str
        States whose law differs between modes.
    table : ClusterTable
        Which submodel holds in which cluster.
    one_law : tuple of Equation
        The best single law of each switched state, with which the modes were compared.
    """

    modes: tuple[Mode, ...]
    regions: tuple[tuple[Region, ...], ...]
    equations: tuple[Equation, ...]
    switching: dict[str, list[Row]]
    switched: tuple[str, ...]
    table: ClusterTable
    one_law: tuple[Equation, ...] = ()

    def labels(self, variables: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the number of the mode of every sample (samples,)."""
        return labels(self.regions, variables)

    def dwell(self, number: int) -> tuple[float, float, float] | None:
        """Return the shortest, median and longest visit of a mode in seconds.

        Visits that a recording cuts are left out; None where all are.
        """
        times = np.concatenate([dwell_times(rows, number) for rows in self.switching.values()])
        if not len(times):
            return None
        return float(np.min(times)), float(np.median(times)), float(np.max(times))


def pointwise(samples: Samples) -> Samples:
    """Return the samples in the derivative view: a mode is a matter of single samples."""
    return replace(samples, weak={}) if samples.weak else samples


def assembled(
    root: Node,
    laws: Mapping[str, Equation],
    tasks: Mapping[str, Task],
    experiments: Experiments,
    states: Sequence[str],
    choices: Sequence[Sequence[str]],
) -> Hybrid | None:
    """Return the modes of a tree, estimated on all rows; None where one law serves all of it."""
    rows = pointwise(experiments.rows)
    groups = merged(list(root.leaves()), tasks, rows, states)
    if len(groups) < 2:
        return None
    sizes = [sum(leaf.rows for leaf in group) for group in groups]
    groups = [groups[k] for k in np.argsort(sizes)[::-1]]
    regions = tuple(joined_regions([leaf.region for leaf in group]) for group in groups)
    mode = labels(regions, rows.variables)
    near = next_to_switch(mode, rows.group, _STENCIL)
    modes = []
    for number, group in enumerate(groups):
        own = []
        for state in laws:
            held = mode == number
            if state not in states:
                own.append(laws[state])
                continue
            if state in rows.estimated and np.count_nonzero(held & ~near) > 30:
                held &= ~near
            part = rows.take(np.flatnonzero(held))
            own.append(_estimated(group[0].laws[state], tasks[state], part))
        modes.append(Mode(region_term(regions[number]), tuple(own)))
    equations = tuple(
        piecewise_equation(modes, state, _squares(modes, state, experiments))
        if state in states
        else laws[state]
        for state in laws
    )
    switching = _switching(experiments, rows, regions)
    train, judge = pointwise(experiments.train), pointwise(experiments.judge)
    known = labels(regions, train.variables), labels(regions, judge.variables)
    table = cluster_table(modes, known, states, choices, train, judge)
    single = tuple(laws[s] for s in states)
    return Hybrid(tuple(modes), regions, equations, switching, tuple(states), table, single)


def _switching(
    experiments: Experiments, rows: Samples, regions: Sequence[Sequence[Region]]
) -> dict[str, list[Row]]:
    """Return the mode sequence of every recording by its name, its pieces joined."""
    time = rows.variables[experiments.roles.time]
    out: dict[str, list[Row]] = {}
    names: dict[tuple[str, str | None], str] = {}
    for number in np.unique(rows.group).tolist():
        held = rows.group == number
        recording = experiments.recordings[number]
        part = {n: v[held] for n, v in rows.variables.items()}
        own = sequence(time[held], regions, part)
        before = names.get((recording.name, recording.sha256), "")
        if before and out[before][-1][1] < own[0][0]:
            out[before] = joined(out[before], own)
            continue
        name = recording.name or f"recording {number + 1}"
        if name in out:
            name = f"{name} ({number + 1})"
        names[recording.name, recording.sha256] = name
        out[name] = own
    return out


def _estimated(law: Equation, task: Task, rows: Samples) -> Equation:
    """Return a submodel with its coefficients on all rows of its mode."""
    known = 1 if task.known is not None else 0
    terms = [t.term for t in law.terms][known:] if known else [t.term for t in law.terms]
    final = final_estimate(task, terms, rows)
    keep = {"validation_mse": law.validation_mse, "front": law.front, "pick": law.pick}
    return replace(final, **keep)


def _squares(modes: Sequence[Mode], state: str, experiments: Experiments) -> tuple[float, float]:
    equation = piecewise_equation(modes, state, (0.0, 0.0))
    train, judge = (
        float(np.mean((part.targets[state] - equation.predict(part)) ** 2))
        for part in (experiments.train, experiments.judge)
    )
    return train, judge


def merged(
    leaves: Sequence[Node], tasks: Mapping[str, Task], rows: Samples, states: Sequence[str]
) -> list[list[Node]]:
    """Return the leaves in groups of one law: all submodels are tested on all regions."""
    regions = [[leaf.region] for leaf in leaves] + [[()]]
    mode = labels(regions[:-1] if len(leaves) > 1 else regions, rows.variables)
    groups: list[list[Node]] = []
    numbers: list[list[int]] = []
    for k, leaf in enumerate(leaves):
        for group, own in zip(groups, numbers, strict=True):
            if all(
                _one_law(group[0].laws[s], leaf.laws[s], tasks[s], rows, (mode, own, k))
                for s in states
            ):
                group.append(leaf)
                own.append(k)
                break
        else:
            groups.append([leaf])
            numbers.append([k])
    return groups


def _one_law(
    first: Equation, second: Equation, task: Task, rows: Samples,
    where: tuple[np.ndarray, list[int], int],
) -> bool:  # fmt: skip
    """Tell whether the terms of one of two laws serve both regions."""
    mode, own, k = where
    a = rows.take(np.flatnonzero(np.isin(mode, own)))
    b = rows.take(np.flatnonzero(mode == k))
    both = rows.take(np.flatnonzero(np.isin(mode, [*own, k])))
    apart = 0.0
    for law, part in ((first, a), (second, b)):
        apart += relative_loss(task.problem(part), law) * task.problem(part).total
    for law in (first, second):
        problem = task.problem(both)
        if any(k < 0 for k in problem.index([t.term for t in law.terms])):
            continue
        left = relative_loss(problem, law)
        if is_explained(problem, left) or left * problem.total <= _SAME * apart:
            return True
    return False
