"""The laws of all states: modes first or one law each, then roll-outs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jaxsr._progress import Budget, Progress
from jaxsr._result import StoppedBy
from jaxsr.discovery.equation import Equation
from jaxsr.discovery.experiments import Experiments
from jaxsr.discovery.find import Checkpoint, Task, find_equation
from jaxsr.discovery.hybrid import Hybrid, ModeFinder, RareMode
from jaxsr.discovery.known import PriorTerms, obeys
from jaxsr.discovery.recognise import kinematic, recognised
from jaxsr.discovery.samples import Roles
from jaxsr.discovery.settle import settle
from jaxsr.evolution import SearchConfig, SearchInfo

_SEARCH = 0.6  # share of the time for the search; the rest is for modes and roll-outs
_LOOK = 0.3  # share of the time for a first look at modes
_MODES = 0.6  # share of that rest for modes


def tasks_of(
    part: Roles,
    prior: PriorTerms,
    config: SearchConfig,
    checkpoint: Checkpoint | None,
    limit: Budget,
) -> dict[str, Task]:
    """Return what is to be found, by state."""
    return {
        state: Task(
            state,
            part.time,
            part.autonomous,
            prior.given.get(state),
            config,
            prior.guesses.get(state, ()),
            prior.signs.get(state, {}),
            prior.admits,
            checkpoint,
            limit,
        )
        for state in part.states
    }


def laws(
    tasks: Mapping[str, Task],
    experiments: Experiments,
    finder: ModeFinder | None,
    seed: int,
    limit: Budget,
    show: Progress,
) -> tuple[list[Equation], Hybrid | None, RareMode | None, StoppedBy]:
    """Return the equations, the modes where one law is not enough, or a mode too rare to tell.

    Last, why the search for modes ended.
    """
    if finder is None:
        return _searched(tasks, experiments, seed, limit, show), None, None, StoppedBy.CONVERGED
    show.stage("modes")
    looked = finder.look(limit.share(_LOOK))
    others = {s: task for s, task in tasks.items() if not looked.sure or s not in looked.laws}
    searched = {e.state: e for e in _searched(others, experiments, seed, limit, show)}
    equations = [searched.get(s) or looked.laws[s] for s in tasks]
    show.stage("modes")
    rest = limit.share(_MODES)
    found = finder.modes(looked, equations) if looked.sure else finder.find(looked, equations, rest)
    ended = StoppedBy.CONVERGED if looked.sure else rest.stopped_by
    if isinstance(found, Hybrid):
        return list(found.equations), found, None, ended
    return equations, None, found, ended


def _searched(
    tasks: Mapping[str, Task], experiments: Experiments, seed: int, limit: Budget, show: Progress
) -> list[Equation]:
    """Return the equations by regression, one state after the other."""
    equations = []
    for place, (state, task) in enumerate(tasks.items()):
        show.stage(f"equation of {state}")
        rng = np.random.default_rng([seed, place])
        share = limit.share(_SEARCH / (len(tasks) - place * _SEARCH))
        equations.append(_equation(rng, task, experiments, share, show))
    return equations


def _equation(
    rng: np.random.Generator, task: Task, experiments: Experiments, budget: Budget, show: Progress
) -> Equation:
    """Return one state's equation: its rate is another state, or it is searched."""
    part, train, judge = experiments.roles, experiments.train, experiments.judge
    rate = part.rate_of.get(task.state)
    if rate is None and task.known is None:
        rate = recognised(experiments.rows, task.state, part.states)
    if rate is not None:
        return kinematic(task.state, rate, train, judge)
    report = _reporter(show, task.config)
    return find_equation(rng, task, train, judge, experiments.rows, budget=budget, progress=report)


def settled(
    equations: Sequence[Equation],
    tasks: Mapping[str, Task],
    experiments: Experiments,
    limit: Budget,
) -> list[Equation]:
    """Return the equations as roll-outs choose and estimate them, where signs allow it."""
    given = experiments.roles.derivatives
    chosen = settle(equations, tasks, experiments.rows.traces, limit, experiments.unseen, given)
    # roll-outs know no signs: what they turned round stays as it was
    return [
        after
        if obeys(after, tasks[after.state].signs)
        else replace(before, stopped_by=after.stopped_by)
        for before, after in zip(equations, chosen, strict=True)
    ]


def _reporter(show: Progress, config: SearchConfig) -> Any:
    def report(info: SearchInfo) -> None:
        text = f"generation {info.generation}, relative error {info.best_loss**0.5:.2g}"
        show.update(min(info.generation / config.generations, 1.0), text)

    return report
