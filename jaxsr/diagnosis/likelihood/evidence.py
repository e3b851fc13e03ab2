"""Log evidence of a set of constants: one Gram matrix answers for every set."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr._machine_code import compiled, kept, mark
from jaxsr.diagnosis.likelihood.bounded_modes import SCALED, Beliefs, Bounded, Modes, fill_modes
from jaxsr.diagnosis.likelihood.kalman import Whitened
from jaxsr.diagnosis.likelihood.truncated import Truncated, log_inside

SETTLING = 4
"""Fixed-point steps for the scale of the noise, which converge by a factor of samples a step."""
QUIETEST = 1e-300
"""Smallest factor on the noise where nothing is known of the sensors."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Independent normal priors of constants, cut off at their bounds.

    Attributes
    ----------
    mean, deviation : ndarray, shape (constants,)
        Of the changes of constants from where the model was linearised.
    low, high : ndarray, shape (constants,)
        Bounds of the changes.
    """

    mean: np.ndarray
    deviation: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @functools.cached_property
    def inside(self) -> float:
        """Log of the share of the prior that lies inside the bounds."""
        return log_inside(self.mean, self.deviation, self.low, self.high)

    def of(self, chosen: Sequence[int]) -> Prior:
        """Return the priors of some of the constants."""
        at = list(chosen)
        return Prior(self.mean[at], self.deviation[at], self.low[at], self.high[at])


@dataclass(frozen=True, eq=False)
class Mode:
    """The most probable constants of a set, and its evidence.

    Attributes
    ----------
    log_evidence : float
    change : ndarray, shape (constants,)
    deviation : ndarray, shape (constants,)
        Posterior standard deviations.
    noise : float
        Factor on all variances that fits best.
    """

    log_evidence: float
    change: np.ndarray
    deviation: np.ndarray
    noise: float


@dataclass(frozen=True, eq=False)
class Gram:
    """Products of innovations and their derivatives, summed over the pieces.

    Attributes
    ----------
    products : ndarray, shape (1 + constants, 1 + constants)
    log_determinant : float
    count : int
    quietest, loudest : float
        Smallest and largest factor on all variances.
    """

    products: np.ndarray
    log_determinant: float
    count: int
    quietest: float = QUIETEST
    loudest: float = np.inf

    @staticmethod
    def of(
        found: Whitened, lanes: slice, factors: tuple[float, float] = (QUIETEST, np.inf)
    ) -> Gram:
        """Sum over the lanes of one choice; `factors` are the smallest and the largest."""
        rows = found.rows[lanes].reshape(-1, found.rows.shape[-1])
        determinant = float(found.log_determinant[lanes].sum())
        return Gram(rows.T @ rows, determinant, found.count, *factors)

    def beside(self, log_density: float) -> Gram:
        """Return the same beside readings of a known log density."""
        return replace(self, log_determinant=self.log_determinant - 2.0 * log_density)

    def mode(self, mixing: np.ndarray, prior: Prior, scaled: bool = True) -> Mode:
        """Return the mode of the first constants, where the prior is of combinations of them.

        Parameters
        ----------
        mixing : ndarray, shape (constants, constants)
            Changes of constants by those that the prior is of.
        prior : Prior
        scaled : bool
            As in `evidence`.
        """
        size = 1 + len(mixing)
        whole = np.eye(size)
        whole[1:, 1:] = mixing
        products = whole.T @ self.products[:size, :size] @ whole
        found = replace(self, products=products).evidence(range(len(mixing)), prior, scaled)
        # Deviations of combinations as if these were independent.
        deviation = np.sqrt(mixing**2 @ found.deviation**2)
        return replace(found, change=mixing @ found.change, deviation=deviation)

    def evidence(self, chosen: Sequence[int], prior: Prior, scaled: bool = True) -> Mode:
        r"""Return the mode and the log evidence of a set of constants.

        With innovations v + W c, the prior N(m, \Lambda^{-1}) and variances scaled by k,

        .. math:: \log p = -\tfrac12 \left( N \log 2 \pi k + \log |S| + |v + W c|^2 / k
            + (c - m)' \Lambda (c - m) + \log |W'W/k + \Lambda| - \log |\Lambda| \right)

        at the most probable c inside the bounds; k is the one that fits best. What lies outside the
        bounds is no part of the integral: where none is reached, the share of the posterior inside
        them counts, over that of the prior; where some are, see `Truncated`.

        Parameters
        ----------
        chosen : sequence of int
            Columns, counted from 0.
        prior : Prior
            Of the chosen constants.
        scaled : bool
            Whether k is estimated; else 1.
        """
        at = 1 + np.asarray(chosen, dtype=int)
        inner, pull = self.products[np.ix_(at, at)], self.products[at, 0]
        precision = 1.0 / prior.deviation**2
        low, high = prior.low / prior.deviation, prior.high / prior.deviation
        noise = 1.0
        for _ in range(SETTLING if scaled else 1):
            # Scaled by the prior: the identity, and what the data add to it.
            root = prior.deviation / np.sqrt(noise)
            with np.errstate(over="ignore"):
                matrix = inner * np.outer(root, root) + np.eye(len(at))
            if not np.isfinite(matrix).all():
                raise np.linalg.LinAlgError("beside this noise nothing is finite")
            right = -(pull / noise) * prior.deviation + prior.mean / prior.deviation
            found = Truncated.of(matrix, right, low, high)
            change = prior.deviation * found.mode
            left = self.products[0, 0] + 2.0 * pull @ change + change @ inner @ change
            if left <= 0.0:  # rounding is all that is left of so large columns: no answer
                return Mode(-np.inf, prior.mean, prior.deviation, 1.0)
            before = noise
            if scaled:
                noise = min(max(float(left) / self.count, self.quietest), self.loudest)
            if abs(noise - before) <= SCALED * noise:
                break
        away = change - prior.mean
        log = -0.5 * (
            self.count * np.log(2.0 * np.pi * noise)
            + self.log_determinant
            + left / noise
            + away @ (precision * away)
        )
        log += found.log_integral - prior.inside
        change = np.clip(change, prior.low, prior.high)
        return Mode(float(log), change, prior.deviation * found.deviation, noise)


def modes(
    grams: Sequence[Gram],
    chosen: Sequence[int],
    prior: Prior,
    mixing: np.ndarray | None = None,
) -> list[Mode]:
    """Return the mode of one set of constants beside each of several noises.

    By machine code, in a twentieth of the time that arrays take; by these where it is not there, or
    has no answer.

    Parameters
    ----------
    grams : sequence of Gram
    chosen : sequence of int
        Columns, counted from 0.
    prior : Prior
        Of the chosen constants, or of combinations of them.
    mixing : ndarray, shape (constants, constants), optional
        Changes of the chosen constants, the first, by those that the prior is of.

    Raises
    ------
    numpy.linalg.LinAlgError
        Innovations, or their derivatives, are no numbers.
    """

    def by_arrays(gram: Gram) -> Mode:
        if mixing is None:
            return gram.evidence(chosen, prior)
        return gram.mode(mixing, prior)

    if not grams or kept(fill_modes, _MADE) is None:
        return [by_arrays(gram) for gram in grams]
    at = np.array([0, *(1 + k for k in chosen)])
    products = np.array([gram.products[at[:, None], at] for gram in grams])
    if mixing is not None:
        whole = np.eye(len(at))
        whole[1:, 1:] = mixing
        products = whole.T @ products @ whole
    found = _filled(grams, products, prior)
    change, deviation = found.change, found.deviation
    if mixing is None:
        change = np.clip(change, prior.low, prior.high)
    else:
        change = np.clip(change, prior.low, prior.high) @ mixing.T
        deviation = np.sqrt(deviation**2 @ (mixing**2).T)
    numbers = zip(found.log_evidence.tolist(), change, deviation, found.noise.tolist(), strict=True)
    return [
        by_arrays(gram) if failed else Mode(*known)
        for gram, failed, known in zip(grams, found.failed, numbers, strict=True)
    ]


def _filled(grams: Sequence[Gram], products: np.ndarray, prior: Prior) -> Modes:
    """Return what the machine fills; `products` is overwritten."""
    many, size, own = len(grams), len(prior.mean), np.ascontiguousarray(prior.deviation)
    (log, noise), (change, deviation) = np.empty((2, many)), np.empty((2, many, size))
    found = Modes(log, noise, change, deviation, np.zeros(many, bool))
    known = [(g.log_determinant, g.quietest, g.loudest) for g in grams]
    determinant, quietest, loudest = np.array(known).T.copy()
    beliefs = Beliefs(prior.mean / own, own, prior.low / own, prior.high / own)
    fill = compiled(fill_modes) or fill_modes
    room = Bounded.of(size)
    factors = quietest, loudest
    fill(products, determinant, factors, grams[0].count, beliefs, SETTLING, room, found)
    return found


_MADE = "from jaxsr.diagnosis.likelihood.evidence import compile_modes; compile_modes()"


def compile_modes() -> None:
    """Compile the machine, once an installation: it takes ten seconds."""
    one, none = np.ones(1), np.full(1, np.inf)
    if compiled(fill_modes) is not None:
        prior = Prior(np.zeros(1), one, -none, none)
        _filled([Gram(np.ones((2, 2)), 0.0, 1)], np.ones((1, 2, 2)), prior)
        mark(fill_modes)
