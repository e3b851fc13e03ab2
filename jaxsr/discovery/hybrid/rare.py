"""A mode hardly visited: few samples at one end of a variable that spoil the law of all others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr._deadline import ensure, never
from jaxsr.discovery.hybrid.guards import Guard

_SHARES = (0.005, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08)
"""Shares of the samples that are left out at an end."""
_GAIN = 100.0
"""Factor by which leaving them out must lower the mean square of the others."""
_STRAY = 5.0
"""Size of a residual, over the rms of those of the law's own samples, that belongs elsewhere."""
_FEWEST = 3
"""Samples at least: fewer are outliers."""


@dataclass(frozen=True, slots=True)
class Tail:
    """The end of a guard variable.

    Attributes
    ----------
    guard : int
        Number of the guard variable.
    threshold : float
        Halfway between the last sample that follows the others' law and the next.
    above : bool
        Whether the end is the upper one.
    samples : int
    """

    guard: int
    threshold: float
    above: bool
    samples: int


@dataclass(frozen=True, slots=True)
class RareMode:
    """Samples that do not follow the law of all others, too few to tell their own.

    Attributes
    ----------
    guard : Guard
        Where they lie.
    samples, of : int
    """

    guard: Guard
    samples: int
    of: int

    def __str__(self) -> str:
        """Return a sentence for a reader."""
        return (
            f"{self.samples} of {self.of} samples, those with {self.guard}, do not follow the law "
            "of the others: a mode too rare to tell its law. Record more of it."
        )


def rare_tail(
    columns: np.ndarray,
    targets: np.ndarray,
    guards: Sequence[np.ndarray],
    expired: Callable[[], bool] = never,
) -> Tail | None:
    """Return the few samples at an end of a guard variable that spoil a linear fit of the others.

    Parameters
    ----------
    columns : ndarray, (samples, terms)
        Weighted, of mean square about one.
    targets : ndarray, (samples, states)
        Weighted like the columns.
    guards : sequence of ndarray, (samples,)
    expired : callable
        Whether the time is over.

    Raises
    ------
    OutOfTime
        Once it is.
    """
    everything = np.log(_mean_squares(columns, targets)[0])
    best: tuple[float, int, bool, int] | None = None
    for number, values in enumerate(guards):
        for above in (False, True):
            order = np.argsort(-values if above else values, kind="stable")
            for count in sorted({round(share * len(values)) for share in _SHARES}):
                ensure(expired)
                rest = order[count:]
                if count < _FEWEST or len(rest) < 3 * columns.shape[1]:
                    continue
                left = _mean_squares(columns[rest], targets[rest])[0]
                gain = float(np.mean(everything - np.log(left)))
                # as good with fewer samples left out is better
                if best is None or gain > best[0] + np.log(2.0):
                    best = gain, number, above, count
    if best is None or best[0] < np.log(_GAIN):
        return None
    _, number, above, count = best
    values = guards[number]
    order = np.argsort(-values if above else values, kind="stable")
    rest = order[count:]
    left, fit = _mean_squares(columns[rest], targets[rest])
    error = np.sqrt(np.mean((targets - columns @ fit) ** 2 / left, axis=1))
    strays = np.flatnonzero(error[order[: 2 * count]] > _STRAY)
    if len(strays) < _FEWEST:
        return None
    last = int(strays[-1])
    edge = 0.5 * (values[order[last]] + values[order[last + 1]])
    return Tail(number, float(edge), above, last + 1)


def _mean_squares(columns: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what a least-squares fit leaves (targets,), and the fit (terms, targets)."""
    fit = np.linalg.lstsq(columns, targets, rcond=1e-11)[0]
    left = np.mean((targets - columns @ fit) ** 2, axis=0)
    return left + 1e-26 * np.mean(targets**2, axis=0) + 1e-300, fit
