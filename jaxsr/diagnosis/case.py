"""A diagnosis on its way."""

from __future__ import annotations

from dataclasses import dataclass, field

from jaxsr._progress import Budget, Progress, Silent
from jaxsr.diagnosis.setup import Screened
from jaxsr.models import Simulator
from jaxsr.models.segments import Prepared


@dataclass(frozen=True, eq=False)
class Case:
    """One diagnosis on its way: the given simulator, its data and the course of the work."""

    simulator: Simulator
    prepared: tuple[Prepared, ...]
    screened: Screened | None
    budget: Budget
    progress: Progress = field(default_factory=Silent)
