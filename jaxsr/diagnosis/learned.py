"""A simulator that is a black box: its equations learnt from what it gave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxsr._progress import Budget, Progress, Silent, as_budget
from jaxsr._result import InputError
from jaxsr.diagnosis.shooting.scoring import free_run, horizons
from jaxsr.expressions import to_text
from jaxsr.models import Model, Parameter, Simulator
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording, read_recording, unwrap

if TYPE_CHECKING:
    from jaxsr.discovery.result import Discovery

SAME = 1e-3
"""Difference, in standard deviations, up to which a channel is the same in both files."""
REPRODUCED = 0.02
"""Free-run error of a learnt simulator at which no other order is tried."""
LOST = 0.3
"""Free-run error from which a simulator was not learnt."""
FREEDOM = 5.0
"""Factor by which re-calibration may change a learnt coefficient."""


@dataclass(frozen=True, eq=False)
class Learned:
    """A simulator that reproduces simulated recordings.

    Attributes
    ----------
    simulator : Simulator
        Its coefficients are free parameters.
    nrmse : float
        Free-run error on the simulated recordings, mean over horizons.
    inputs, states : tuple of str
        Channels taken for inputs and for states.
    """

    simulator: Simulator
    nrmse: float
    inputs: tuple[str, ...]
    states: tuple[str, ...]


def learn_simulator(
    simulated: Sequence[str | Path | Recording],
    data: Sequence[str | Path | Recording],
    *,
    states: Sequence[str] = (),
    seed: int = 0,
    budget: float | Budget | None = None,
    progress: Progress | None = None,
) -> Learned:
    """Learn the equations of a black-box simulator from its own output.

    Channels that are equal in a simulated file and in the recording it stands for are inputs,
    the others are states (or only `states`, if given). Equations of first order are sought, and
    of second order where those do not reproduce the files.

    Parameters
    ----------
    simulated : sequence of Recording or path
        One for each of `data`, in the same order.
    data : sequence of Recording or path
    states : sequence of str
        Channels that are states; all that differ by default.
    seed : int
    budget : float or Budget, optional

    Returns
    -------
    Learned

    Raises
    ------
    InputError
        The numbers of files differ, no channel differs, or no equations reproduce the files.
    """
    from jaxsr.discovery import (  # slow to load, and few simulators are black boxes
        Roles,
        Run,
        discover,
    )

    if len(simulated) != len(data):
        raise InputError(f"{len(simulated)} simulated files for {len(data)} of DATA", "--simulated")
    show, limit = progress or Silent(), as_budget(budget)
    given = [_opened(s) for s in simulated]
    inputs, others = _roles(given, [_opened(d) for d in data])
    missing = [s for s in states if s not in others]
    if missing:
        raise InputError(
            f"{missing[0]} is no channel that differs between simulation and recording",
            "--states",
            f"Such are {', '.join(others)}",
        )
    chosen = tuple(states) or others
    if not chosen:
        raise InputError(
            "no channel differs from the recordings", str(given[0].name), "Nothing is left out"
        )
    best: Learned | None = None
    for order in (1, 2):
        show.stage(f"learning the simulator from its output, equations of order {order}")
        found = discover(
            given,
            Roles(chosen, inputs=inputs, order=order),
            run=Run(seed=seed, budget=limit, progress=show),
        )
        simulator = Simulator(_with_free_coefficients(found))
        learned = Learned(simulator, _error(simulator, given), inputs, chosen)
        if best is None or learned.nrmse < best.nrmse:
            best = learned
        if best.nrmse < REPRODUCED:
            break
    assert best is not None
    if not best.nrmse < LOST:
        raise InputError(
            f"no equations were found that reproduce the simulated files (free-run error "
            f"{best.nrmse:.2g} of their deviation)",
            str(given[0].name),
            "Name the states with --states, or give the model itself",
        )
    return best


def _opened(item: str | Path | Recording) -> Recording:
    return unwrap(item if isinstance(item, Recording) else read_recording(item))


def _roles(
    simulated: Sequence[Recording], data: Sequence[Recording]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the channels that are equal in both, and those that are not."""
    same, other = [], []
    for name in simulated[0].channels:
        if any(name not in r.channels for r in (*simulated, *data)):
            continue
        apart = []
        for ours, theirs in zip(simulated, data, strict=True):
            there = np.interp(ours.time, theirs.time, theirs.channels[name])
            inside = ours.time <= theirs.time[-1]
            size = float(np.nanstd(there[inside])) + 1e-300
            difference = (ours.channels[name] - there)[inside]
            apart.append(float(np.sqrt(np.nanmean(difference**2))) / size)
        (same if max(apart) < SAME else other).append(name)
    return tuple(same), tuple(other)


def _with_free_coefficients(found: Discovery) -> Model:
    """Return the model found with a free parameter for every coefficient."""
    model = found.model
    equations, parameters = dict(model.equations), dict(model.parameters)
    taken = {*model.symbols, *model.definitions}
    for equation in found.equations:
        plain = model.equation_terms[equation.state]
        if plain.is_variable and plain.name in model.states:
            continue  # x' = v says what v is
        parts = []
        for k, item in enumerate(equation.terms, start=1):
            name = f"c{k}_{equation.state}"
            while name in taken:
                name += "_"
            taken.add(name)
            size = sorted((item.coefficient / FREEDOM, item.coefficient * FREEDOM))
            parameters[name] = Parameter(item.coefficient, bounds=(size[0], size[1]))
            parts.append(f"{name}*({to_text(item.term)})")
        if parts:
            equations[equation.state] = " + ".join(parts)
    name = "learnt from the simulator's output"
    return replace(model, name=name, equations=equations, parameters=parameters)


def _error(simulator: Simulator, given: Sequence[Recording]) -> float:
    """Mean free-run error over horizons on the simulated recordings."""
    prepared = [Prepared.build(simulator.model, r) for r in given]
    stepping, theta = Stepping("rk4", 4, simulator.default_widths), np.array(simulator.values())
    with np.errstate(all="ignore"):
        scores = [
            free_run(simulator, stepping, prepared, theta, h).nrmse for h in horizons(prepared)
        ]
    return float(np.mean(scores))
