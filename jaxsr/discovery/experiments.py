"""Recordings as they were read, and which of their rows serve what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxsr.discovery.samples import Roles, Samples, Trace, hold_back, samples
from jaxsr.recordings import Recording, check_time_units, read_recording, unwrap

Source = Recording | str | Path


@dataclass(frozen=True)
class Experiments:
    """What a discovery may look at before its equations are final.

    Attributes
    ----------
    roles : Roles
    recordings : tuple of Recording
    rows : Samples
        Of all the recordings, for the final estimates.
    train, judge : Samples
        Rows to regress on, and rows to choose by.
    unseen : tuple of Trace
        Other recordings for roll-outs to choose by.
    """

    roles: Roles
    recordings: tuple[Recording, ...]
    rows: Samples
    train: Samples
    judge: Samples
    unseen: tuple[Trace, ...] = ()


def read_experiments(
    recordings: Sequence[Source],
    validation: Sequence[Source],
    roles: Roles,
    *,
    time: str | None = None,
    whole: bool = False,
) -> Experiments:
    """Read recordings, and hold some of their rows back where no others are to choose by.

    Parameters
    ----------
    recordings, validation : sequence of Recording or path
    roles : Roles
    time : str, optional
        Column of time.
    whole : bool
        Whether every fourth recording is held back, and not blocks of rows.
    """
    opened = tuple(read_source(source, time) for source in recordings)
    others = [read_source(source, time) for source in validation]
    check_time_units([*opened, *others])
    rows = samples(opened, roles)
    if validation:
        judge = samples(others, roles)
        return Experiments(roles, opened, rows, rows, judge, judge.traces)
    held = rows.group % 4 == 3 if whole else hold_back(rows.group)
    if not np.any(held):
        return Experiments(roles, opened, rows, rows, rows)
    train, judge = rows.take(np.flatnonzero(~held)), rows.take(np.flatnonzero(held))
    return Experiments(roles, opened, rows, train, judge)


def read_source(source: Source, time: str | None) -> Recording:
    """Return a recording, read from its file where it is a path; wrapped angles are counted on."""
    return unwrap(source if isinstance(source, Recording) else read_recording(source, time=time))
