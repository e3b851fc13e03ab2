"""Clocks that started long before a recording: laws are searched from its first sample on.

Of ``sin(w*t)`` with t in seconds since 1970 neither frequency nor phase can be found, and t itself
is as good as a constant. So where the origin of time lies further from the recordings than they
are long, time is counted from their first sample, and what is found is stated on the recordings'
own clock: ``sin(w*(t - 1000000.0))``. Nearer origins stay: there a phase of zero means something.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from jaxsr.discovery.hybrid import Hybrid
from jaxsr.discovery.samples import Samples
from jaxsr.expressions.term import Term
from jaxsr.recordings import Recording


def origin_of(recordings: Sequence[Recording]) -> float:
    """Return the first instant of recordings that are far from time zero, seconds; else 0."""
    first = min(float(r.time[0]) for r in recordings)
    last = max(float(r.time[-1]) for r in recordings)
    return first if max(first, -last) > last - first else 0.0


def since(recordings: Sequence[Recording], origin: float) -> list[Recording]:
    """Return recordings with time counted from an origin."""
    if origin == 0.0:
        return list(recordings)
    return [dataclasses.replace(r, time=r.time - origin) for r in recordings]


def on_clock(value: Any, time: str, origin: float) -> Any:
    """Return what was found with time counted from an origin, on the clock that counts from zero.

    Parameters
    ----------
    value
        Terms, samples, and whatever holds them: dataclasses, tuples, lists and mappings.
    time : str
        Symbol of time.
    origin : float
        Seconds.
    """
    if origin == 0.0:
        return value
    if isinstance(value, Term):
        if time not in value.variables:
            return value
        shifted = Term.apply("sub", Term.variable(time), Term.constant(origin))
        return value.substitute({time: shifted})
    if isinstance(value, Samples):
        instants = {time: value.variables[time] + origin}
        return dataclasses.replace(value, variables={**value.variables, **instants})
    if isinstance(value, Hybrid):
        rows = {
            name: [(a + origin, b + origin, mode) for a, b, mode in own]
            for name, own in value.switching.items()
        }
        parts = ("modes", "regions", "equations", "one_law")
        moved = {name: on_clock(getattr(value, name), time, origin) for name in parts}
        return dataclasses.replace(value, switching=rows, **moved)
    if isinstance(value, tuple | list):
        return type(value)([on_clock(part, time, origin) for part in value])
    if isinstance(value, dict):
        return {key: on_clock(part, time, origin) for key, part in value.items()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(value) if f.init}
        moved = {name: on_clock(part, time, origin) for name, part in fields.items()}
        changed = {name: part for name, part in moved.items() if part is not fields[name]}
        return dataclasses.replace(value, **changed) if changed else value
    return value
