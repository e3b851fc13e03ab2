"""Criteria: which of several sets the recordings speak for, with the price of their constants."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.special

from jaxsr.diagnosis.contest.blocks import MIN_GAIN, gain
from jaxsr.diagnosis.contest.converters import independent_samples
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.mechanisms.super_model import SuperModel

PRIOR_SPREAD = 0.1
"""Standard deviation of log(value / given) for fixed constants and sensor scales."""
CLOCK_SPREAD = 0.01
"""The same of a clock's rate error."""
IMPLAUSIBLE = 9.0
"""Squared number of prior standard deviations beyond which an entry is only a last resort."""
FURTHER = 0.01
"""Smallest gain in log mean square that a further mechanism must bring, however significant."""
TIED = 0.5
"""Difference of Schwarz's criterion below which nothing speaks for one of two sets."""
RICHER = 0.005
"""The same as `MIN_GAIN` for every further constant of a law that jumps."""


def log_prior(super_model: SuperModel, entry: Entry) -> float:
    """Log prior of an entry, up to a constant.

    Constants that a modeller fixed and scales of sensors are rarely wrong by more than a few
    tens of percent: log(value / given) is taken as normal with a standard deviation of
    `PRIOR_SPREAD`; the rate of a clock with one of `CLOCK_SPREAD`.
    """
    total = 0.0
    for number in entry.members:
        candidate = super_model.candidates[number]
        if candidate.mechanism == "clock_skew":
            skew = super_model.own_values(number, entry.fit.theta)["s"]
            total -= 0.5 * (skew / CLOCK_SPREAD) ** 2
        if candidate.mechanism not in ("wrong_value", "sensor_gain", "input_gain"):
            continue
        spec = candidate.parameters[0]
        value = super_model.own_values(number, entry.fit.theta)[spec.name]
        ratio = value / spec.neutral if spec.neutral else 1.0
        total -= 0.5 * (np.log(ratio) / PRIOR_SPREAD) ** 2 if ratio > 0 else 1e3
    return total


def penalties(super_model: SuperModel, entries: Sequence[Entry]) -> np.ndarray:
    """What each entry's log error is raised by: Schwarz's price of its constants, and its prior.

    With n independent residuals the log likelihood is -(n/2) log(error); k constants cost
    (k/2) log n (Schwarz, Ann. Statist. 6 (1978)).
    """
    best = min(entries, key=lambda e: e.error)
    n = max(independent_per_block(best) * best.errors.size, 3.0)
    return np.array(
        [(e.constants * np.log(n) - 2.0 * log_prior(super_model, e)) / n for e in entries]
    )


def without_duplicates(super_model: SuperModel, entries: Sequence[Entry]) -> list[Entry]:
    """Leave out entries whose effect a wrong value reproduces exactly (docs/mechanisms.md)."""
    wrong = [
        e
        for e in entries
        if any(super_model.candidates[i].mechanism == "wrong_value" for i in e.members)
    ]

    def reproduced(entry: Entry) -> bool:
        return any(
            w is not entry
            and len(w.members) == len(entry.members)
            and entry not in wrong
            and abs(np.log(w.error / entry.error)) < 1e-5
            and len(set(w.members) & set(entry.members)) == len(entry.members) - 1
            and _same_family(super_model, set(entry.members) - set(w.members))
            for w in wrong
        )

    return [e for e in entries if not e.members or not reproduced(e)]


def _same_family(super_model: SuperModel, numbers: set[int]) -> bool:
    """Whether the candidates are forces: a sensor fault stays a rival of a wrong value."""
    return all(super_model.candidates[i].family != "measurement" for i in numbers)


def independent_residuals(entry: Entry) -> float:
    """How many independent residuals the recordings hold, by their correlation and their steps."""
    return max(independent_samples(entry.fit.residual, entry.converters), 10.0)


def most_credible(super_model: SuperModel, entries: Sequence[Entry]) -> Entry:
    """Return the entry of the least Schwarz criterion, where noise limits the fit.

    n log(cost) + k log(n) - 2 log(prior), n independent residuals of the best fit, k constants.
    """
    n = independent_residuals(min(entries, key=lambda e: e.fit.cost))
    return min(entries, key=lambda e: criterion(super_model, e, n))


def nearest_given(super_model: SuperModel, chosen: Entry, entries: Sequence[Entry]) -> Entry:
    """Return, of sets that fit and cost as well as the chosen one, that which changes least else.

    Where every mass and force may grow by one factor, the gain of one sensor and that of another
    are the same but for the free parameters: those of the model are believed first. Distances are
    relative to the bounds' widths.
    """
    n = independent_residuals(chosen)
    best, base = criterion(super_model, chosen, n), super_model.base_index()
    parameters = list(super_model.model.parameters.values())
    given = np.array([parameters[j].value for j in base], dtype=float)
    width = np.array([np.ptp(parameters[j].bounds or (0.0, np.inf)) for j in base])

    def distance(entry: Entry) -> float:
        return float(np.sum(((entry.fit.theta[base] - given) / width) ** 2))

    tied = [
        e
        for e in entries
        if len(e.members) == len(chosen.members)
        and e.constants == chosen.constants
        and abs(criterion(super_model, e, n) - best) < TIED
    ]
    return min([chosen, *tied], key=distance)


def criterion(super_model: SuperModel, entry: Entry, n: float) -> float:
    """Schwarz's criterion of an entry with its prior, for n independent residuals.

    How a jump is rounded is a nuisance, which the plain law is not to pay for.

    Extended to a choice among many: m of p mechanisms can be picked in C(p, m) ways, which is
    paid for by 2 log C(p, m) (Chen & Chen, Biometrika 95 (2008)).
    """
    mechanisms = len({c.label for c in super_model.candidates})
    choices = float(scipy.special.gammaln(mechanisms + 1.0))
    for part in (len(entry.members), max(mechanisms - len(entry.members), 0)):
        choices -= float(scipy.special.gammaln(part + 1.0))
    choices += float(sum(np.log(super_model.candidates[i].tried) for i in entry.members))
    price = entry.constants * np.log(n) + 2.0 * choices
    price += n * least_gain(super_model, entry)
    price -= 2.0 * log_prior(super_model, entry)
    return float(n * (np.log(entry.fit.cost + 1e-300) - credit(super_model, entry)) + price)


def credit(super_model: SuperModel, entry: Entry) -> float:
    """Return the log error that a plain law which jumps owes to how its jump is rounded.

    A richer law, or another mechanism beside it, must gain more than the width alone would.
    """
    if not entry.rounded or len(entry.members) != 1:
        return 0.0
    number = entry.members[0]
    return float(-np.log1p(-entry.rounded)) if len(super_model.index(number)) == 1 else 0.0


def least_gain(super_model: SuperModel, entry: Entry) -> float:
    """Return the log error that a set must gain beside the price of its constants.

    What integration leaves is worth no further mechanism, and what rounding leaves of a jump
    neither that nor a richer law.
    """
    more = max(len(entry.members) - 1, 0)
    if not any(super_model.candidates[i].sharp for i in entry.members):
        return FURTHER * more
    richer = sum(len(super_model.index(i)) for i in entry.members) - len(entry.members)
    return MIN_GAIN * more + RICHER * richer


def simplest_adequate(super_model: SuperModel, entries: Sequence[Entry]) -> Entry:
    """Return the entry with the fewest estimated constants that the best one does not beat.

    An entry stays in the race where the best one's gain over it, block by block and after
    `penalties`, is within one standard error (Breiman's rule), or too small to count.
    """
    price = penalties(super_model, entries)
    scores = [np.log(e.error + 1e-300) + c for e, c in zip(entries, price, strict=True)]
    leader = int(np.argmin(scores))
    best = entries[leader]
    adequate = []
    for entry, cost in zip(entries, price, strict=True):
        mean, error, _ = gain(entry.errors, best.errors)
        prior = -2.0 * log_prior(super_model, entry)
        if entry is best or (
            mean + cost - price[leader] <= max(error, MIN_GAIN) and prior < IMPLAUSIBLE
        ):
            adequate.append((entry, cost))
    chosen = min(adequate, key=lambda a: (a[0].constants, np.log(a[0].error) + a[1]))
    return chosen[0]


def independent_per_block(entry: Entry) -> float:
    """Independent residuals per block, by their correlation and their steps."""
    samples = independent_samples(entry.fit.residual, entry.converters)
    return max(samples / entry.errors.size, 1.0)
