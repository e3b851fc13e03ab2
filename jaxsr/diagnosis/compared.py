"""What a search has compared: the record from which the open mass is told."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from jaxsr._result import Verdict
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.open_mass import Proposal

RECALIBRATION = "re-calibration"
SEVERAL = "several causes at once"
UNNAMED = "laws without a name"
_STAGES = (
    (RECALIBRATION, "parameter", Verdict.PARAMETER),
    (SEVERAL, "several", Verdict.STRUCTURE),
    (UNNAMED, "unnamed", Verdict.STRUCTURE),
)


class Usable(Protocol):
    """What tells whether an estimate can be used."""

    @property
    def usable(self) -> bool: ...


class Estimated(Protocol):
    """A set of candidates after estimation."""

    @property
    def members(self) -> tuple[int, ...]: ...
    @property
    def fit(self) -> Usable: ...


@dataclass
class Compared:
    """Record of what the data have been asked about.

    Attributes
    ----------
    told : set of str
        Labels of mechanisms whose gain over re-calibration is known, by a linearisation or by
        an estimate.
    stages : set of str
        Stages of the search that were reached, or that nothing asked for.
    """

    told: set[str] = field(default_factory=set)
    stages: set[str] = field(default_factory=set)

    def tell(self, labels: Iterable[str]) -> None:
        """Keep that mechanisms were compared with re-calibration."""
        self.told |= set(labels)

    def reach(self, *stages: str) -> None:
        """Keep that stages were reached, or that nothing asked for them."""
        self.stages |= set(stages)

    def proposals(
        self, candidates: Iterable[Candidate], entries: Sequence[Estimated]
    ) -> Iterator[Proposal]:
        """Yield every mechanism at every place among the candidates, and every stage.

        Parameters
        ----------
        candidates : iterable of Candidate
        entries : sequence of Estimated
            Of which those that can be used tell whether sets of several were compared.
        """
        seen = set[str]()
        for candidate in candidates:
            if candidate.label not in seen:
                seen.add(candidate.label)
                family, verdict = candidate.family, candidate.verdict
                yield Proposal(candidate.label, family, verdict, candidate.label in self.told)
        sets = any(e.fit.usable and len(e.members) > 1 for e in entries)
        reached = self.stages | ({SEVERAL} if sets else set())
        for name, family, verdict in _STAGES:
            yield Proposal(name, family, verdict, name in reached)
