"""Deciding: which entry of the contest to believe, and how much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.special
import scipy.stats

from jaxsr.diagnosis.blocks import MIN_GAIN, correlation_length, gain, weights
from jaxsr.diagnosis.candidates import SuperModel
from jaxsr.diagnosis.coloured import likelihood_ratio
from jaxsr.diagnosis.contest import Arena, Entry, in_steps_of
from jaxsr.diagnosis.screening import STEEPEST
from jaxsr.diagnosis.uncertainty import half_widths
from jaxsr.diagnosis.widths import width_of

SIGNIFICANCE = 1e-3
"""False-alarm rate per comparison with re-calibration; divided by the candidates screened."""
PRIOR_SPREAD = 0.1
"""Standard deviation of log(value / given) for fixed constants and sensor scales."""
CLOCK_SPREAD = 0.01
"""The same of a clock's rate error."""
IMPLAUSIBLE = 9.0
"""Squared number of prior standard deviations beyond which an entry is only a last resort."""
FURTHER = 0.01
"""Smallest gain in log mean square that a further mechanism must bring, however significant."""
RICHER = 0.005
"""The same as `MIN_GAIN` for every further constant of a law that jumps."""
TIE = 0.2
"""Probability from which an alternative with another verdict makes the case undecided."""


@dataclass(frozen=True)
class Detection:
    """Whether something beats re-calibration, at a `rate` of false alarms over all candidates."""

    detected: bool
    log_gain: float
    p: float
    threshold: float
    rate: float


def plausible(arena: Arena, entry: Entry) -> bool:
    """Whether the estimates keep to physics: no bound is touched, Fs is not below Fc."""
    return bool(np.isfinite(entry.errors).all()) and sound_members(arena, entry) == entry.members


def sound_members(arena: Arena, entry: Entry) -> tuple[int, ...]:
    """Return the members whose estimates keep to physics."""
    return tuple(i for i in entry.members if _sound(arena, entry, i))


def _sound(arena: Arena, entry: Entry, number: int) -> bool:
    """Whether the estimates of one member keep to physics."""
    super_model, theta = arena.super_model, entry.fit.theta
    order = list(super_model.model.parameters.values())
    candidate, values = super_model.candidates[number], super_model.own_values(number, theta)
    if candidate.physical is not None and not candidate.physical(values):
        return False
    if candidate.mechanism == "stribeck_friction" and not _peaked(arena, entry, number):
        return False
    for spec, index in zip(candidate.parameters, super_model.index(number), strict=False):
        value, parameter = theta[index], order[index]
        low, high = parameter.bounds or (spec.low, spec.high)
        if value <= low or (value >= high and not spec.hard):
            return False
    return True


def _peaked(arena: Arena, entry: Entry, number: int) -> bool:
    """Whether a Stribeck peak is one: Fc <= Fs <= `STEEPEST` Fc, as far as the data tell them.

    It must also hold more than the smoothing of sign() takes away: the area of the peak over
    velocity, (Fs - Fc) vs sqrt(pi)/2, against the area Fc w log 2 that tanh(v/w) lacks.
    """
    super_model = arena.super_model
    values = super_model.own_values(number, entry.fit.theta)
    low, high = values["Fc"], STEEPEST * values["Fc"] + 1e-12
    if not low <= values["Fs"] <= high and entry.fit.jacobian.size:
        half = np.zeros(len(entry.fit.theta))
        half[entry.fit.active] = half_widths(arena, entry.fit)
        of = dict(zip(super_model.names[number], half[super_model.index(number)], strict=False))
        low, high = low - of["Fc"] - of["Fs"], high + STEEPEST * of["Fc"] + of["Fs"]
    if not low <= values["Fs"] <= high:
        return False
    width = width_of(in_steps_of(arena, entry).problem, super_model.candidates[number])
    peak = (values["Fs"] - values["Fc"]) * values["vs"] * 0.5 * np.sqrt(np.pi)
    return peak >= 3.0 * values["Fc"] * width * np.log(2.0)


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
    n = max(_independent(best) * best.errors.size, 3.0)
    return np.array(
        [(e.fit.active.size * np.log(n) - 2.0 * log_prior(super_model, e)) / n for e in entries]
    )


def without_duplicates(super_model: SuperModel, entries: Sequence[Entry]) -> list[Entry]:
    """Leave out entries whose effect a wrong value reproduces exactly (CONTRACT.md, section 4)."""
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
    """How many independent residuals the recordings hold, by the residuals' correlation."""
    samples = float(np.count_nonzero(entry.fit.residual))
    return max(samples / correlation_length(entry.fit.residual), 10.0)


def most_credible(super_model: SuperModel, entries: Sequence[Entry]) -> Entry:
    """Return the entry of the least Schwarz criterion, where noise limits the fit.

    n log(cost) + k log(n) - 2 log(prior), n independent residuals of the best fit, k constants.
    """
    n = independent_residuals(min(entries, key=lambda e: e.fit.cost))
    return min(entries, key=lambda e: criterion(super_model, e, n))


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
    price = entry.fit.active.size * np.log(n) + 2.0 * choices
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
    chosen = min(adequate, key=lambda a: (a[0].fit.active.size, np.log(a[0].error) + a[1]))
    return chosen[0]


def detect_in_noise(null: Entry, chosen: Entry, candidates: int) -> Detection:
    """Test an entry against re-calibration alone where noise limits the fit: likelihood ratio.

    n log(cost_0 / cost_1) is chi-squared with as many degrees of freedom as there are added
    constants (Wilks); the rate of false alarms, `SIGNIFICANCE`, is shared by all candidates. The
    ratio by innovations sees where in the spectrum coloured noise is strong: a slow force must
    stand out from noise that is slow itself. The smaller of the two counts.
    """
    more = max(chosen.fit.active.size - null.fit.active.size, 1)
    ratio = np.log((null.fit.cost + 1e-300) / (chosen.fit.cost + 1e-300))
    statistic = independent_residuals(chosen) * ratio
    if null.fit.usable and chosen.fit.usable:
        statistic = min(statistic, likelihood_ratio(null.fit, chosen.fit))
    p = float(scipy.stats.chi2.sf(statistic, more))
    threshold = SIGNIFICANCE / max(candidates, 1)
    return Detection(p < threshold, float(ratio), p, threshold, SIGNIFICANCE)


def detect(null: Entry, chosen: Entry, candidates: int) -> Detection:
    """Test an entry against re-calibration alone, block by block."""
    mean, _, p = gain(null.errors, chosen.errors)
    rate = 10.0 * SIGNIFICANCE
    threshold = rate / max(candidates, 1)
    return Detection(mean > MIN_GAIN and p < threshold, mean, p, threshold, rate)


@dataclass(frozen=True)
class Alternative:
    """What could stand in the place of a finding."""

    number: int
    probability: float
    entry: Entry


def alternatives(
    super_model: SuperModel,
    chosen: Entry,
    number: int,
    entries: Sequence[Entry],
    rng: np.random.Generator,
) -> tuple[float, list[Alternative]]:
    """Return the probability of one member of the chosen set, and of what could replace it.

    Compared are the chosen set, the set without the member, and sets with one other candidate
    in its place.
    """
    rest = set(chosen.members) - {number}
    rivals = [
        e
        for e in entries
        if e is not chosen
        and rest <= set(e.members)
        and number not in e.members
        and len(e.members) <= len(chosen.members)
    ]
    share = shares(super_model, [chosen, *rivals], rng)
    found = []
    for rival, probability in zip(rivals, share[1:], strict=True):
        swapped = set(rival.members) - rest
        if swapped:
            found.append(Alternative(swapped.pop(), float(probability), rival))
    n = independent_residuals(chosen)
    found.sort(key=lambda a: (-round(a.probability, 6), criterion(super_model, a.entry, n)))
    own = super_model.candidates[number].label
    best = {own: Alternative(number, float(share[0]), chosen)}
    for alternative in found:
        # Other starts of a mechanism count for it.
        label = super_model.candidates[alternative.number].label
        known = best.setdefault(label, alternative)
        if known is not alternative:
            total = known.probability + alternative.probability
            best[label] = replace(known, probability=total)
    return best.pop(own).probability, list(best.values())


def shares(
    super_model: SuperModel, entries: Sequence[Entry], rng: np.random.Generator
) -> np.ndarray:
    """Probabilities of entries, the chosen one first.

    A richer rival must gain a standard error beside its price, as in `simplest_adequate`. No other
    block tells of what happened once: beside a push, Schwarz's criterion decides.
    """
    passing = any(super_model.candidates[i].passing for e in entries for i in e.members)
    if not passing:
        price = penalties(super_model, entries)
        price += [least_gain(super_model, e) for e in entries]
        price += [_margin(entries[0], e) - credit(super_model, e) for e in entries]
        return weights([e.errors for e in entries], _independent(entries[0]), price, rng)
    n = independent_residuals(entries[0])
    score = np.array([criterion(super_model, e, n) for e in entries])
    share = np.exp(-0.5 * (score - score.min()))
    return share / share.sum()


def _margin(chosen: Entry, rival: Entry) -> float:
    """Return the standard error of a richer rival's gain; 0 for any other."""
    if rival.fit.active.size <= chosen.fit.active.size:
        return 0.0
    error = gain(chosen.errors, rival.errors)[1]
    return error if np.isfinite(error) else 0.0


def _independent(entry: Entry) -> float:
    """Independent residuals per block, by the correlation length of the residuals."""
    samples = float(np.count_nonzero(entry.fit.residual))
    return max(samples / correlation_length(entry.fit.residual) / entry.errors.size, 1.0)


def odds(super_model: SuperModel, chosen: Entry, rival: Entry, rng: np.random.Generator) -> float:
    """Return the probability of one entry against another."""
    price = penalties(super_model, [chosen, rival])
    return float(weights([chosen.errors, rival.errors], _independent(chosen), price, rng)[0])
