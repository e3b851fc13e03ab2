"""Equations of motion from recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxsr._clock import now
from jaxsr._deadline import OutOfTime, limited
from jaxsr._progress import Silent, as_budget
from jaxsr._result import InputError, StoppedBy
from jaxsr.discovery.affordable import affordable, evenly
from jaxsr.discovery.clock import on_clock, origin_of, since
from jaxsr.discovery.equation import Equation, cut_short
from jaxsr.discovery.errors import stated
from jaxsr.discovery.experiments import (
    Source,
    checksums,
    opened,
    read_experiments,
    remarks,
)
from jaxsr.discovery.find import Checkpoint
from jaxsr.discovery.found import found_model
from jaxsr.discovery.hybrid import ModeFinder, cut_at, find_resets
from jaxsr.discovery.judgement import LATER, court, time_to_judge
from jaxsr.discovery.known import (
    PriorTerms,
    admission,
    binding_units,
    guessed_terms,
    known_checksum,
    known_terms,
    signed_terms,
    unit_table,
)
from jaxsr.discovery.laws import laws, settled, tasks_of
from jaxsr.discovery.naming import Naming
from jaxsr.discovery.request import Prior, Roles, Run, asked
from jaxsr.discovery.result import Discovery
from jaxsr.discovery.samples import roles as assigned
from jaxsr.discovery.thinning import thin
from jaxsr.discovery.treatment import Treatment
from jaxsr.discovery.verdict import CANNOT_RUN, OUT_OF_TIME, UNDECIDED, Verdict
from jaxsr.discovery.whole import estimated_on_whole, with_errors
from jaxsr.evolution import SearchConfig
from jaxsr.expressions.primitives import INTEGRALS
from jaxsr.models.model import Model

_MOST_MODES = 9
_CHECKED = 0.1  # share of what is left for looking at what the recordings may suffer from
_ROLLED = 0.6  # share of what is left for roll-outs, where estimates on the whole follow


def discover(
    recordings: Sequence[Source],
    roles: Roles | None = None,
    *,
    prior: Prior | None = None,
    config: SearchConfig | None = None,
    run: Run | None = None,
    **keywords: Any,
) -> Discovery:
    """Find an equation of motion for every state.

    Parameters
    ----------
    recordings : sequence of Recording or path
        Experiments that obey one law.
    roles : Roles
        States, derivatives, inputs, time.
    prior : Prior, optional
        Units, known parts, guesses, signs, modes.
    config : SearchConfig, optional
        Settings of the search.
    run : Run, optional
        Recordings to choose and to report by, seed, budget, checkpoint.
    **keywords
        ``states`` and ``seed``, which may stand by themselves. Other fields of ``roles``, ``prior``
        and ``run`` may as well, as in earlier versions; that goes away in the next one.

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
    roles, prior, run = asked(roles, prior, run, keywords)
    count = number_of_modes(prior.modes)
    if not recordings:
        raise InputError("no recordings given", "discover")
    began, whole, show = now(), as_budget(run.budget), run.progress or Silent()
    limit = time_to_judge(whole, len(roles.states))
    config = config or SearchConfig()
    naming = Naming.of([*roles.states, *roles.inputs], roles.columns)
    states, inputs = naming.symbols(roles.states), naming.symbols(roles.inputs)
    derivatives = naming.symbols(roles.derivatives) if roles.derivatives else None
    part = assigned(states, derivatives, roles.order, inputs, roles.time)
    naming = naming.with_rates(states) if roles.order == 2 else naming
    time = roles.time or naming.columns.get(part.time)
    part = replace(part, autonomous=roles.autonomous, treatment=roles.treatment or Treatment())
    integrals = bool(INTEGRALS.keys() & set(config.primitives.functions))
    names = (part.time, *part.states, *part.inputs)
    given = known_terms(prior.known, part.time, names[1:])
    known_file = known_checksum(prior.known)
    table = {naming.symbol(n): unit for n, unit in unit_table(prior.units).items()}
    signed = signed_terms(prior.signs, part.states, names)
    bound = binding_units(table, prior.bind_units, part.time, (*states, *inputs))
    guessed = guessed_terms(prior.guesses, part.states, names)
    admits = admission(bound, part) if bound or integrals else None
    kept = Checkpoint(Path(run.checkpoint), run.every) if run.checkpoint is not None else None
    stated_terms = PriorTerms(given, guessed, signed, admits)
    tasks = tasks_of(part, stated_terms, config, kept, limit)
    sources = opened(recordings, part, naming, time)
    origin = 0.0 if integrals or stated_terms.uses(part.time) else origin_of(sources)
    read = since(sources, origin)
    resets = find_resets(read, part) if count != 1 and not integrals else []
    pieces = cut_at(read, resets) if resets else read
    unjudged = opened(run.validation, part, naming, time)
    checking = limit.share(_CHECKED)
    checks = tuple(remarks([*sources, *unjudged], part, lambda: checking.exhausted))
    unjudged = since(unjudged, origin)
    data, hurried = affordable(pieces, part, limit, joined=integrals)
    judged, _ = affordable(unjudged, part, limit, joined=integrals)
    few = evenly(data, part, limit)
    if few is not None:
        data, part, hurried = few, replace(part, hurried=True), True
    experiments = read_experiments(data.searched, judged.searched, part, whole=integrals)
    finder = None
    if count != 1 and not integrals:
        rng = np.random.default_rng([run.seed, len(part.states)])
        finder = ModeFinder(rng, tasks, experiments, count)
    equations, hybrid, rare, ended = laws(tasks, experiments, finder, run.seed, limit, show)
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
    judge, verdict = None, Verdict(UNDECIDED, CANNOT_RUN)
    try:
        with limited(lambda: rest.remaining == 0.0):
            judge = court(written, model, experiments, judged.searched, symbols, rest)
            if judge is not None:
                verdict = judge.verdict(equations, compare=hybrid is None and not integrals)
    except OutOfTime:
        verdict = Verdict(UNDECIDED, OUT_OF_TIME)
    judged_by, unseen_files, runs = rest.stopped_by, {}, ()
    if run.held_out:
        unread = opened(run.held_out, part, naming, time)
        unseen_files = {"held_out_sha256": checksums(unread)}
        unread = since(unread, origin)
        unread = cut_at(unread, resets) if resets else unread
        unseen = thin(unread, part, limit.seconds, joined=integrals)
        equations = with_errors(equations, unseen.whole, part, whole)
        if judge is not None:
            equations, runs = judge.held_out(equations, unseen.searched, origin)
    reasons = [*(e.stopped_by for e in equations), ended, judged_by]
    reason = cut_short([*reasons, StoppedBy.BUDGET] if hurried else reasons)
    provenance: dict[str, Any] = {
        "seed": run.seed,
        "command": run.command,
        "seconds": now() - began,
        "stopped_by": reason or StoppedBy.CONVERGED,
        "estimated_derivatives": sorted(experiments.rows.estimated),
        "data_sha256": checksums(read),
        **({"validation_sha256": checksums(unjudged)} if unjudged else {}),
        **unseen_files,
        **({"known_sha256": known_file} if known_file else {}),
    }
    if str(data):
        provenance["thinned"] = f"{data}; estimated on {used} rows"
    named = {s: c for s, c in naming.columns.items() if s in names}
    rows = experiments.rows
    told = (tuple(equations), rows, hybrid, rare, verdict)
    equations, rows, hybrid, rare, verdict = on_clock(told, part.time, origin)
    return Discovery(
        equations, written(equations), provenance, rows, hybrid, rare, named, verdict, checks, runs
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
