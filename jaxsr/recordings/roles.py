"""Roles: the names a model uses for the columns of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from jaxsr._result import InputError
from jaxsr.recordings.recording import Recording
from jaxsr.recordings.table import listed, quoted


def rename(recording: Recording, columns: Mapping[str, str]) -> Recording:
    """Name the channels by their roles.

    Parameters
    ----------
    recording : Recording
        As read, channels named by the file's columns.
    columns : mapping of str to str
        Role to column. A role whose column is the recording's time has been used by then and is
        passed over by leaving it out. Columns that no role names keep their name; one that
        already has the name of a role is hidden by it.

    Returns
    -------
    Recording
        One column may serve several roles.

    Raises
    ------
    InputError
        If a column does not exist.
    """
    for role, column in columns.items():
        if column not in recording.channels and column not in recording.set_aside:
            raise InputError(
                f"no column '{quoted(column)}' for '{quoted(role)}'",
                recording.name,
                f"Available: {listed(list(recording.channels))}",
            )
    used = set(columns.values())
    kept = {k: v for k, v in recording.channels.items() if k not in used and k not in columns}
    roles = {r: recording.channels[c] for r, c in columns.items() if c in recording.channels}
    unread = {k: v for k, v in recording.set_aside.items() if k not in used and k not in columns}
    unread |= {
        r: f"(column '{c}') {recording.set_aside[c]}"
        for r, c in columns.items()
        if c in recording.set_aside
    }
    return replace(recording, channels=roles | kept, set_aside=unread)
