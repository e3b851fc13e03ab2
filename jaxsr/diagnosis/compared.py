"""What a search has compared: the record from which the open mass is told."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from jaxsr._result import Verdict
from jaxsr.diagnosis.open_mass import Proposal

if TYPE_CHECKING:
    from jaxsr.diagnosis.mechanisms.super_model import SuperModel
    from jaxsr.diagnosis.setup import Screened

RECALIBRATION = "re-calibration"
LOCATED = "forces that free runs locate"
SEVERAL = "several causes at once"
UNNAMED = "laws without a name"
_STAGES = (
    (RECALIBRATION, "parameter", Verdict.PARAMETER),
    (LOCATED, "external", Verdict.EXTERNAL_INPUT),
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
    cut : set of str
        Labels that promised a gain and whose estimate time cut short or did not allow.
    stages : set of str
        Stages of the search that were reached, or that nothing asked for.
    """

    told: set[str] = field(default_factory=set)
    cut: set[str] = field(default_factory=set)
    stages: set[str] = field(default_factory=set)

    def tell(self, super_model: SuperModel, numbers: Iterable[int]) -> None:
        """Keep that candidates were compared with re-calibration."""
        self.told |= {super_model.candidates[i].label for i in numbers}

    def screen(self, screened: Screened | None, super_model: SuperModel) -> None:
        """Keep what the weak view told: what leaves no trace there stands in no super-model."""
        if screened is not None:
            left = {c.label for c in super_model.candidates} | screened.unscreened
            self.told |= {c.label for c in screened.super_model.candidates} - left

    def leave(self, super_model: SuperModel, numbers: Iterable[int]) -> None:
        """Keep that candidates which promise a gain were not estimated to the end."""
        self.cut |= {super_model.candidates[i].label for i in numbers}

    def reach(self, *stages: str) -> None:
        """Keep that stages were reached, or that nothing asked for them."""
        self.stages |= set(stages)

    def become(self, other: Compared) -> None:
        """Take over what another search, whose answer stands, has compared."""
        self.told, self.cut, self.stages = set(other.told), set(other.cut), set(other.stages)

    def proposals(
        self,
        super_models: Sequence[SuperModel],
        entries: Sequence[Estimated],
        chosen: Estimated,
    ) -> Iterator[Proposal]:
        """Yield every mechanism at every place of the super-models, and every stage.

        `entries` are those of the last super-model; what was estimated was compared, unless time
        cut it short.
        """
        candidates = super_models[-1].candidates
        known = {candidates[i].label for e in entries if e.fit.usable for i in e.members}
        known = (known | self.told) - self.cut
        known |= {candidates[i].label for i in chosen.members}
        seen = set[str]()
        for candidate in (c for s in super_models for c in s.candidates):
            if candidate.label not in seen:
                seen.add(candidate.label)
                family, verdict = candidate.family, candidate.verdict
                yield Proposal(candidate.label, family, verdict, candidate.label in known)
        sets = any(e.fit.usable and len(e.members) > 1 for e in (*entries, chosen))
        reached = self.stages | ({SEVERAL} if sets else set())
        for name, family, verdict in _STAGES:
            yield Proposal(name, family, verdict, name in reached)
