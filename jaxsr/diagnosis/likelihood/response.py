"""What forces along equations of motion do to the readings, about the path of re-calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.likelihood.local import LocalModel
from jaxsr.diagnosis.likelihood.scales import Scales, grams

TOGETHER = 64
"""Forces that are filtered at once: more do not fit the cache."""


@dataclass(frozen=True, eq=False)
class Response:
    """Readings linearised by a force along each equation, and by the free parameters.

    Attributes
    ----------
    local : LocalModel
        Of which the first constants are a force along each equation, the others free parameters.
    scales : Scales
        The noise of re-calibration, and rms net forces.
    share : float
        Of the net force that its latent force is.
    states : tuple of str
        Whose equations the forces are of.
    rows : tuple of (recording, start, stop)
        Pieces of the recordings.
    edges : ndarray of int, shape (recordings + 1,)
        First samples of the recordings, end to end.
    deviation : ndarray, shape (free parameters,)
        Prior ones.
    """

    local: LocalModel
    scales: Scales
    share: float
    states: tuple[str, ...]
    rows: tuple[tuple[int, int, int], ...]
    edges: np.ndarray
    deviation: np.ndarray

    def gains(self, forces: Sequence[Mapping[str, np.ndarray]]) -> np.ndarray:
        r"""Return the log evidence that a coefficient of each of several forces adds.

        Free parameters move along. With S and s the posterior precision and the pull of the
        coefficient in its prior deviation, :math:`\tfrac12 (s^2 / S - \log S)`; a coefficient is
        believed to bring a force as large as the net force.

        Parameters
        ----------
        forces : sequence of mapping of str to ndarray
            By the state of the equation, of all recordings end to end, for a coefficient of one.
        """
        parts = [forces[k : k + TOGETHER] for k in range(0, len(forces), TOGETHER)]
        return np.concatenate([self._gains(part) for part in parts]) if parts else np.zeros(0)

    def _gains(self, forces: Sequence[Mapping[str, np.ndarray]]) -> np.ndarray:
        count, local = len(self.states), self.local
        steps, readings, size = [], [], []
        for force in forces:
            step = np.zeros(local.defect.shape)
            reading = np.zeros(local.innovation.shape)
            square = 0.0
            for state, signal in force.items():
                k = self.states.index(state)
                at = self._pieces(signal)
                step += local.by_constant[..., k] * (0.5 * (at[1:] + at[:-1]))[..., None]
                reading += local.reading_by_constant[..., k] * at[..., None]
                square += float(np.mean(signal**2)) / self.scales.size[k] ** 2
            steps.append(step)
            readings.append(reading)
            size.append(1.0 / np.sqrt(square) if square > 0.0 else 0.0)
        own = replace(
            local,
            by_constant=np.concatenate([local.by_constant, np.stack(steps, -1)], -1),
            reading_by_constant=np.concatenate(
                [local.reading_by_constant, np.stack(readings, -1)], -1
            ),
        )
        (gram,) = grams(own, self.scales, np.array([self.share]))
        deviation = np.concatenate([self.deviation, size])
        products = gram.products
        kept = [0, *range(1 + count, len(products))]
        products = products[np.ix_(kept, kept)]
        inner = products[1:, 1:] * np.outer(deviation, deviation) + np.eye(len(deviation))
        pull = -products[1:, 0] * deviation
        base = len(self.deviation)
        across = np.linalg.solve(inner[:base, :base], inner[:base, base:])
        precision = np.diag(inner)[base:] - np.sum(inner[:base, base:] * across, axis=0)
        left = pull[base:] - across.T @ pull[:base]
        precision = np.maximum(precision, 1.0)
        return np.nan_to_num(0.5 * (left**2 / precision - np.log(precision)), nan=-np.inf)

    def _pieces(self, signal: np.ndarray) -> np.ndarray:
        """Return a signal of all recordings in pieces, shape (samples, pieces)."""
        found = np.zeros(self.local.innovation.shape[:2])
        for k, (r, start, stop) in enumerate(self.rows):
            first = self.edges[r]
            found[: stop - start, k] = signal[first + start : first + stop]
        return found
