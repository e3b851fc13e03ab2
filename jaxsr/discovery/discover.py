"""Equations of motion from recordings."""

from __future__ import annotations

import functools
import time as clock
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxsr._progress import Budget, Progress, Silent, as_budget
from jaxsr._result import InputError, StoppedBy
from jaxsr.discovery.equation import Equation, FittedTerm, find_equation, recognised
from jaxsr.discovery.result import Discovery, found_model
from jaxsr.discovery.samples import Roles, Samples, hold_back, roles, samples
from jaxsr.evolution import SearchConfig, SearchInfo
from jaxsr.expressions.term import Term
from jaxsr.models.model import Model
from jaxsr.models.reading import read_model
from jaxsr.recordings import Recording, read_recording

Source = Recording | str | Path


def discover(
    recordings: Sequence[Source],
    *,
    states: Sequence[str],
    derivatives: Sequence[str] | None = None,
    order: int = 1,
    inputs: Sequence[str] = (),
    time: str | None = None,
    units: str | Path | Mapping[str, str] | None = None,
    known: str | Path | Model | None = None,
    validation: Sequence[Source] = (),
    held_out: Sequence[Source] = (),
    modes: str | int = "auto",
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
    units : path or mapping, optional
        A file with a [units] table, written into the model.
    known : path or Model, optional
        A model whose right-hand sides are given; only the remainder is searched.
    validation : sequence of Recording or path
        Experiments to choose among candidate equations by; where absent, every fourth block of
        the recordings is held back for it.
    held_out : sequence of Recording or path
        Opened once, after every equation is final, to report the error.
    modes : "auto" or int
        1 or "auto": one law throughout.
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
        A column is missing, a name has two roles, or an option has no meaning.
    """
    if str(modes) not in ("auto", "1"):
        raise InputError(f"modes must be 'auto' or 1, got {modes}", "modes")
    if not recordings:
        raise InputError("no recordings given", "discover")
    began, limit = clock.monotonic(), as_budget(budget)
    read = functools.partial(_opened, time=time)
    part = roles(states, derivatives, order, inputs, time)
    given = _known_terms(known, part.time, (*part.states, *part.inputs))
    opened = [read(source) for source in recordings]
    data = samples(opened, part)
    train, judge, every = _divided(data, [read(source) for source in validation], part)
    equations, reasons = [], []
    show = progress or Silent()
    for place, state in enumerate(part.states):
        show.stage(f"equation of {state}")
        rate = part.rate_of.get(state)
        if rate is None and state not in given:
            rate = recognised(data, state, part.states)
        if rate is not None:
            equations.append(_kinematic(state, rate, train, judge))
            continue
        left = len(part.states) - place
        equation = find_equation(
            np.random.default_rng([seed, place]),
            state,
            train,
            judge,
            every,
            time=part.time,
            config=config or SearchConfig(),
            budget=limit.share(1.0 / left),
            known=given.get(state),
            progress=_reporter(show, config or SearchConfig()),
        )
        equations.append(equation)
        reasons.append(equation.stopped_by)
    model = found_model(equations, part, time, _units(units))
    if held_out:
        unseen = samples([read(source) for source in held_out], part)
        equations = [_with_held_out(equation, unseen) for equation in equations]
    stopped = next((r for r in reasons if r in (StoppedBy.INTERRUPTED, StoppedBy.BUDGET)), None)
    provenance: dict[str, Any] = {
        "seed": seed,
        "command": command,
        "seconds": clock.monotonic() - began,
        "stopped_by": stopped or StoppedBy.CONVERGED,
        "estimated_derivatives": sorted(data.estimated),
        "data_sha256": {r.name: r.sha256 for r in opened if r.sha256},
    }
    return Discovery(tuple(equations), model, provenance, data)


def _opened(source: Source, time: str | None) -> Recording:
    return source if isinstance(source, Recording) else read_recording(source, time=time)


def _divided(
    data: Samples, validation: list[Recording], part: Roles
) -> tuple[Samples, Samples, Samples]:
    """Return rows to regress on, to choose by, and for the final estimate."""
    if validation:
        return data, samples(validation, part), data
    held = hold_back(data.group)
    if not np.any(held):
        return data, data, data
    return data.take(np.flatnonzero(~held)), data.take(np.flatnonzero(held)), data


def _kinematic(state: str, rate: str, train: Samples, judge: Samples) -> Equation:
    def mse(part: Samples) -> float:
        return float(np.mean((part.targets[state] - part.variables[rate]) ** 2))

    exact = FittedTerm(Term.variable(rate), 1.0, (1.0, 1.0))
    return Equation(state, (exact,), mse(train), mse(judge))


def _with_held_out(equation: Equation, unseen: Samples) -> Equation:
    error = unseen.targets[equation.state] - equation.predict(unseen)
    return replace(equation, held_out_mse=float(np.mean(error**2)))


def _known_terms(
    known: str | Path | Model | None, time: str, names: Sequence[str]
) -> dict[str, Term]:
    """Return the given right-hand sides with their parameters' values in place."""
    if known is None:
        return {}
    model = known if isinstance(known, Model) else read_model(known)
    if model.inertia:
        raise InputError(
            "a known part with [inertia] cannot be used", model.name, "Solve it for the rates."
        )
    values = {n: Term.constant(p.value) for n, p in model.parameters.items()}
    values[model.time] = Term.variable(time)
    out = {s: term.substitute(values) for s, term in model.equation_terms.items()}
    for state, term in out.items():
        unknown = sorted(term.variables - {time, *names})
        if unknown:
            raise InputError(
                f"{unknown[0]} is neither a state nor an input here",
                f"{model.name} [equations] {state}",
                f"Known: {', '.join((time, *names))}.",
            )
    return {s: term for s, term in out.items() if s in names}


def _units(units: str | Path | Mapping[str, str] | None) -> dict[str, str]:
    if units is None or isinstance(units, Mapping):
        return dict(units or {})
    path = Path(units)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8")).get("units", {})
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"cannot be read: {error}", str(path)) from error
    return {str(k): str(v) for k, v in table.items()}


def _reporter(show: Progress, config: SearchConfig) -> Any:
    def report(info: SearchInfo) -> None:
        text = f"generation {info.generation}, relative error {info.best_loss**0.5:.2g}"
        show.update(min(info.generation / config.generations, 1.0), text)

    return report
