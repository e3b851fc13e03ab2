"""Rates with Wilson intervals, and logistic curves of detection over size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Z95 = 1.959963984540054


@dataclass(frozen=True)
class Rate:
    """k of n, with the Wilson interval (Wilson 1927) at 95 %; absent where n is 0."""

    k: int
    n: int

    @staticmethod
    def of(marks: Sequence[bool]) -> Rate:
        """Count the true ones."""
        return Rate(int(sum(marks)), len(marks))

    @property
    def value(self) -> float | None:
        """k/n."""
        return self.k / self.n if self.n else None

    @property
    def interval(self) -> tuple[float, float] | None:
        """(p + z²/2n -+ z sqrt(p(1-p)/n + z²/4n²)) / (1 + z²/n)."""
        if not self.n:
            return None
        p, z2 = self.k / self.n, Z95**2 / self.n
        middle = (p + z2 / 2) / (1 + z2)
        half = Z95 * float(np.sqrt(p * (1 - p) / self.n + z2 / (4 * self.n))) / (1 + z2)
        return max(middle - half, 0.0), min(middle + half, 1.0)

    def document(self) -> dict:
        """Return plain values."""
        return {"k": self.k, "n": self.n, "rate": self.value, "wilson95": self.interval}

    def text(self) -> str:
        """Return, for a table, such as ``85 % [80, 89] (170/200)``."""
        if self.value is None or self.interval is None:
            return "no cases"
        low, high = self.interval
        return f"{100 * self.value:.0f} % [{100 * low:.0f}, {100 * high:.0f}] ({self.k}/{self.n})"


def thresholds(sizes: Sequence[float], found: Sequence[bool]) -> dict[str, float] | None:
    """Return the sizes seen in 50 % and 95 % of cases by a logistic curve over log size.

    P(found) = 1/(1 + exp(-a - b (log size - mean))), by Newton steps with a weak normal prior
    (deviation 5 on a, 3 on b), so that separable data stay finite. None where all or no cases
    were found, or the curve does not rise.
    """
    if not sizes or all(found) or not any(found):
        return None
    x = np.log(np.asarray(sizes, dtype=float))
    middle = float(x.mean())
    a = np.column_stack([np.ones_like(x), x - middle])
    y = np.asarray(found, dtype=float)
    prior = np.array([1 / 25.0, 1 / 9.0])
    w = np.zeros(2)
    for _ in range(50):
        p = 1.0 / (1.0 + np.exp(-np.clip(a @ w, -30, 30)))
        step = np.linalg.solve(
            a.T @ (a * (p * (1 - p))[:, None]) + np.diag(prior), a.T @ (y - p) - prior * w
        )
        w = w + step
        if np.abs(step).max() < 1e-10:
            break
    if w[1] <= 0.05:
        return None
    at = {name: middle + (logit - w[0]) / w[1] for name, logit in (("50 %", 0.0), ("95 %", 2.944))}
    # a size far outside those tried would be a guess
    return {n: float(np.exp(v)) for n, v in at.items() if v < x.max() + 1.0} or None
