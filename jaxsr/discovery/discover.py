"""Equations of motion from recordings."""

from __future__ import annotations

import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxsr._progress import Budget, Progress, Silent, as_budget
from jaxsr._result import InputError, StoppedBy
from jaxsr.discovery.equation import Equation, cut_short
from jaxsr.discovery.experiments import Experiments, Source, read_experiments, read_source
from jaxsr.discovery.find import Checkpoint, Task, find_equation
from jaxsr.discovery.found import found_model
from jaxsr.discovery.hybrid import Hybrid, ModeFinder, RareMode, cut_at, find_resets
from jaxsr.discovery.known import (
    Prior,
    admission,
    binding_units,
    guessed_terms,
    known_terms,
    obeys,
    signed_terms,
    unit_table,
)
from jaxsr.discovery.recognise import kinematic, recognised
from jaxsr.discovery.result import Discovery
from jaxsr.discovery.samples import Roles, Samples, roles, samples
from jaxsr.discovery.settle import settle
from jaxsr.discovery.treatment import Treatment
from jaxsr.evolution import SearchConfig, SearchInfo
from jaxsr.expressions.primitives import INTEGRALS
from jaxsr.models.model import Model

_SEARCH = 0.6  # share of the time for the search; the rest is for modes and roll-outs
_LOOK = 0.3  # share of the time for a first look at modes
_MODES = 0.6  # share of that rest for modes
_MOST_MODES = 9


def discover(
    recordings: Sequence[Source],
    *,
    states: Sequence[str],
    derivatives: Sequence[str] | None = None,
    order: int = 1,
    inputs: Sequence[str] = (),
    time: str | None = None,
    autonomous: bool = False,
    treatment: Treatment | None = None,
    units: str | Path | Mapping[str, str] | None = None,
    known: str | Path | Model | None = None,
    guesses: Mapping[str, Sequence[str]] | None = None,
    validation: Sequence[Source] = (),
    held_out: Sequence[Source] = (),
    signs: Mapping[str, Mapping[str, int]] | None = None,
    bind_units: bool | None = None,
    modes: str | int = "auto",
    checkpoint: str | Path | None = None,
    every: float = 60.0,
    seed: int = 0,
    budget: float | Budget | None = None,
    progress: Progress | None = None,
    config: SearchConfig | None = None,
    command: str = "jaxsr.discover",
) -> Discovery:
    """Find an equation of motion for every state.

    Parameters
    ----------
    recordings : sequence of Recording or path
        Experiments that obey one law.
    states : sequence of str
        Columns that are states.
    derivatives : sequence of str, optional
        Columns of their time derivatives (of their second ones with ``order=2``), in the same
        order; estimated from the states where absent.
    order : int
        2: the states are displacements q; their rates ``d_q`` are read from columns of that name
        or estimated, and are states too.
    inputs : sequence of str
        Columns of known inputs.
    time : str, optional
        Column of time, seconds.
    autonomous : bool
        True: time itself is not offered to the equations.
    treatment : Treatment, optional
        How states are smoothed and differentiated, and the view; chosen from the data by default.
    units : path or mapping, optional
        A file with a [units] table, or units by column; written into the model.
    known : path or Model, optional
        A model whose right-hand sides are given; only the remainder is searched.
    guesses : mapping of str to sequence of str, optional
        For a state, expressions to start from; each is split into its terms.
    validation : sequence of Recording or path
        Experiments to choose among candidate equations by; where absent, every fourth block of
        the recordings is held back for it.
    held_out : sequence of Recording or path
        Opened once, after every equation is final, to report the error.
    signs : mapping of str to mapping of str to int, optional
        For a state, terms whose coefficients must not be negative (1) or not be positive (-1):
        ``{"v": {"v": -1, "v*Abs(v)": -1}}`` for a friction that only brakes. They hold for what
        is searched, not for ``known``.
    bind_units : bool, optional
        Whether terms without a meaning in units are left out: the sine of a length, the sum of a
        length and a velocity. Constants may carry any unit, ``sin(2.0*x)`` has a meaning. By
        default they are where every state and input has a unit.
    modes : "auto" or int
        Number of modes, each with a law and a guard of its own; 1: one law throughout. "auto"
        finds it from the data: one law, unless it leaves more than noise and modes leave far less
        on samples held back.
    checkpoint : path, optional
        Folder for one file per state, written every so often and when a search ends. The same
        call again goes on from there and ends as if it had never stopped; files of other data or
        settings are refused.
    every : float
        Seconds between writes of a checkpoint.
    seed : int
    budget : float or Budget, optional
        Seconds.
    progress : Progress, optional
    config : SearchConfig, optional
    command : str
        What was typed, for the provenance.

    Returns
    -------
    Discovery

    Raises
    ------
    InputError
        A column is missing, a name has two roles, or an option has no meaning; a checkpoint is
        damaged or of another search.

    Notes
    -----
    With ``FitnessRule(data="validation")`` individuals are ranked by rows held back (paper
    section 4.2.2). With ``integral`` among the functions whole recordings are held back, every
    fourth, for an integral needs all samples before; the model gets a state for each integral,
    and roll-outs have no part in the choice.
    """
    count = number_of_modes(modes)
    if not recordings:
        raise InputError("no recordings given", "discover")
    began, limit, show = clock.monotonic(), as_budget(budget), progress or Silent()
    config = config or SearchConfig()
    part = roles(states, derivatives, order, inputs, time)
    part = replace(part, autonomous=autonomous, treatment=treatment or Treatment())
    integrals = bool(INTEGRALS.keys() & set(config.primitives.functions))
    names = (part.time, *part.states, *part.inputs)
    given, table = known_terms(known, part.time, names[1:]), unit_table(units)
    signed = signed_terms(signs, part.states, names)
    bound = binding_units(table, bind_units, part.time, (*states, *inputs))
    guessed = {state: guessed_terms(guesses, state, names) for state in part.states}
    admits = admission(bound, part) if bound or integrals else None
    kept = Checkpoint(Path(checkpoint), every) if checkpoint is not None else None
    tasks = _tasks(part, Prior(given, guessed, signed, admits), config, kept)
    opened = [read_source(source, time) for source in recordings]
    resets = find_resets(opened, part) if count != 1 and not integrals else []
    pieces = cut_at(opened, resets) if resets else opened
    experiments = read_experiments(pieces, validation, part, time=time, whole=integrals)
    finder = None
    if count != 1 and not integrals:
        rng = np.random.default_rng([seed, len(part.states)])
        finder = ModeFinder(rng, tasks, experiments, count)
    equations, hybrid, rare, ended = _laws(tasks, experiments, finder, seed, limit, show)
    if hybrid is None and not integrals:
        show.stage("roll-outs")
        equations = _settled(equations, tasks, experiments, limit)
    equations = [equation.trimmed() for equation in equations]
    model = found_model(equations, part, time, table)
    model = replace(model, events=tuple(reset.event for reset in resets))
    if held_out:
        unread = [read_source(source, time) for source in held_out]
        unseen = samples(cut_at(unread, resets) if resets else unread, part)
        equations = [_with_held_out(equation, unseen) for equation in equations]
    provenance: dict[str, Any] = {
        "seed": seed,
        "command": command,
        "seconds": clock.monotonic() - began,
        "stopped_by": cut_short([*(e.stopped_by for e in equations), ended]) or StoppedBy.CONVERGED,
        "estimated_derivatives": sorted(experiments.rows.estimated),
        "data_sha256": {r.name: r.sha256 for r in opened if r.sha256},
    }
    return Discovery(tuple(equations), model, provenance, experiments.rows, hybrid, rare)


def number_of_modes(modes: str | int) -> int | None:
    """Return the number of modes asked for; None: found from the data.

    Raises
    ------
    InputError
        It is neither "auto" nor a whole number above 0.
    """
    text = str(modes)
    if text == "auto":
        return None
    if not (text.isascii() and text.isdigit() and 0 < int(text) <= _MOST_MODES):
        raise InputError(
            f"modes must be 'auto' or a number from 1 to {_MOST_MODES}, got {modes}", "modes"
        )
    return int(text)


def _tasks(
    part: Roles, prior: Prior, config: SearchConfig, checkpoint: Checkpoint | None
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
        )
        for state in part.states
    }


def _laws(
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


def _settled(
    equations: Sequence[Equation],
    tasks: Mapping[str, Task],
    experiments: Experiments,
    limit: Budget,
) -> list[Equation]:
    """Return the equations as roll-outs choose and estimate them, where signs allow it."""
    given = experiments.roles.derivatives
    settled = settle(equations, tasks, experiments.rows.traces, limit, experiments.unseen, given)
    # roll-outs know no signs: what they turned round stays as it was
    return [
        after
        if obeys(after, tasks[after.state].signs)
        else replace(before, stopped_by=after.stopped_by)
        for before, after in zip(equations, settled, strict=True)
    ]


def _with_held_out(equation: Equation, unseen: Samples) -> Equation:
    error = unseen.targets[equation.state] - equation.predict(unseen)
    return replace(equation, held_out_mse=float(np.mean(error**2)))


def _reporter(show: Progress, config: SearchConfig) -> Any:
    def report(info: SearchInfo) -> None:
        text = f"generation {info.generation}, relative error {info.best_loss**0.5:.2g}"
        show.update(min(info.generation / config.generations, 1.0), text)

    return report
