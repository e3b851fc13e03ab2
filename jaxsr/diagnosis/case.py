"""A diagnosis on its way."""

from __future__ import annotations

from dataclasses import dataclass, field

from jaxsr._progress import Budget, Progress, Silent
from jaxsr.diagnosis.compared import Compared
from jaxsr.diagnosis.failures import Failures
from jaxsr.diagnosis.rectified import Rectified
from jaxsr.diagnosis.setup import Seen
from jaxsr.diagnosis.shooting.arena import Arena
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.models import Simulator
from jaxsr.models.segments import Prepared


@dataclass(frozen=True, eq=False)
class Case:
    """One diagnosis on its way: the given simulator, its data and the course of the work.

    Attributes
    ----------
    simulator : Simulator
    prepared : tuple of Prepared
    seen : Seen or None
    budget : Budget
        Of the whole diagnosis.
    search : Budget
        Until when sets are tried: what is left of `budget` is for the report.
    progress : Progress
    failures : Failures
        Steps of the search that broke and were given up.
    compared : Compared
        What the search has compared so far.
    quiet : tuple of str
        Inputs whose noise did not act and was smoothed out.
    rectified : tuple of Rectified
        Sensors that read no signs; in `prepared` they have them.
    so_far : list
        What is there if time ends now: an arena, re-calibration in it, and the headline's horizon
        in s, the latest last.
    """

    simulator: Simulator
    prepared: tuple[Prepared, ...]
    seen: Seen | None
    budget: Budget
    search: Budget
    progress: Progress = field(default_factory=Silent)
    failures: Failures = field(default_factory=lambda: Failures(Silent()))
    compared: Compared = field(default_factory=Compared)
    quiet: tuple[str, ...] = ()
    rectified: tuple[Rectified, ...] = ()
    so_far: list[tuple[Arena, Entry, float]] = field(default_factory=list)
