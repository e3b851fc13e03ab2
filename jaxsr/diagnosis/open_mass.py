r"""Open mass: what a search that was ended early leaves to what it did not compare.

Probabilities of hypotheses are stated over those that were compared. Each of the F families of
hypotheses has the same prior mass, shared out evenly over its :math:`n_f` members (a mechanism at
a place, or a stage that stands for many):

.. math:: p_h = \frac{1}{F\,n_{f(h)}}, \qquad \sum_h p_h = 1.

With C the compared ones and U the others,

.. math:: P(h \mid D) = (1 - P_U)\, P(h \mid D, C), \qquad P_U = \sum_{h \in U} p_h .

Assumed is that nothing tells the evidence of what was not compared from that of what was: an
uncompared hypothesis may do as well as the best one found. If evidences are exchangeable and one
of them outweighs the rest, it is in U with probability :math:`P_U`, whatever their distribution
(the largest of n + m draws is among m of them with probability m/(n + m)). Where the promising
ones are compared first, this leaves open too much rather than too little.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from jaxsr._result import StoppedBy, Verdict

NAMED = 3
"""Hypotheses that a sentence names."""
NOT_BORNE_OUT = 0.5
"""Mass that is open at least where free runs do not bear out the best answer: it is no likelier
than that none of the answers holds (even odds)."""


@dataclass(frozen=True)
class Proposal:
    """A hypothesis, and whether it was compared with the others.

    Attributes
    ----------
    name : str
        A mechanism at a place ("coulomb_friction@equation:v"), or a stage of the search in words.
    family : str
        Those of a family share its prior mass.
    verdict : Verdict
        The answer if it is the cause.
    compared : bool
    """

    name: str
    family: str
    verdict: Verdict
    compared: bool


@dataclass(frozen=True)
class OpenMass:
    """Posterior mass of what was not compared.

    Attributes
    ----------
    probability : float
        In [0, 1].
    by_verdict : dict of Verdict to float
        The same by the answer that it would be.
    left : tuple of str
        Names of what was not compared.
    proposed : int
        Number of all hypotheses.
    borne_out : bool
        Whether free runs bear out the best answer.
    """

    probability: float = 0.0
    by_verdict: tuple[tuple[Verdict, float], ...] = ()
    left: tuple[str, ...] = ()
    proposed: int = 0
    borne_out: bool = True

    @property
    def factor(self) -> float:
        """By which probabilities over what was compared are lowered."""
        kept = 1.0 - self.probability
        return kept if self.borne_out else min(kept, 1.0 - NOT_BORNE_OUT)

    def against(self, verdict: Verdict) -> float:
        """Return the mass that would change an answer."""
        return sum(mass for other, mass in self.by_verdict if other is not verdict)

    def in_words(self, stopped: StoppedBy) -> str:
        """Say what ended the search and what it did not try; nothing where that is nothing."""
        parts = []
        if self.left:
            who = {StoppedBy.BUDGET: "The time budget", StoppedBy.INTERRUPTED: "The user"}
            ended = f"{who[stopped]} ended the search" if stopped in who else "The search broke off"
            names = ", ".join(_in_words(name) for name in self.left[:NAMED])
            more = len(self.left) - NAMED
            names += f" and {more} more" if more > 0 else ""
            parts.append(
                f"{ended}: {len(self.left)} of {self.proposed} causes were not compared ({names}), "
                f"and {self.probability:.0%} of the probability is left to them."
            )
        if not self.borne_out:
            parts.append(
                "Free runs do not bear out what is most probable: something acts that none of what "
                "was compared explains."
            )
        return " ".join(parts)

    def as_json(self) -> dict[str, object]:
        """Return what ``diagnosis.json`` keeps."""
        return {"probability": 1.0 - self.factor, "not_tried": list(self.left)}


def open_mass(proposals: Iterable[Proposal], borne_out: bool = True) -> OpenMass:
    """Sum the prior mass of what was not compared.

    Parameters
    ----------
    proposals : iterable of Proposal
        Every hypothesis once.
    borne_out : bool
        Whether free runs bear out the best answer.

    Returns
    -------
    OpenMass
    """
    table = list(proposals)
    mass: dict[Verdict, float] = {}
    for proposal, prior in zip(table, priors(table), strict=True):
        if not proposal.compared:
            mass[proposal.verdict] = mass.get(proposal.verdict, 0.0) + prior
    left = tuple(p.name for p in table if not p.compared)
    total = min(sum(mass.values()), 1.0)
    return OpenMass(total, tuple(mass.items()), left, len(table), borne_out)


def _in_words(name: str) -> str:
    """Return ``coulomb_friction@equation:v`` as "coulomb friction at equation:v"."""
    mechanism, at, site = name.partition("@")
    return f"{mechanism.replace('_', ' ')} at {site}" if at else name


def priors(proposals: Sequence[Proposal]) -> list[float]:
    """Return the prior mass of each hypothesis: an equal share for a family and within it."""
    members = Counter(p.family for p in proposals)
    return [1.0 / (len(members) * members[p.family]) for p in proposals]
