"""Noise of sensors: white, correlated from sample to sample, and smoothed by a filter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise of the sensors: white, and correlated from sample to sample.

    The coloured part is c' = a c + e, or, where a filter of the pole b smooths it,
    c' = b (c + d), d' = a d + e: an autoregression of second order, 1 / (1 - a z^-1)(1 - b z^-1).

    Attributes
    ----------
    white, coloured : ndarray, shape (outputs,)
        Variances of the two parts.
    correlation : ndarray, shape (outputs,)
        a: of the coloured part, from one sample to the next; where it is smoothed, of what is.
    smoothing : ndarray, shape (outputs,), optional
        b; 0, as by default, where there is no filter.
    """

    white: np.ndarray
    coloured: np.ndarray
    correlation: np.ndarray
    smoothing: np.ndarray | None = None

    @staticmethod
    def white_of(variance: np.ndarray) -> Noise:
        """Return white noise alone."""
        return Noise(variance, np.zeros_like(variance), np.zeros_like(variance))

    @property
    def poles(self) -> tuple[np.ndarray, np.ndarray]:
        """Poles of the coloured part: its correlation, and that of its filter, 0 where none is."""
        rho = self.correlation
        return rho, np.zeros_like(rho) if self.smoothing is None else self.smoothing

    @property
    def between_neighbours(self) -> np.ndarray:
        """Variances that differences of neighbouring samples tell: the upper end of a spectrum."""
        a, b = self.poles
        return self.white + self.coloured * _upper(a) * _upper(b) * _upper(a * b)

    @property
    def driving(self) -> np.ndarray:
        """Variances of what drives the filter: d, of correlation a, in c' = b (c + d)."""
        a, b = self.poles
        return self.coloured * (1.0 - a * b) * (1.0 - b * b) / (1.0 + a * b) / np.where(b, b * b, 1)

    def scaled(self, factor: float) -> Noise:
        """Return the noise with all variances multiplied."""
        return replace(self, white=factor * self.white, coloured=factor * self.coloured)


def _upper(pole: np.ndarray) -> np.ndarray:
    """Return the upper end of the spectrum of what has a pole, in its mean."""
    return (1.0 - pole) / (1.0 + pole)
