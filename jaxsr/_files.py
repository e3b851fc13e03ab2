"""Files that appear whole or not at all, plain JSON, and checksums."""

from __future__ import annotations

import contextlib
import dataclasses
import enum
import errno
import hashlib
import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxsr._result import InputError

_STAGING = ".jaxsr-staging-"  # new files being written
_BACKUP = ".jaxsr-backup"  # the old files, while new ones take their place
_MANIFEST = ".jaxsr-files"  # names of the files that a run wrote, so that the next may replace them


def check_writable(path: Path) -> None:
    """Raise unless a file or directory can be made at `path`; leave nothing behind.

    Long jobs call this first, so that they do not fail at the end.

    Raises
    ------
    InputError
        If the nearest existing ancestor is not a directory that takes new files.
    """
    nearest = path
    while not nearest.exists():
        nearest = nearest.parent
    remedy = "Name another place with --out"
    if nearest != path and not nearest.is_dir():
        raise InputError(f"cannot be written: {nearest} is a file", str(path), remedy)
    folder = nearest if nearest.is_dir() else nearest.parent
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", str(path), remedy) from error


def check_writable_directory(out: Path) -> None:
    """Raise unless `out` is, or can become, a directory that takes new files.

    Raises
    ------
    InputError
        If `out` is a file, or lies where nothing can be written.
    """
    if out.exists() and not out.is_dir():
        raise InputError("is a file, not a directory", str(out), "Name another place with --out")
    check_writable(out)


def atomic_write_text(path: Path, text: str) -> None:
    """Write `text` to `path` in UTF-8 so that a reader sees the old or the new file, whole.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        temporary = Path(name)
        with open(handle, "w", encoding="utf-8", newline="\n") as stream:
            stream.write(text)
        _usual_permissions(temporary)
        os.replace(temporary, path)
    except BaseException as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise InputError(f"cannot be written: {error.strerror}", str(path)) from error
        raise


@contextlib.contextmanager
def atomic_directory(out: Path) -> Iterator[Path]:
    """Yield an empty directory whose files become those of `out` when the block succeeds.

    An interrupted or failed run leaves the complete old files or the complete new ones. A new
    `out` appears by one rename. In an existing one, files are replaced one by one with the old
    ones kept aside; a failure puts them back, and so does the next run after a kill between two
    renames. Files that no run of jaxsr wrote stay untouched, and `out` itself is never renamed:
    it may be a mount point or the current directory.

    Parameters
    ----------
    out : Path
        Directory to write; parents are made.

    Yields
    ------
    Path
        Directory to write into. Files only: sub-directories are refused.

    Raises
    ------
    InputError
        If `out` cannot be written or the disk is full.
    """
    check_writable_directory(out)
    existed = out.is_dir()
    if existed:
        _roll_back(out)
    else:
        out.parent.mkdir(parents=True, exist_ok=True)
    staging = Path(tempfile.mkdtemp(prefix=_STAGING, dir=out if existed else out.parent))
    try:
        yield staging
        names = sorted({entry.name for entry in staging.iterdir()} - {_MANIFEST})
        if any((staging / name).is_dir() for name in names):
            raise ValueError(f"results are files in a flat directory, got folders in {names}")
        (staging / _MANIFEST).write_text("\n".join(names) + "\n", encoding="utf-8")
        if existed:
            _replace_files(out, staging, [*names, _MANIFEST])
        else:
            _usual_permissions(staging, base=0o777)
            os.rename(staging, out)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise InputError(f"cannot be written: {error.strerror}", str(out)) from error
        raise
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _replace_files(out: Path, staging: Path, names: list[str]) -> None:
    """Move `names` from `staging` into `out`, all or none, and remove files of an earlier run."""
    stale = _manifest(out) - set(names)
    held = Path(tempfile.mkdtemp(prefix=_STAGING, dir=out))
    try:
        for name in {*names, *stale}:
            if (out / name).exists():
                shutil.copy2(out / name, held / name)
        # Read by `_roll_back`: what must go when the old files come back.
        (held / ".new").write_text("\n".join(names), encoding="utf-8")
        # From this rename on, a killed run is rolled back by the next one.
        os.rename(held, out / _BACKUP)
        for name in names:
            os.replace(staging / name, out / name)
        for name in stale:
            (out / name).unlink(missing_ok=True)
        os.rename(out / _BACKUP, held)
    except BaseException:
        _roll_back(out)
        raise
    finally:
        shutil.rmtree(held, ignore_errors=True)


def _roll_back(out: Path) -> None:
    """Put back the files that an unfinished replacement had kept aside, if there was one."""
    backup = out / _BACKUP
    if not backup.is_dir():
        return
    for name in (backup / ".new").read_text(encoding="utf-8").splitlines():
        if not (backup / name).exists():
            (out / name).unlink(missing_ok=True)
    for entry in backup.iterdir():
        if entry.name != ".new":
            # A copy, not a move: being interrupted here must not lose what is still aside.
            temporary = out / f"{_STAGING}{entry.name}"
            shutil.copy2(entry, temporary)
            os.replace(temporary, out / entry.name)
    shutil.rmtree(backup)


def _manifest(out: Path) -> set[str]:
    """Return the plain file names that the last run wrote into `out`."""
    try:
        lines = (out / _MANIFEST).read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return set()
    return {name for name in lines if name and name == Path(name).name and name not in (".", "..")}


def _usual_permissions(path: Path, base: int = 0o666) -> None:
    """Give `path` the permissions of a plainly made file: temporary ones are private."""
    mask = os.umask(0)
    os.umask(mask)
    path.chmod(base & ~mask)


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal."""
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def dump_json(obj: Any) -> str:
    """Return `obj` as indented JSON; NumPy values become plain ones, NaN and infinity null.

    Parameters
    ----------
    obj : Any
        Mappings, sequences, dataclasses, enumerations, paths, NumPy scalars and arrays, nested.

    Raises
    ------
    TypeError
        If something else stands in `obj`.
    """
    return json.dumps(_plain(obj), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, enum.Enum):
        return _plain(value.value)
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.generic | np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, Path):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = dataclasses.fields(value)
        return {field.name: _plain(getattr(value, field.name)) for field in fields}
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, set | frozenset):
        return [_plain(item) for item in sorted(value)]
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    raise TypeError(f"no JSON form for {type(value).__name__}: {value!r}")
