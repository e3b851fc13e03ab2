"""A table as a file holds it, before its columns have become time and channels."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

Texts = Mapping[str, pd.Series]


@dataclass(frozen=True, eq=False)
class Table:
    """Hold columns of numbers, columns of text, and how they were read.

    Attributes
    ----------
    numbers : mapping of str to ndarray, shape (samples,)
        float64 or int64; datetime64[ns] and timedelta64[ns] where the file stores those.
    texts : mapping of str to Series of str
        Columns that hold no numbers; one of them may be a clock.
    nameless : Series of str, optional
        The first column, where it has text but no name.
    units : mapping of str to str
        From a row of units under the header.
    odd : mapping of str to str
        What is no column of numbers or text, with the reason.
    said : tuple of str
        How the file was read, where that is not plain.
    exact : callable, optional
        Returns a column as it is written, for times with more digits than a float holds.
    """

    numbers: Mapping[str, np.ndarray]
    texts: Texts = field(default_factory=dict)
    nameless: pd.Series | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    odd: Mapping[str, str] = field(default_factory=dict)
    said: tuple[str, ...] = ()
    exact: Callable[[str], pd.Series] | None = None


def quoted(value: object, longest: int = 60) -> str:
    """Return a value for a message: printable, on one line, and cut where it is long."""
    text = "".join(c if c.isprintable() else "?" for c in str(value))
    return text if len(text) <= longest else text[: longest - 3] + "..."


def listed(names: Mapping[str, object] | list[str] | tuple[str, ...], longest: int = 300) -> str:
    """Return names for a message, the first of them where there are many."""
    shown: list[str] = []
    for name in names:
        shown.append(quoted(name))
        if len(", ".join(shown)) > longest:
            shown[-1] = f"... ({len(names)} in all)"
            break
    return ", ".join(shown) or "none"
