"""An interval of a value, as every result states one."""

from __future__ import annotations

import math
from typing import NamedTuple

MOST_DIGITS = 8
"""Significant digits of a printed value, at most: more are nobody's to read."""


class Interval(NamedTuple):
    """The 95 % interval of a value, in the value's unit; unpacks as ``low, high``.

    Parameters
    ----------
    low, high : float
    """

    low: float
    high: float

    @property
    def width(self) -> float:
        """Return high minus low."""
        return self.high - self.low

    def text(self, value: float) -> str | None:
        """Return a value with the digits that the interval justifies; None without a width.

        The last digit is the last of the half width to two digits, a zero included. At least two
        are printed, where the interval is wider than the value, and at most `MOST_DIGITS`.
        """
        half = self.width / 2.0
        if not (math.isfinite(value) and math.isfinite(half) and half > 0.0):
            return None
        places = 1 - math.floor(math.log10(float(f"{half:.1e}")))
        rounded = round(value, places)
        if rounded == 0.0:
            return f"{value:#.2g}"
        digits = math.floor(math.log10(abs(rounded))) + places + 1
        if digits < 2 or digits > MOST_DIGITS:
            return f"{value:#.2g}" if digits < 2 else f"{value:.{MOST_DIGITS}g}"
        return f"{rounded:#.{digits}g}".removesuffix(".")

    def __contains__(self, value: object) -> bool:
        """Return whether a number lies inside, the ends included."""
        return isinstance(value, int | float) and self.low <= value <= self.high

    def __str__(self) -> str:
        """Return ``[low, high]``, to four digits."""
        return f"[{self.low:.4g}, {self.high:.4g}]"
