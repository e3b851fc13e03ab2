"""Numbers, units and names as a reader wants them."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import TypeGuard

DASH = "–"
_SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹⁻"
_POWERS = str.maketrans("0123456789-", _SUPERSCRIPTS)


def is_number(value: object) -> TypeGuard[float]:
    """Whether `value` is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def number(value: object, digits: int = 4, trim: bool = True) -> str:
    """Print a number with `digits` significant digits; a dash when there is none.

    Trailing zeros go unless `trim` is false.
    """
    if not is_number(value):
        return DASH
    if value == 0:
        return "0"
    magnitude = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if -4 < magnitude < max(digits, 6):
        return _minus(f"{value:.{max(0, digits - 1 - magnitude)}f}", trim)
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{_minus(mantissa, trim=True)}×10{str(int(exponent)).translate(_POWERS)}"


def _minus(text: str, trim: bool) -> str:
    if trim and "." in text:
        text = text.rstrip("0").rstrip(".")
    return text.replace("-", "−")


def percent(value: object, digits: int = 2) -> str:
    """Print a fraction as a percentage."""
    if not is_number(value):
        return DASH
    if 0 < value < 1e-5:
        return "< 0.001 %"
    return f"{number(100 * value, 3 if value >= 1 else digits, trim=value in (0, 1))} %"


def odds(value: object) -> str:
    """Print a probability or a share, never as certainty or impossibility unless it is."""
    if not is_number(value):
        return DASH
    if 0.995 <= value < 1:
        return "> 99 %"
    if 0 < value < 0.005:
        return "< 1 %"
    return f"{number(100 * value, 2)} %"


def sureness(value: object) -> str:
    """Print a probability that rests on data: it is never 1, however many digits round it so."""
    return odds(min(value, 0.999)) if is_number(value) else DASH


def estimate(value: object, ci95: Sequence[float] | None) -> tuple[str, str]:
    """Print a value and its 95 % interval with the digits that the interval resolves.

    Parameters
    ----------
    value : float or None
    ci95 : sequence of two floats, or None

    Returns
    -------
    tuple of str
        The value, and ``low … high`` or a dash.
    """
    if not is_number(value) or not ci95 or not all(is_number(end) for end in ci95):
        return number(value), DASH
    low, high = ci95
    digits = digits_of(value, low, high)
    if digits is None:
        return number(value), f"{number(low)} … {number(high)}"
    shown, start, end = (number(item, digits, trim=False) for item in (value, low, high))
    return shown, f"{start} … {end}"


def digits_of(value: float, low: float, high: float) -> int | None:
    """Return the significant digits of a value that its interval resolves, at most eight.

    Two digits of the interval's width; None where it has none.
    """
    width, largest = abs(high - low), max(abs(low), abs(high), abs(value))
    if width == 0 or largest == 0:
        return None
    return min(8, max(2, math.floor(math.log10(largest)) - math.floor(math.log10(width)) + 2))


def plainly(value: float, digits: int = 3) -> str:
    """Print a number in ASCII, zeros that its digits resolve included: 20.40, 1.5e-05."""
    return f"{value:#.{digits}g}".removesuffix(".") if value else "0"


def in_ascii(text: str) -> str:
    """Return printed numbers for a terminal: ``−1.5×10⁻⁵ … 2`` as ``-1.5e-5 to 2``."""
    for fine, plain in (("−", "-"), ("×10", "e"), (" … ", " to "), (DASH, "-")):
        text = text.replace(fine, plain)
    return text.translate({ord(p): d for d, p in zip("0123456789-", _SUPERSCRIPTS, strict=True)})


def unit_text(unit: object) -> str:
    """Print a unit of a model file, ``N*s/m`` or ``m/s**2``, as N·s/m or m/s²."""
    if not isinstance(unit, str) or unit.strip() in ("", "1"):
        return ""
    text = re.sub(r"(?:\*\*|\^)\(?(-?\d+)\)?", lambda m: m[1].translate(_POWERS), unit.strip())
    return text.replace("*", "·")


def seconds(value: object) -> str:
    """Print a duration in seconds."""
    return f"{number(value, 3)} s" if is_number(value) else DASH


def shorten(text: str, longest: int = 44) -> str:
    """Cut the middle out of a long name."""
    if len(text) <= longest:
        return text
    half = (longest - 1) // 2
    return f"{text[:half]}…{text[-half:]}"


def listing(items: Sequence[str], most: int = 4, last: str = "and") -> str:
    """Join names as in a sentence, the rest counted."""
    shown = [str(item) for item in items[:most]]
    if len(items) > most:
        shown.append(f"{len(items) - most} more")
    if len(shown) < 2:
        return "".join(shown)
    return f"{', '.join(shown[:-1])} {last} {shown[-1]}"
