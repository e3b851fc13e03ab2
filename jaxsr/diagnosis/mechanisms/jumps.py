"""Laws that jump, as dry friction does, by what is written."""

from __future__ import annotations

import re
from collections.abc import Iterable

from jaxsr.models.simulator import SMOOTHED

_CONTINUOUS = re.compile(
    r"sign\(([^()]*)\) *\* *(?:sqrt\()?Abs\(\1\)"
    r"|Abs\(([^()]*)\)\)?(?: *\*\* *[\w.{}]+)? *\* *sign\(\2\)"
)
"""A power of a rate with its sign."""


def jumps_in(texts: Iterable[str]) -> bool:
    """Whether an expression has a sign that no power of the sign's argument takes to zero."""
    plain = (_CONTINUOUS.sub("", text) for text in texts)
    return any(f"{op}(" in text for text in plain for op in SMOOTHED)
