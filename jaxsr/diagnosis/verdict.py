r"""The verdict: a function of the posterior and of two costs.

Whether there is a mismatch is answered either way: *nothing* says that there is none, and is as
wrong where there is one as the reverse, so that the more probable answer is given. Its cause need
not be named: *undecided* abstains. What is lost, against the better choice, is `false_claim` by a
cause that is wrong and `abstaining` by none where it would have been right, so that the expected
loss of naming a cause of posterior mass :math:`m` is least (Berger 1985, *Statistical Decision
Theory*, section 2.4; Chow 1970, IEEE Trans. Inf. Theory 16) by doing it where

.. math:: C_{\text{abstaining}}\, m > C_{\text{false}}\, (1 - m),

that is where its odds are above those of the costs. Which mechanism it is may be in doubt all the
same: that is what its own probability says.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from jaxsr._result import InputError, Verdict

FALSE_CLAIM = 20.0
"""Cost of a false cause against that of abstaining: one is claimed at odds of twenty to one, near
the one in twenty that an interval of 95 % leaves."""
EVEN = 0.5
"""Probability of no mismatch above which there is said to be none: either answer is as wrong."""


@dataclass(frozen=True)
class Costs:
    """What a wrong choice loses against the better one.

    Attributes
    ----------
    false_claim : float
        By a claim that is wrong.
    abstaining : float
        By no claim where it would have been right.

    Raises
    ------
    InputError
        A cost is negative or not finite, or both are zero.
    """

    false_claim: float = FALSE_CLAIM
    abstaining: float = 1.0

    def __post_init__(self) -> None:
        known = all(0.0 <= cost < float("inf") for cost in (self.false_claim, self.abstaining))
        if not (known and self.false_claim + self.abstaining > 0.0):
            raise InputError(
                "costs of a false claim and of abstaining must be finite and not negative: "
                f"{self.false_claim:g} against {self.abstaining:g}",
                "false_claim_cost",
                "Name a number above zero, such as 20",
            )

    def allow(self, mass: float) -> bool:
        """Whether a claim of a probability is made."""
        return self.abstaining * mass > self.false_claim * (1.0 - mass)


@dataclass(frozen=True)
class Explanation:
    """A set of mechanisms as an answer.

    Attributes
    ----------
    labels : frozenset of str
        Mechanisms at their sites; none where nothing is missing.
    verdict : Verdict
        That of its largest share.
    probability : float
        Of the set, against all others.
    """

    labels: frozenset[str]
    verdict: Verdict
    probability: float


@dataclass(frozen=True)
class Claim:
    """What is answered.

    Attributes
    ----------
    verdict : Verdict
    leading : frozenset of str
        What is named of the most probable set of that verdict; the most probable set of all with a
        mismatch, where that is undecided.
    mass : float
        Probability of the verdict, and of the one that comes nearest where that is undecided.
    """

    verdict: Verdict
    leading: frozenset[str]
    mass: float


def claimed(
    explanations: Sequence[Explanation], something_else: float = 0.0, costs: Costs | None = None
) -> Claim:
    """Return the verdict of least expected loss, and its leading set.

    Parameters
    ----------
    explanations : sequence of Explanation
        All sets that were weighed; their probabilities are taken relative to their sum.
    something_else : float
        Probability that what none of them names has the largest share.
    costs : Costs, optional
        20 to 1 by default.

    Returns
    -------
    Claim
    """
    costs, mass = costs or Costs(), masses(explanations, something_else)
    none = mass.pop(Verdict.NOTHING, 0.0)
    if none > EVEN:
        return Claim(Verdict.NOTHING, _most_probable(explanations, {Verdict.NOTHING}), none)
    if not mass:
        return Claim(Verdict.UNDECIDED, frozenset(), 0.0)
    best = max(mass, key=lambda v: mass[v])
    if costs.allow(mass[best]):
        leading = _named(explanations, _most_probable(explanations, {best}), costs)
        return Claim(best, leading, mass[best])
    return Claim(Verdict.UNDECIDED, _most_probable(explanations, mass), mass[best])


def _most_probable(
    explanations: Sequence[Explanation], verdicts: Collection[Verdict]
) -> frozenset[str]:
    """Return the labels of the most probable set of some verdicts."""
    own = (e for e in explanations if e.verdict in verdicts)
    found = max(own, key=lambda e: e.probability, default=None)
    return frozenset() if found is None else found.labels


def _named(
    explanations: Sequence[Explanation], leading: frozenset[str], costs: Costs
) -> frozenset[str]:
    """Return what is named of a set: no member in whose place there may as well be nothing.

    Beside others one is claimed where the probability that it, or another in its place, acts allows
    a claim, the most doubtful asked first.
    """
    total = sum(e.probability for e in explanations)
    while len(leading) > 1:
        rest = {m: leading - {m} for m in sorted(leading)}
        idle = {
            m: sum(e.probability for e in explanations if e.labels <= others) / total
            for m, others in rest.items()
        }
        doubtful = max(idle, key=lambda m: idle[m])
        if costs.allow(1.0 - idle[doubtful]):
            break
        leading = rest[doubtful]
    return leading


def masses(
    explanations: Sequence[Explanation], something_else: float = 0.0
) -> dict[Verdict, float]:
    """Return the probability of every verdict; what is left to one is that of something else."""
    total = sum(e.probability for e in explanations)
    found: dict[Verdict, float] = {}
    for e in explanations:
        share = (1.0 - something_else) * e.probability / max(total, 1e-300)
        found[e.verdict] = found.get(e.verdict, 0.0) + share
    return found
