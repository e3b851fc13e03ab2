"""What a report rests on: the course of a diagnosis and its decision."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.decision import Decision
from jaxsr.diagnosis.thinning import Whole


@dataclass(frozen=True, eq=False, kw_only=True)
class Ingredients(Decision):
    """The course of a diagnosis up to the decision, and that."""

    case: Case
    horizons: list[float]
    held_out: Sequence[Any]
    seed: int
    command: str | None
    whole: Whole | None = None  # all recordings, where the search worked on a part of them
