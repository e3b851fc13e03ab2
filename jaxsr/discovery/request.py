"""What a discovery is asked: roles of the columns, what is known, how to run."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from jaxsr._progress import Budget, Progress
from jaxsr.discovery.experiments import Source
from jaxsr.discovery.treatment import Treatment
from jaxsr.models.model import Model


@dataclass(frozen=True)
class Roles:
    """Which column is what.

    Parameters
    ----------
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
    """

    states: Sequence[str] = ()
    derivatives: Sequence[str] | None = None
    order: int = 1
    inputs: Sequence[str] = ()
    time: str | None = None
    autonomous: bool = False
    columns: Mapping[str, str] | None = None
    treatment: Treatment | None = None


@dataclass(frozen=True)
class Prior:
    """What is known before the search.

    Parameters
    ----------
    units : path or mapping, optional
        A file with a [units] table, or units by column; written into the model.
    known : path or Model, optional
        A model whose right-hand sides are given; only the remainder is searched.
    guesses : mapping of str to sequence of str, optional
        For a state, expressions to start from; each is split into its terms.
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
    """

    units: str | Path | Mapping[str, str] | None = None
    known: str | Path | Model | None = None
    guesses: Mapping[str, Sequence[str]] | None = None
    signs: Mapping[str, Mapping[str, int]] | None = None
    bind_units: bool | None = None
    modes: str | int = "auto"


@dataclass(frozen=True)
class Run:
    """How a discovery runs, and on what it is judged.

    Parameters
    ----------
    validation : sequence of Recording or path
        Experiments to choose among candidate equations by; where absent, every fourth block of
        the recordings is held back for it.
    held_out : sequence of Recording or path
        Opened once, after every equation is final, to report the error.
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
    command : str
        What was typed, for the provenance.
    """

    validation: Sequence[Source] = ()
    held_out: Sequence[Source] = ()
    checkpoint: str | Path | None = None
    every: float = 60.0
    seed: int = 0
    budget: float | Budget | None = None
    progress: Progress | None = field(default=None, repr=False)
    command: str = "jaxsr.discover"


STABLE = ("states", "seed")
"""Fields that may stand by themselves in a call of ``discover`` for good."""


def asked(
    roles: Roles | None, prior: Prior | None, run: Run | None, old: Mapping[str, Any]
) -> tuple[Roles, Prior, Run]:
    """Return the three, with keywords that stand by themselves put where they belong.

    Those that are not `STABLE` are of earlier versions and warned of.

    Raises
    ------
    TypeError
        A keyword is unknown, or stands beside the group that holds it.
    """
    given: dict[str, Any] = {"roles": roles, "prior": prior, "run": run}
    home = {f.name: group for group, kind in _KINDS.items() for f in fields(kind)}
    for name in old:
        if name not in home:
            raise TypeError(f"discover() got an unexpected keyword argument {name!r}")
        if given[home[name]] is not None:
            kind = _KINDS[home[name]].__name__
            raise TypeError(f"discover() got {name!r} beside a {kind}; write it in {kind}(...)")
    own = {g: {n: v for n, v in old.items() if home[n] == g} for g in _KINDS}
    going = [name for name in old if name not in STABLE]
    if going:
        parts = [
            f"{'' if group == 'roles' else f'{group}='}{_KINDS[group].__name__}"
            f"({', '.join(f'{name}=...' for name in values)})"
            for group, values in own.items()
            if values
        ]
        warnings.warn(
            f"{', '.join(going)} of discover() will not stand alone in the next version; write "
            f"discover(recordings, {', '.join(parts)})",
            DeprecationWarning,
            stacklevel=3,
        )
    return roles or Roles(**own["roles"]), prior or Prior(**own["prior"]), run or Run(**own["run"])


_KINDS: dict[str, Any] = {"roles": Roles, "prior": Prior, "run": Run}
