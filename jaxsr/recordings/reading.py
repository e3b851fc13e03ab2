"""Read recordings from CSV, Parquet, npz and mat files; write CSV."""

from __future__ import annotations

import csv
import hashlib
import io
import os
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.io
from scipy.io.matlab import MatReadError

from jaxsr._result import InputError
from jaxsr.recordings.recording import Recording

TIME_NAMES = ("t", "time", "time_s", "t_s", "Time", "timestamp", "seconds")
_TIME_NAMES_LOOSE = {*TIME_NAMES, "time(s)", "time[s]", "t(s)", "t[s]", "time_sec", "time_seconds"}

Columns = dict[str, np.ndarray]
SetAside = dict[str, str]


def read_recording(
    path: str | os.PathLike[str], time: str | None = None, sample_time: float | None = None
) -> Recording:
    """Read one recording.

    Parameters
    ----------
    path : path-like
        ``.csv`` (``.txt``, ``.tsv``; a header line; comma, semicolon or tab), ``.parquet``,
        ``.npz`` or ``.mat`` (up to version 7). Pickled objects are never loaded.
    time : str, optional
        Name of the time column, in seconds. By default one of `TIME_NAMES`, as written first,
        then whatever the case and with ``[s]`` or ``(s)``.
    sample_time : float, optional
        Interval in seconds, for files without a time column: time = 0, 1, 2, ... * sample_time.

    Returns
    -------
    Recording
        Its channels are the other numeric columns. Of ``.npz`` and ``.mat`` files these are the
        vectors as long as the time vector (without one: as long as the longest vector).

    Raises
    ------
    InputError
        One line: what, in which file, what to do about it.
    """
    path = Path(path)
    raw = _bytes(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        known = ", ".join(sorted(_READERS))
        raise InputError(f"unknown kind of file '{path.suffix}'", str(path), f"Use one of {known}")
    columns, set_aside = reader(raw, path.name)
    if sample_time is not None and not (np.isfinite(sample_time) and sample_time > 0):
        raise InputError(f"sample_time is {sample_time}", path.name, "Give seconds above 0")
    key = _time_column(columns, set_aside, time, path.name, sample_time)
    if key is None:
        assert sample_time is not None  # _time_column raised otherwise
        length = max((values.size for values in columns.values()), default=0)
        times = np.arange(length) * sample_time
    else:
        times = columns.pop(key)
    channels = {name: values for name, values in columns.items() if values.size == times.size}
    checksum = hashlib.sha256(raw).hexdigest()
    return Recording(path.name, times, channels, path, checksum, set_aside)


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
    temporary = None
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        with os.fdopen(handle, "w", newline="", encoding="utf-8") as stream:
            table.to_csv(stream, index=False, lineterminator="\n")
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
        temporary = None
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", str(path)) from error
    finally:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _bytes(path: Path) -> bytes:
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file", str(path), "Check the path") from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", str(path)) from error
    if not raw.strip():
        raise InputError("the file is empty", str(path), "Give a file with a header and samples")
    return raw


def _time_column(
    columns: Mapping[str, np.ndarray],
    set_aside: Mapping[str, str],
    time: str | None,
    file: str,
    sample_time: float | None,
) -> str | None:
    """Name of the time column; None where `sample_time` stands in for it."""
    if time is not None and time in columns:
        return time
    if time is not None and time in set_aside:
        raise _not_seconds(time, set_aside, file)
    if time is None:
        for name in TIME_NAMES:
            if name in columns:
                return name
        for name in columns:
            if name.replace(" ", "").lower() in _TIME_NAMES_LOOSE:
                return name
        for name in set_aside:
            if name in TIME_NAMES:
                raise _not_seconds(name, set_aside, file)
    if sample_time is not None:
        return None
    available = ", ".join(columns) or "none"
    missing = f"no time column '{time}'" if time else "no time column"
    raise InputError(missing, file, f"Name it or give sample_time. Columns: {available}")


def _not_seconds(name: str, set_aside: Mapping[str, str], file: str) -> InputError:
    return InputError(
        f"time column '{name}' {set_aside[name]}", file, "Give time in seconds, as numbers"
    )


def _read_csv(raw: bytes, file: str) -> tuple[Columns, SetAside]:
    text = raw.decode("utf-8-sig", errors="replace")
    first = next(line for line in text.splitlines() if line.strip())
    separator = max(",;\t", key=first.count)
    header = [
        name.strip().lstrip("#").strip() for name in next(csv.reader([first], delimiter=separator))
    ]
    if all(_is_number(name) for name in header if name):
        raise InputError("the first line holds numbers", file, "Give a header line of column names")
    named = [name for name in header if name]
    repeated = sorted({name for name in named if named.count(name) > 1})
    if repeated:
        raise InputError(f"column '{repeated[0]}' appears twice", file, "Give each its own name")
    try:
        table = pd.read_csv(
            io.StringIO(text),
            sep=separator,
            decimal="," if separator == ";" and "," in text else ".",
            header=None,
            skiprows=1 + _blank_lines_before(text),
            skipinitialspace=True,
            low_memory=False,
        )
    except pd.errors.EmptyDataError:
        raise InputError("a header but no samples", file, "Give at least 3 samples") from None
    except (pd.errors.ParserError, ValueError) as error:
        raise InputError(f"not a table: {str(error).strip()}", file, "Check that line") from error
    if table.shape[1] > len(header) and table.iloc[:, len(header) :].notna().to_numpy().any():
        raise InputError(
            f"rows have {table.shape[1]} values, the header names {len(header)}",
            file,
            "Give every column a name",
        )
    table = table.reindex(columns=range(len(header)))
    keep = [i for i, name in enumerate(header) if name]
    table = table.iloc[:, keep].set_axis([header[i] for i in keep], axis=1)
    return _numeric(table, file)


def _blank_lines_before(text: str) -> int:
    lines = text.splitlines()
    return next(i for i, line in enumerate(lines) if line.strip())


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return text.strip().lower() not in {"nan", "inf", "infinity"}


def _read_parquet(raw: bytes, file: str) -> tuple[Columns, SetAside]:
    try:
        table = pd.read_parquet(io.BytesIO(raw))
    except (ValueError, OSError) as error:  # pyarrow's errors derive from these
        raise InputError(f"not a Parquet file: {error}", file) from error
    table.columns = [str(name) for name in table.columns]
    return _numeric(table, file)


def _numeric(table: pd.DataFrame, file: str) -> tuple[Columns, SetAside]:
    """Split a table into number columns and columns that hold none."""
    columns: Columns = {}
    set_aside: SetAside = {}
    for name in table.columns:
        column = table[name]
        if pd.api.types.is_numeric_dtype(column) and not pd.api.types.is_complex_dtype(column):
            columns[name] = column.to_numpy(dtype=np.float64, na_value=np.nan)
            continue
        text = column.astype("string").str.strip().replace("", pd.NA)
        parsed = pd.Series(pd.to_numeric(text, errors="coerce"))
        numbers = parsed.to_numpy(dtype=np.float64, na_value=np.nan)
        bad = np.flatnonzero(np.isnan(numbers) & text.notna().to_numpy(dtype=bool))
        if bad.size == 0:
            columns[name] = numbers
            continue
        reason = f"is not numeric: row {bad[0] + 1} holds '{str(text.iloc[bad[0]])[:40]}'"
        if np.isfinite(numbers).any():
            raise InputError(
                f"column '{name}' {reason}", file, "Leave the cell empty where a sample is missing"
            )
        set_aside[name] = reason
    return columns, set_aside


def _read_npz(raw: bytes, file: str) -> tuple[Columns, SetAside]:
    try:
        with np.load(io.BytesIO(raw), allow_pickle=False) as archive:
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise InputError("one array, not an .npz archive", file, "Use numpy.savez")
            arrays = {name: archive[name] for name in archive.files}
    except (zipfile.BadZipFile, EOFError, OSError) as error:
        raise InputError("not an .npz archive", file, "Write it with numpy.savez") from error
    except InputError:
        raise
    except ValueError as error:
        raise InputError(
            "holds pickled objects, which are never loaded", file, "Save numeric arrays only"
        ) from error
    return _vectors(arrays), {}


def _read_mat(raw: bytes, file: str) -> tuple[Columns, SetAside]:
    try:
        arrays = scipy.io.loadmat(io.BytesIO(raw))
    except NotImplementedError as error:
        raise InputError(
            "a version 7.3 .mat file", file, "Save it in MATLAB with save(..., '-v7')"
        ) from error
    except (MatReadError, ValueError, TypeError, OSError) as error:
        raise InputError("not a readable .mat file", file, "Save with -v7 in MATLAB") from error
    return _vectors({k: v for k, v in arrays.items() if not k.startswith("__")}), {}


def _vectors(arrays: Mapping[str, np.ndarray]) -> Columns:
    """Real vectors, (n,), (n, 1) or (1, n), with more than one value; the rest is left out."""
    return {
        name: np.asarray(array, dtype=np.float64).ravel()
        for name, array in arrays.items()
        if isinstance(array, np.ndarray)
        and array.dtype.kind in "fiub"
        and array.size > 1
        and max(array.shape) == array.size
    }


_READERS: dict[str, Callable[[bytes, str], tuple[Columns, SetAside]]] = {
    ".csv": _read_csv,
    ".txt": _read_csv,
    ".tsv": _read_csv,
    ".parquet": _read_parquet,
    ".npz": _read_npz,
    ".mat": _read_mat,
}
