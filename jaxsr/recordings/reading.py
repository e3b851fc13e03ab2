"""Read recordings from CSV, Excel, Parquet, npz and mat files."""

# pyright: reportMissingTypeStubs=false
from __future__ import annotations

import hashlib
import os
from pathlib import Path

import pandas as pd

from jaxsr._result import InputError
from jaxsr.recordings.cells import numbers_of
from jaxsr.recordings.clock import TIME_NAMES
from jaxsr.recordings.containers.merged import container_table
from jaxsr.recordings.containers.opened import LIBRARIES
from jaxsr.recordings.contents import contents_of
from jaxsr.recordings.encoding import unpack
from jaxsr.recordings.isolated import READER
from jaxsr.recordings.recording import Recording
from jaxsr.recordings.table import Table, listed, quoted
from jaxsr.recordings.text import read_csv, read_text

__all__ = ["TIME_NAMES", "read_recording"]

_TEXT = (".csv", ".tsv", ".txt")
_BINARY = {
    ".mat": ".mat",
    ".npz": ".npz",
    ".parquet": ".parquet",
    ".xlsm": ".xlsx",
    ".xlsx": ".xlsx",
}
_HEAD = 512
"""Bytes at the begin of a binary file, which is read by a process of its own."""


def read_recording(
    path: str | os.PathLike[str], time: str | None = None, sample_time: float | None = None
) -> Recording:
    """Read one recording.

    Parameters
    ----------
    path : path-like
        ``.csv`` (``.txt``, ``.tsv``; a header line; commas, semicolons, tabs or blanks; decimal
        points or commas; perhaps a preamble and a row of units), ``.xlsx``, ``.parquet``,
        ``.npz`` or ``.mat`` (up to version 7), each also as ``.gz``. Pickled objects are never
        loaded. With the extra ``formats`` also ``.h5``, ``.hdf5``, ``.tdms``, ``.mf4``, ``.mcap``,
        ``.bag`` and ``.db3``.
    time : str, optional
        Name of the time column: seconds, or the unit that its name or a row of units states
        (``time_ms``, ``t [us]``), or dates and clock times. By default one of `TIME_NAMES`, as
        written first, then other usual names, then the one column of dates.
    sample_time : float, optional
        Interval in seconds, for files without a time column: time = 0, 1, 2, ... * sample_time.

    Returns
    -------
    Recording
        Its channels are the other numeric columns. Of ``.npz`` and ``.mat`` files these are the
        vectors as long as the time vector (without one: as long as the longest vector), and the
        columns ``NAME_1``, ``NAME_2`` of matrices as long. Dates, clock times and times since
        1970 are counted from the first sample. How the file was read stands in its `remarks`.

    Raises
    ------
    InputError
        One line: what, in which file, what to do about it. A file that can be read in two ways
        is refused with both.
    """
    path = Path(path)
    raw, digest = _digested(path)
    found = contents_of(_table(raw, path), path.name, time, sample_time)
    return Recording(**vars(found), source=path, sha256=digest)


def _digested(path: Path) -> tuple[bytes, str]:
    """Return what a file holds and its SHA-256; of a binary one its first bytes alone."""
    try:
        if _lies_open(path):
            with path.open("rb") as file:
                raw = file.read(_HEAD)
                file.seek(0)
                digest = hashlib.file_digest(file, "sha256").hexdigest()
        else:
            raw = path.read_bytes()
            digest = hashlib.sha256(raw).hexdigest()
    except FileNotFoundError:
        raise InputError("no such file", str(path), "Check the path") from None
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"cannot be read: {why}", str(path)) from error
    if not raw.strip():
        raise InputError("the file is empty", str(path), "Give a file with a header and samples")
    return raw, digest


def _lies_open(path: Path) -> bool:
    """Whether a binary file can be read from where it lies: neither packed nor a pipe."""
    return path.suffix.lower() in _BINARY and path.is_file()


def _table(raw: bytes, path: Path) -> Table:
    suffixes = [s.lower() for s in path.suffixes[-2:]]
    kind = suffixes[-1] if suffixes else ""
    if kind == ".gz":
        kind = suffixes[0] if len(suffixes) > 1 else ""
        if kind in (*_TEXT, *_BINARY):
            raw = unpack(raw, path.name)
    if kind in _TEXT:
        return read_csv(raw, path.name)
    if kind in LIBRARIES and path.suffix.lower() == kind:
        return container_table(kind, path)
    if kind not in _BINARY:
        known = ", ".join(sorted((*_TEXT, *_BINARY, *LIBRARIES)))
        raise InputError(
            f"unknown kind of file '{quoted(path.suffix)}'",
            str(path),
            f"Use one of {known} (or .gz)",
        )
    return _binary(_BINARY[kind], raw, path.name, path if _lies_open(path) else None)


def _binary(kind: str, raw: bytes, file: str, path: Path | None) -> Table:
    """Return the table of a binary file, which is `raw` or begins so and lies at `path`."""
    if kind == ".mat" and (raw[:8] == b"\x89HDF\r\n\x1a\n" or raw[:10] == b"MATLAB 7.3"):
        raise InputError("a version 7.3 .mat file", file, "Save it in MATLAB with save(..., '-v7')")
    contents = READER.read(kind, path or raw, file)
    if kind == ".xlsx":
        if len(contents.sheets) > 1:
            raise InputError(
                f"{len(contents.sheets)} sheets hold rows: {listed(contents.sheets, 80)}",
                file,
                "Save the sheet of each experiment as a file of its own",
            )
        return read_text(contents.csv, file)
    cells = {name: pd.Series(values, dtype="string") for name, values in contents.texts.items()}
    numbers, texts = numbers_of(cells, None, file)
    return Table(contents.numbers | numbers, texts, odd=contents.odd)
