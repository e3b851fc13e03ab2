"""What a posterior says, as answers: sets of mechanisms with their verdicts and probabilities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from jaxsr._result import Verdict
from jaxsr.diagnosis.judging.equivalence import equivalent
from jaxsr.diagnosis.judging.weights import Weights
from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis
from jaxsr.diagnosis.likelihood.posterior import Posterior
from jaxsr.diagnosis.verdict import Explanation
from jaxsr.models import Model


def labels_of(found: Posterior, item: Hypothesis) -> frozenset[str]:
    """Return the labels of a hypothesis' members."""
    return frozenset(found.candidates[i].label for i in item.members)


def weights_of(told: Sequence[Explanation], renamed: Mapping[str, str] | None = None) -> Weights:
    """Sum the probabilities of variants of one set.

    Parameters
    ----------
    told : sequence of Explanation
    renamed : mapping of str to str, optional
        Labels of richer laws to those of the laws inside that are told in their place: that one of
        them acts is as probable as that either does.
    """
    return Weights.summed(((item.labels, item.probability) for item in told), renamed)


def deviations_of(found: Posterior) -> dict[tuple[str, str], float]:
    """Return posterior deviations of the leader's constants, by label and by their own names."""
    leader = found.leader
    return {
        (found.candidates[i].label, own): leader.constants[full][1]
        for i in leader.members
        for own, full in leader.names[i].items()
        if full in leader.constants
    }


def explanations(found: Posterior, model: Model, above_noise: bool = True) -> list[Explanation]:
    """Return what was weighed as answers.

    Re-calibration alone stands for a model that is right and for one with wrong values, one after
    the other (`Posterior.wrong`). A set with no more evidence has no mismatch of its own to
    explain: it may act below the noise, and answers as re-calibration does. Causes that no data can
    split count as the one that leads. What is left to a probability of one is that of a force that
    nobody names (`unnamed`).

    Parameters
    ----------
    above_noise : bool
        Whether free runs of re-calibration leave more than the sensors' noise. What does not show
        above it is no mismatch, however sure the evidence is of a small force.
    """
    null = next(h for h in found.hypotheses if not h.members)
    told = []
    for item, p in zip(found.hypotheses, found.probabilities, strict=True):
        if item.log_evidence <= null.log_evidence:
            told += _calibrated(found, labels_of(found, item), float(p), above_noise)
        else:
            verdict = _verdict_of(found, item, model)
            told.append(Explanation(labels_of(found, item), verdict, float(p)))
    return told


def unnamed(told: Sequence[Explanation]) -> float:
    """Return the probability that is left to something else."""
    return max(0.0, 1.0 - sum(e.probability for e in told))


def _calibrated(
    found: Posterior, labels: frozenset[str], p: float, above_noise: bool
) -> list[Explanation]:
    """Return a set with no verdict of its own without wrong values and with them.

    A force that nobody names is a mismatch, so that nothing is not the answer beside it; beside a
    wrong value it is what is left.
    """
    null = next(h for h in found.hypotheses if not h.members)
    forced = null.share and (found.leader.members or above_noise)
    calm = 1.0 - found.something_else if forced else 1.0
    told = [Explanation(labels, Verdict.NOTHING, calm * p)]
    for wrong in found.wrong:
        last = told.pop()
        told.append(replace(last, probability=(1.0 - wrong.probability) * last.probability))
        labels, p = labels | {f"wrong_value@parameter:{wrong.name}"}, p * wrong.probability
        told.append(Explanation(labels, Verdict.PARAMETER, p))
    return told


def _verdict_of(found: Posterior, item: Hypothesis, model: Model) -> Verdict:
    """Return the verdict of the member without which most evidence is lost.

    What is left without one is the evidence of the best set known that has others alone. Such sets
    are asked beside the leader, few beside others: where they have its largest, that is theirs.
    """

    def largest_of(members: Sequence[int]) -> int:
        def without(number: int) -> float:
            rest = set(members) - {number}
            return max(h.log_evidence for h in found.hypotheses if rest >= set(h.members))

        return min(members, key=without)

    leading = found.leader.members
    if leading and largest_of(leading) in item.members:
        return found.candidates[largest_of(leading)].verdict
    largest = found.candidates[largest_of(item.members)]
    for number in found.leader.members:
        if equivalent(model, found.candidates[number], largest):
            return found.candidates[number].verdict
    return largest.verdict
