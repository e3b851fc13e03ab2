"""What a search by evidence knows: sets of mechanisms, and what they are worth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis
from jaxsr.diagnosis.likelihood.table import Table
from jaxsr.diagnosis.likelihood.workspace import Workspace

Members = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class State:
    """Everything that the search knows.

    Attributes
    ----------
    work : Workspace
    table : Table
        About re-calibration: its beliefs all hypotheses share, so that evidences are compared under
        one prior.
    known : dict of tuple to Hypothesis or None
        Estimated sets; None where nothing finite came of one.
    grown : frozenset of tuple
        Sets about whose path all additions were looked at.
    rivalled : dict of tuple to float
        Sets beside which their rivals were estimated, and their log evidence then.
    due : tuple of tuple
        Sets that promised something and were not estimated when time was over.
    """

    work: Workspace
    table: Table
    known: dict[Members, Hypothesis | None]
    grown: frozenset[Members] = field(default_factory=frozenset)
    rivalled: Mapping[Members, float] = field(default_factory=dict)
    due: tuple[Members, ...] = ()

    @property
    def leader(self) -> Hypothesis:
        """The most probable set."""
        found = [h for h in self.known.values() if h is not None]
        return max(found, key=lambda h: self.log_posterior(h))

    def log_posterior(self, found: Hypothesis) -> float:
        """Log of evidence times prior odds: every mechanism is one of all that were offered."""
        if not believable(self.work, found):
            return -np.inf
        return found.log_evidence - self.price(found.members)

    def price(self, members: Members) -> float:
        """Log prior odds against a set: of each member, and of the place where it was looked for.

        A push or a frequency was picked among many before its constants were believed nearby.
        """
        tried = (self.work.super_model.candidates[i].tried for i in members)
        return float(len(members) * np.log(self.offered) + sum(map(np.log, tried)))

    def needed(self, known: dict[Members, Hypothesis | None], members: Members) -> float:
        """Log evidence that would make a set the most probable of those known."""
        most = max(self.log_posterior(h) for h in known.values() if h is not None)
        return most + self.price(members)

    @property
    def offered(self) -> int:
        """How many mechanisms at how many places there are; variants count as one."""
        return len({c.label for c in self.work.super_model.candidates})


def believable(work: Workspace, found: Hypothesis) -> bool:
    """Whether every member is what its name says: friction dissipates."""
    for number in found.members:
        candidate = work.super_model.candidates[number]
        of = {
            own: found.constants[full]
            for own, full in found.names[number].items()
            if full in found.constants
        }
        if candidate.physical is not None and not candidate.physical(
            {name: value for name, (value, _) in of.items()}
        ):
            return False
    return True
