"""Write recordings as CSV."""

from __future__ import annotations

import os
from pathlib import Path

import pandas as pd

from jaxsr._result import InputError
from jaxsr._staging import placing, staging_file, sweep
from jaxsr.recordings.recording import Recording


def write_csv(recording: Recording, path: str | os.PathLike[str], time: str = "t") -> None:
    """Write a recording as CSV, whole or not at all.

    Parameters
    ----------
    recording : Recording
    path : path-like
        Replaced in one step if it exists.
    time : str
        Name of the time column.

    Raises
    ------
    InputError
        If a channel has the name of the time column, or the file cannot be written.
    """
    path = Path(path)
    if time in recording.channels:
        raise InputError(f"a channel is named '{time}' like the time column", recording.name)
    # repr of a float64 is the shortest text that reads back to the same number
    table = pd.DataFrame({time: recording.time, **recording.channels})
    try:
        sweep(path.parent)
        with staging_file(path.parent) as temporary:
            table.to_csv(temporary, index=False, lineterminator="\n", encoding="utf-8")
            os.chmod(temporary, 0o666 & ~_umask())
            with placing():
                os.replace(temporary, path)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", str(path)) from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
