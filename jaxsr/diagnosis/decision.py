"""What a diagnosis decides on, and the answer."""

from __future__ import annotations

from dataclasses import dataclass, field

from jaxsr._result import StoppedBy, Verdict
from jaxsr.diagnosis.judging.detection import SIGNIFICANCE, Detection
from jaxsr.diagnosis.judging.weights import Weights
from jaxsr.diagnosis.shooting.arena import Arena
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.verdict import Claim

UNTESTED = Detection(False, 0.0, 1.0, SIGNIFICANCE, SIGNIFICANCE)
"""Where nothing was compared with re-calibration."""
ABSTAINED = Claim(Verdict.UNDECIDED, frozenset(), 0.0)
"""What is claimed where nothing was weighed."""


@dataclass(frozen=True, eq=False)
class Decision:
    """Sets of mechanisms in free run, the chosen one, and what is claimed.

    Attributes
    ----------
    arena : Arena
    entries : list of Entry
        Re-calibration alone, and all that it is compared with.
    chosen : Entry
        One of them.
    headline : float
        How far the verdict looks ahead, in s.
    stopped : StoppedBy
        Why no more sets were weighed.
    detection : Detection
        Test of the chosen set against re-calibration.
    weights : Weights
        Probabilities of sets.
    claim : Claim
    borne_out : bool
        Whether free runs bear out what the evidence says, if anything.
    """

    arena: Arena
    entries: list[Entry]
    chosen: Entry
    headline: float
    stopped: StoppedBy
    detection: Detection = UNTESTED
    weights: Weights = field(default_factory=lambda: Weights({}))
    claim: Claim = ABSTAINED
    borne_out: bool = True

    @property
    def null(self) -> Entry:
        """Re-calibration alone."""
        return next(e for e in self.entries if not e.members)
