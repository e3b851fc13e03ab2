"""Choose the width of the test functions from the data."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from jaxsr._result import InputError
from jaxsr.recordings.noise import noise_level
from jaxsr.views.weak import WeakView

SHORTEST = 4  # samples
LONGEST = 0.25  # of the record
FEWEST = 16  # samples: four of the shortest half-widths
_KEPT = 0.5  # of the acceleration's energy; puts EMPS near the 0.1 s that serve it best
_NOISE_SHARE = 0.1  # of the energy that passes, at most
_STEP = 1.19  # ratio of neighbouring widths: four to the octave
_MAX_TESTS = 2000


def choose_half_width(time: np.ndarray, y: np.ndarray, noise: float | None = None) -> float:
    r"""Choose the half-width of test functions (1 - s^2)^8 for a measured signal.

    Such a function is close to a Gaussian of standard deviation half_width / 4, a low-pass filter
    with gain exp(-(f / sigma_f)^2 / 2), sigma_f = 0.64 / half_width. The energy of the
    acceleration that passes it, with the share of white noise of variance noise^2 taken off,

        E(h) = mean_c (int phi'' y dt)^2 - noise^2 mean_c sum_i weight_ci^2,

    falls with h where the dynamics lie. The rule: the longest h that still lets half of it pass,
    measured against the largest E, less its doubt, among widths at which noise is at most a
    tenth of what passes. If noise is more than that at every width, the width with the best ratio
    is taken.
    Half the energy, and not nearly all, because a longer test function costs only information,
    while a shorter one lets in fast dynamics that the model does not mean to describe.

    Parameters
    ----------
    time : ndarray, shape (samples,)
        Strictly increasing, in seconds; need not be uniform.
    y : ndarray, shape (samples,)
        A measured position; NaN where missing.
    noise : float, optional
        Standard deviation of its noise; `noise_level` by default.

    Returns
    -------
    float
        Seconds; at least 4 sample times, at most a quarter of the record.

    Raises
    ------
    InputError
        If the record is shorter than 16 samples.
    """
    y = np.asarray(y, dtype=np.float64)
    noise = noise_level(np.asarray(time, dtype=np.float64), y) if noise is None else noise
    return choose_half_widths(time, y[:, None], np.array([noise]))[0]


def choose_half_widths(
    time: np.ndarray, signals: np.ndarray, noise: np.ndarray | None = None
) -> list[float]:
    """Choose a half-width for each of several signals, which share their test functions.

    Parameters
    ----------
    time : ndarray, shape (samples,)
    signals : ndarray, shape (samples, signals)
        NaN where missing, for all of them alike.
    noise : ndarray, shape (signals,), optional
        Standard deviations; `noise_level` by default.

    Returns
    -------
    list of float
        As `choose_half_width` has them.

    Raises
    ------
    InputError
        If the record is shorter than 16 samples.
    """
    time, signals = np.asarray(time, dtype=np.float64), np.asarray(signals, dtype=np.float64)
    shortest = SHORTEST * float(np.median(np.diff(time)))
    longest = LONGEST * float(time[-1] - time[0])
    if longest < shortest * (1.0 - 1.0 / 16.0):
        raise InputError(
            f"{time.size} samples are too few to choose test functions",
            remedy=f"Give at least {FEWEST}",
        )
    if longest <= shortest:
        return [longest] * signals.shape[1]
    if noise is None:
        noise = np.array([noise_level(time, y) for y in signals.T])
    count = max(2, int(np.ceil(np.log(longest / shortest) / np.log(_STEP))) + 1)
    widths = np.geomspace(shortest, longest, count)
    energy, from_noise = _energies(time, signals, widths, noise)
    return [_chosen(time, widths, *both) for both in zip(energy, from_noise, strict=True)]


def sampled_alike(signals: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Group signals (samples, signals) by the samples that they hold.

    Yields
    ------
    present : ndarray of bool, shape (samples,)
    signals : ndarray, shape (present samples, signals of the group)
    """
    finite = np.isfinite(signals)
    for present in np.unique(finite, axis=1).T:
        own = (finite == present[:, None]).all(axis=0)
        yield present, signals[np.ix_(present, own)]


def _energies(
    time: np.ndarray, signals: np.ndarray, widths: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Energy that passes, and the noise's in it, shape (signals, widths); NaN where unknown."""
    energy, from_noise = np.full((2, signals.shape[1], widths.size), np.nan)
    largest, left = np.zeros(signals.shape[1]), np.ones(signals.shape[1], bool)
    for i, h in enumerate(widths):
        passed, per_noise = _passed(time, signals, h)
        energy[left, i] = passed[left]
        from_noise[left, i] = (noise**2 * per_noise)[left]
        clear = left & (from_noise[:, i] <= _NOISE_SHARE * energy[:, i])
        largest[clear] = np.maximum(largest, energy[:, i])[clear]
        # what passes falls with the width: nothing more to see
        left &= ~(clear & (energy[:, i] < 0.1 * largest))
        if not left.any():
            break
    return energy, from_noise


def _chosen(
    time: np.ndarray, widths: np.ndarray, energy: np.ndarray, from_noise: np.ndarray
) -> float:
    """Apply the rule of `choose_half_width` to what passes at every width."""
    known = np.isfinite(energy)
    if not known.any():
        return float(widths[-1])
    energy = np.where(known, energy, 0.0)
    from_noise = np.where(known, from_noise, np.inf)
    clear = from_noise <= _NOISE_SHARE * energy
    if not clear.any():
        signal = np.maximum(energy - from_noise, 0.0)
        best = np.where(np.isfinite(from_noise), signal / np.maximum(from_noise, 1e-300), -1.0)
        return float(widths[int(np.argmax(best))])
    signal = energy - from_noise
    # spread of the noise's energy over so few independent tests, and of its level
    places = (time[-1] - time[0]) / widths
    certain = signal - 2.0 * from_noise * (np.sqrt(2.0 / places) + np.sqrt(8.0 / time.size))
    enough = clear & (signal >= _KEPT * certain[clear].max())
    return float(widths[np.flatnonzero(enough)[-1]])


def _passed(time: np.ndarray, signals: np.ndarray, half_width: float) -> tuple[np.ndarray, float]:
    """Mean squares of the weak accelerations, shape (signals,), and that of noise of size 1."""
    span = time[-1] - time[0]
    overlap = 2.0 if span < 100.0 * half_width else 1.0
    spacing = max(half_width / overlap, span / _MAX_TESTS)
    view = WeakView.build(time, half_width, spacing, mask=np.asarray(np.isfinite(signals).all(1)))
    if not view.valid.any():
        return np.full(signals.shape[1], np.nan), np.nan
    accelerations = view.integrate(signals, derivative=2)[view.valid]
    weights = view.matrices[2].data
    return (
        np.mean(accelerations**2, axis=0),
        float(np.sum(weights**2) / np.count_nonzero(view.valid)),
    )
