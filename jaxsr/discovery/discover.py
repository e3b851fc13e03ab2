"""Equations of motion from recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxsr._clock import now
from jaxsr._progress import Budget, Progress, Silent, as_budget
from jaxsr._result import InputError, StoppedBy
from jaxsr.discovery.affordable import affordable
from jaxsr.discovery.clock import on_clock, origin_of, since
from jaxsr.discovery.equation import Equation, cut_short
from jaxsr.discovery.errors import stated
from jaxsr.discovery.experiments import Source, opened, read_experiments, remarks
from jaxsr.discovery.find import Checkpoint
from jaxsr.discovery.found import found_model
from jaxsr.discovery.hybrid import ModeFinder, cut_at, find_resets
from jaxsr.discovery.judgement import LATER, court, time_to_judge
from jaxsr.discovery.known import (
    Prior,
    admission,
    binding_units,
    guessed_terms,
    known_terms,
    signed_terms,
    unit_table,
)
from jaxsr.discovery.laws import laws, settled, tasks_of
from jaxsr.discovery.naming import Naming
from jaxsr.discovery.result import Discovery
from jaxsr.discovery.samples import roles
from jaxsr.discovery.thinning import thin
from jaxsr.discovery.treatment import Treatment
from jaxsr.discovery.verdict import CANNOT_RUN, UNDECIDED, Verdict
from jaxsr.discovery.whole import estimated_on_whole, with_errors
from jaxsr.evolution import SearchConfig
from jaxsr.expressions.primitives import INTEGRALS
from jaxsr.models.model import Model

_MOST_MODES = 9
_ROLLED = 0.6  # share of what is left for roll-outs, where estimates on the whole follow


def discover(
    recordings: Sequence[Source],
    *,
    states: Sequence[str],
    derivatives: Sequence[str] | None = None,
    order: int = 1,
    inputs: Sequence[str] = (),
    time: str | None = None,
    autonomous: bool = False,
    columns: Mapping[str, str] | None = None,
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
        Columns that are states. A name that cannot stand in an expression, ``Angle/rad``, gets a
        symbol that can, ``Angle_rad``.
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
    columns : mapping of str to str, optional
        Name used here, and in the equations, to column: ``{"z1": "Angle/rad"}``.
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
    began, whole, show = now(), as_budget(budget), progress or Silent()
    limit = time_to_judge(whole, len(states))
    config = config or SearchConfig()
    naming = Naming.of([*states, *inputs], columns)
    states, inputs = naming.symbols(states), naming.symbols(inputs)
    derivatives = naming.symbols(derivatives) if derivatives else None
    part = roles(states, derivatives, order, inputs, time)
    naming = naming.with_rates(states) if order == 2 else naming
    time = time or naming.columns.get(part.time)
    part = replace(part, autonomous=autonomous, treatment=treatment or Treatment())
    integrals = bool(INTEGRALS.keys() & set(config.primitives.functions))
    names = (part.time, *part.states, *part.inputs)
    given = known_terms(known, part.time, names[1:])
    table = {naming.symbol(n): unit for n, unit in unit_table(units).items()}
    signed = signed_terms(signs, part.states, names)
    bound = binding_units(table, bind_units, part.time, (*states, *inputs))
    guessed = {state: guessed_terms(guesses, state, names) for state in part.states}
    admits = admission(bound, part) if bound or integrals else None
    kept = Checkpoint(Path(checkpoint), every) if checkpoint is not None else None
    prior = Prior(given, guessed, signed, admits)
    tasks = tasks_of(part, prior, config, kept, limit)
    sources = opened(recordings, part, naming, time)
    origin = 0.0 if integrals or prior.uses(part.time) else origin_of(sources)
    read = since(sources, origin)
    resets = find_resets(read, part) if count != 1 and not integrals else []
    pieces = cut_at(read, resets) if resets else read
    unjudged = opened(validation, part, naming, time)
    checks = tuple(remarks([*sources, *unjudged], part))
    unjudged = since(unjudged, origin)
    data, hurried = affordable(pieces, part, limit, joined=integrals)
    judged, _ = affordable(unjudged, part, limit, joined=integrals)
    experiments = read_experiments(data.searched, judged.searched, part, whole=integrals)
    finder = None
    if count != 1 and not integrals:
        rng = np.random.default_rng([seed, len(part.states)])
        finder = ModeFinder(rng, tasks, experiments, count)
    equations, hybrid, rare, ended = laws(tasks, experiments, finder, seed, limit, show)
    if hybrid is None and not integrals:
        show.stage("roll-outs")
        rest = limit.share(_ROLLED) if data.is_partial else limit
        equations = settled(equations, tasks, experiments, rest)
    used = data.rows
    if data.is_partial and hybrid is None:
        show.stage("estimates on the whole recordings")
        equations, used = estimated_on_whole(equations, tasks, data.whole, part, limit)
    equations = [equation.trimmed() for equation in equations]
    equations = stated(equations, tasks, experiments, partial=data.is_partial and hybrid is None)
    events = tuple(reset.event for reset in resets)

    def written(laws: Sequence[Equation]) -> Model:
        return replace(found_model(laws, part, naming, time, table), events=events)

    model = written(equations)
    show.stage("free runs over data held back")
    symbols = len(config.primitives.functions) + len(names) + 1  # a constant is one more
    rest = whole.keeping(-LATER * whole.seconds)
    judge = court(written, model, experiments, judged.searched, symbols, rest)
    verdict = Verdict(UNDECIDED, CANNOT_RUN)
    if judge is not None:
        verdict = judge.verdict(equations, compare=hybrid is None and not integrals)
    judged_by = rest.stopped_by
    if held_out:
        unread = since(opened(held_out, part, naming, time), origin)
        unread = cut_at(unread, resets) if resets else unread
        unseen = thin(unread, part, limit.seconds, joined=integrals)
        equations = with_errors(equations, unseen.whole, part, whole)
        if judge is not None:
            equations = judge.held_out(equations, unseen.searched)
    reasons = [*(e.stopped_by for e in equations), ended, judged_by]
    reason = cut_short([*reasons, StoppedBy.BUDGET] if hurried else reasons)
    provenance: dict[str, Any] = {
        "seed": seed,
        "command": command,
        "seconds": now() - began,
        "stopped_by": reason or StoppedBy.CONVERGED,
        "estimated_derivatives": sorted(experiments.rows.estimated),
        "data_sha256": {r.name: r.sha256 for r in read if r.sha256},
    }
    if str(data):
        provenance["thinned"] = f"{data}; estimated on {used} rows"
    named = {s: c for s, c in naming.columns.items() if s in names}
    rows = experiments.rows
    told = (tuple(equations), rows, hybrid, rare, verdict)
    equations, rows, hybrid, rare, verdict = on_clock(told, part.time, origin)
    return Discovery(
        equations, written(equations), provenance, rows, hybrid, rare, named, verdict, checks
    )


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
