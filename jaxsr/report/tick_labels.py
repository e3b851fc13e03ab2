"""Numbers beside the axes of figures, with powers of ten as plain text.

matplotlib writes powers of ten as mathematics and parses them: a third of the time of a figure.
"""

from __future__ import annotations

import re

from matplotlib.axes import Axes
from matplotlib.ticker import LogFormatter, ScalarFormatter

_SCALE = re.compile(r"1e(-?\d+)")
"""How matplotlib writes the power of ten of an axis, before what is to be added."""
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def power(exponent: int) -> str:
    """Return ``10⁻³`` for -3."""
    return "10" + str(exponent).translate(_RAISED)


class Scaled(ScalarFormatter):
    """Numbers of a linear axis, and at its end the power of ten and the offset that they share."""

    def get_offset(self) -> str:
        """Return ``×10⁻³ +25``: multiply by the first, then add the second."""
        told = super().get_offset().replace("\N{MINUS SIGN}", "-")
        scale = _SCALE.match(told)
        shift = told[scale.end() :] if scale else told
        words = [f"×{power(int(scale[1]))}"] if scale else []
        words += [f"{float(shift):+.12g}".replace("-", "\N{MINUS SIGN}")] if shift else []
        return " ".join(words)


class Powers(LogFormatter):
    """Powers of ten of a logarithmic axis; marks between them have no number."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Return ``10⁻³`` for 1e-3."""
        mantissa, _, exponent = f"{x:.6e}".partition("e")
        return power(int(exponent)) if float(mantissa) == 1.0 else ""


def plainly_numbered(axes: Axes) -> None:
    """Let both axes write their numbers without mathematics, where nothing else was set."""
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            axis.set_major_formatter(Powers())
        elif type(axis.get_major_formatter()) is ScalarFormatter:
            axis.set_major_formatter(Scaled())
