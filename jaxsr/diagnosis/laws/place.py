"""An equation at which a law may be missing, and what acts there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.likelihood.state import Members
from jaxsr.diagnosis.mechanisms.site import Site

SURE = 1e-3
"""Share of its mean square to which what acts is known, where it is smoothed."""


@dataclass(frozen=True, eq=False)
class Place:
    """An equation at which a law may be missing.

    Attributes
    ----------
    site : Site
    rest : tuple of int
        Members of the leader that stay beside the law.
    force, left : ndarray, shape (rows,)
        What acts there beside the given model, seen through the windows of the motion, and what of
        it the set leaves about which the law is written.
    reach : ndarray, shape (rows, free parameters)
        What re-calibration does there.
    signals : dict of str to ndarray, shape (samples,)
        States, inputs and time along the path of the set about which the law is written.
    base : ndarray, shape (free parameters,)
        Those of the given model, of that set.
    deviation, low, high : ndarray, shape (free parameters,)
        How far they are believed to be from there, and between what.
    """

    site: Site
    rest: Members
    force: np.ndarray
    left: np.ndarray
    reach: np.ndarray
    signals: dict[str, np.ndarray]
    base: np.ndarray
    deviation: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def held(self, moved: np.ndarray) -> Place | None:
        """Return the equation with parameters at the bounds beyond which they moved; None if none.

        What they would do there is left for the law.
        """
        there = self.base + moved
        out = (there < self.low) | (there > self.high)
        if not out.any():
            return None
        to = np.clip(there, self.low, self.high) - self.base
        force = self.force - self.reach[:, out] @ to[out]
        return replace(self, force=force, reach=np.where(out, 0.0, self.reach))

    def beside(self, rows: np.ndarray, columns: np.ndarray | None = None) -> float:
        """Return the mean square that re-calibration, and some forces, leave of rows."""
        known = self.reach if columns is None else np.concatenate([self.reach, columns], axis=1)
        return float(np.mean((rows - known @ np.linalg.lstsq(known, rows, rcond=1e-9)[0]) ** 2))

    @property
    def believed(self) -> np.ndarray:
        """Rows that hold re-calibration to what is believed of it, shape (free parameters, same).

        A law that is all but one of its columns would explain anything by their difference. What
        acts is known to `SURE` of itself.
        """
        return np.diag(np.sqrt(SURE * self.beside(self.force)) / self.deviation)
