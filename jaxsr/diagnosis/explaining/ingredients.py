"""What a decision rests on: the course of a diagnosis up to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr._result import StoppedBy
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.contest.arena import Arena
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.judging.detection import Detection
from jaxsr.diagnosis.judging.weights import Weights
from jaxsr.diagnosis.thinning import Whole
from jaxsr.diagnosis.verdict import Claim


@dataclass(frozen=True, eq=False)
class Ingredients:
    """The course of a diagnosis up to the decision."""

    case: Case
    arena: Arena
    entries: list[Entry]
    null: Entry
    chosen: Entry
    detection: Detection
    headline: float
    horizons: list[float]
    held_out: Sequence[Any]
    rng: np.random.Generator
    seed: int
    command: str | None
    stopped: StoppedBy  # why no more sets were tried
    whole: Whole | None = None  # all recordings, where the search worked on a part of them
    weights: Weights | None = None  # probabilities of sets, where the evidence decided,
    claim: Claim | None = None  # and its verdict
