"""An interval of a value, as every result states one."""

from __future__ import annotations

from typing import NamedTuple


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

    def __contains__(self, value: object) -> bool:
        """Return whether a number lies inside, the ends included."""
        return isinstance(value, int | float) and self.low <= value <= self.high

    def __str__(self) -> str:
        """Return ``[low, high]``, to four digits."""
        return f"[{self.low:.4g}, {self.high:.4g}]"
