"""Files that appear whole or not at all, plain JSON, and checksums."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import enum
import errno
import hashlib
import json
import math
import os
import shutil
import stat
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxsr._result import InputError
from jaxsr._staging import PREFIX, locked, placing, staging_file, staging_folder, sweep

_BACKUP = ".jaxsr-backup"  # the old files, while new ones take their place one by one
_MANIFEST = ".jaxsr-files"  # names of the files that a run wrote, so that the next may replace them
_LONGEST = "x" * 64  # as long as the longest name of a result
_REMEDY = "Name another place with --out"


def check_writable(path: Path) -> None:
    """Raise unless a file can be made at `path`; leave nothing behind.

    Long jobs call this first, so that they do not fail at the end.

    Raises
    ------
    InputError
        If the nearest existing ancestor is not a directory that takes new files, a link on the
        way leads nowhere, or a name is too long.
    """
    with _told_of(path):
        _check_name(path)
        if path.exists() and not path.is_file():
            raise InputError("is no plain file", str(path), _REMEDY)
        with staging_folder(_nearest(path.parent)) as folder:
            (folder / _LONGEST).write_bytes(b"x")


def check_writable_directory(out: Path) -> None:
    """Raise unless `out` is, or can become, a directory that takes new files.

    Raises
    ------
    InputError
        If `out` is a file, lies where nothing can be written, or a name is too long.
    """
    with _told_of(out):
        _check_name(out / _LONGEST)
        if out.exists() and not out.is_dir():
            raise InputError("is a file, not a directory", str(out), _REMEDY)
        with staging_folder(_place(_nearest(out), out)) as folder:
            (folder / _LONGEST).write_bytes(b"x")


def atomic_write_text(path: Path, text: str | bytes) -> None:
    """Write text, in UTF-8, or bytes so that a reader sees the old or the new file, whole.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    with _told_of(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        sweep(path.parent)
        with staging_file(path.parent) as temporary:
            temporary.write_bytes(text.encode("utf-8") if isinstance(text, str) else text)
            _usual_permissions(temporary)
            _sync(temporary)
            with placing():
                os.replace(temporary, path)


@contextlib.contextmanager
def atomic_directory(out: Path) -> Iterator[Path]:
    """Yield an empty directory whose files become those of `out` when the block succeeds.

    A run that fails or is killed leaves the complete old files or the complete new ones. A new
    `out` appears by one rename, and one that holds results alone changes places with the new one
    by one rename (Linux), so that at any moment whoever reads sees one run's files.

    An `out` that holds files of others, is a mount point or somebody's current directory, or has
    permissions of its own stays the same directory. There the files are replaced one by one,
    which takes about a millisecond, with the old ones kept aside: a failure puts them back, and
    so does `mend_directory`, which the next run calls, after a kill between two renames. Files
    that no run of jaxsr wrote stay untouched.

    Parameters
    ----------
    out : Path
        Directory to write; parents are made, links followed.

    Yields
    ------
    Path
        Directory to write into. Files only: sub-directories are refused.

    Raises
    ------
    InputError
        If `out` cannot be written, or its disk is full or fails.
    """
    check_writable_directory(out)
    out = Path(os.path.realpath(out))
    mend_directory(out)
    with _told_of(out), staging_folder(_place(_nearest(out), out)) as staging:
        yield staging
        names = sorted({entry.name for entry in staging.iterdir()} - {_MANIFEST})
        if any((staging / name).is_dir() for name in names):
            raise ValueError(f"results are files in a flat directory, got folders in {names}")
        (staging / _MANIFEST).write_text("\n".join(names) + "\n", encoding="utf-8")
        _usual_permissions(staging, base=0o777)
        for path in [*staging.iterdir(), staging]:
            _sync(path)
        with placing():
            _place_results(staging, out)
            shutil.rmtree(
                staging, ignore_errors=True
            )  # the old files, where the two changed places


def mend_directory(out: Path) -> None:
    """Put back the old files of `out` where a kill left some new ones; remove litter of the dead.

    For whoever reads several results of one directory, and at the start of a run.
    """
    out = Path(os.path.realpath(out))
    sweep(out.parent)
    if not out.is_dir():
        return
    sweep(out)
    if (out / _BACKUP).is_dir():
        with _told_of(out), locked(out):
            _roll_back(out)


def _place_results(staging: Path, out: Path) -> None:
    """Make the files of `staging` those of `out`."""
    names = [path.name for path in staging.iterdir()]
    out.parent.mkdir(parents=True, exist_ok=True)
    if not out.exists():
        try:
            os.rename(staging, out)
            return
        except OSError as error:
            if error.errno not in (errno.EEXIST, errno.ENOTEMPTY):  # another run was quicker
                raise
    with locked(out):
        _roll_back(out)
        if staging.parent == out:
            _replace_files(out, staging, names)
        elif not (_is_swappable(out, staging) and _exchange(staging, out)):
            with staging_folder(out) as inner:
                for name in names:
                    shutil.copy2(staging / name, inner / name)
                    _sync(inner / name)
                _replace_files(out, inner, names)


def _is_swappable(out: Path, new: Path) -> bool:
    """Return whether nobody would miss the directory `out` itself, were `new` in its place."""
    one, other = out.stat(), new.stat()
    alike = (one.st_mode, one.st_uid, one.st_gid) == (other.st_mode, other.st_uid, other.st_gid)
    if hasattr(os, "listxattr"):
        alike = alike and _attributes(out) == _attributes(new)
    return alike and _holds_results_alone(out) and not _is_entered(out)


def _holds_results_alone(out: Path) -> bool:
    return {entry.name for entry in out.iterdir()} <= {*last_files(out), _MANIFEST}


def _attributes(folder: Path) -> dict[str, bytes]:
    """Return the extended attributes of a folder: access lists and security labels."""
    try:
        return {name: os.getxattr(folder, name) for name in os.listxattr(folder)}
    except OSError:  # a file system without them
        return {}


def _is_entered(folder: Path) -> bool:
    """Return whether `folder` is the current directory of a process that we may ask."""
    for place in (Path("."), *Path("/proc").glob("[0-9]*/cwd")):
        with contextlib.suppress(OSError):
            if place.samefile(folder):
                return True
    return False


def _exchange(one: Path, other: Path) -> bool:
    """Let two directories change places in one step (renameat2(2)); return whether they did."""
    at_cwd, exchange = -100, 2
    try:
        rename = ctypes.CDLL(None).renameat2
    except (AttributeError, OSError, TypeError):  # another system, or an old C library
        return False
    return rename(at_cwd, os.fsencode(one), at_cwd, os.fsencode(other), exchange) == 0


def _replace_files(out: Path, staging: Path, names: list[str]) -> None:
    """Move `names` from `staging` into `out`, all or none, and remove files of an earlier run."""
    stale = last_files(out) - set(names)
    with staging_folder(out) as held:
        for name in {*names, *stale}:
            if (out / name).exists():
                shutil.copy2(out / name, held / name)
        # Read by `_roll_back`: what must go when the old files come back.
        (held / ".new").write_text("\n".join(names), encoding="utf-8")
        try:
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
            with staging_file(out) as temporary:
                shutil.copy2(entry, temporary)
                os.replace(temporary, out / entry.name)
    with staging_folder(out) as emptied:  # one step: half a backup must not be read as one
        os.rename(backup, emptied)


def last_files(out: Path) -> set[str]:
    """Return the names of the files that the last run wrote into `out`; the next removes them."""
    try:
        lines = (out / _MANIFEST).read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return set()
    return {name for name in lines if name and name == Path(name).name and name not in (".", "..")}


def _nearest(path: Path) -> Path:
    """Return `path` or the nearest of its ancestors that is there.

    Raises
    ------
    InputError
        If that is a file, or a link that leads nowhere.
    """
    given = path
    while not path.exists():
        if path.is_symlink():
            raise InputError(f"cannot be written: {path} leads nowhere", str(given), _REMEDY)
        path = path.parent
    if not path.is_dir():
        raise InputError(f"cannot be written: {path} is a file", str(given), _REMEDY)
    return path


def _place(nearest: Path, out: Path) -> Path:
    """Return where the new files of `out` are written first: one rename away from their place."""
    if nearest != out:
        return nearest
    real = Path(os.path.realpath(out))
    is_beside = (
        real.stat().st_dev == real.parent.stat().st_dev
        and os.access(real.parent, os.W_OK | os.X_OK)
        and _holds_results_alone(real)
    )
    return real.parent if is_beside else real


def _check_name(path: Path) -> None:
    """Raise if a name in `path`, or all of it, is more than its file system takes.

    Raises
    ------
    OSError
        A name is too long.
    InputError
        A name holds a null character.
    """
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return
    except ValueError as error:
        raise InputError(f"cannot be written: {error}", repr(str(path)), _REMEDY) from error


@contextlib.contextmanager
def _told_of(path: Path) -> Iterator[None]:
    """Turn what the system says against writing at `path` into an `InputError`.

    An error that names a file elsewhere passes: it was met by whoever computes what is written.
    """
    try:
        yield
    except OSError as error:
        if error.errno is None or not _concerns(error, path):
            raise
        reason = error.strerror or type(error).__name__
        raise InputError(f"cannot be written: {reason}", str(path), _REMEDY) from error


def _concerns(error: OSError, path: Path) -> bool:
    """Return whether an error names no file, an unfinished one, or one on the way to `path`."""
    if not isinstance(error.filename, str | bytes | os.PathLike):
        return True
    name, target = os.path.abspath(os.fsdecode(error.filename)), os.path.abspath(path)
    return PREFIX in name or name.startswith(target) or target.startswith(name)


def _sync(path: Path) -> None:
    """Bring a file or folder to its disk, so that what fails there fails before old files go."""
    if sys.platform == "win32":
        return
    held = os.open(path, os.O_RDONLY)
    try:
        os.fsync(held)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EBADF):
            raise  # those say that the file system has no such call
    finally:
        os.close(held)


def _usual_permissions(path: Path, base: int = 0o666) -> None:
    """Give `path` the permissions of a plainly made file: temporary ones are private."""
    mask = os.umask(0)
    os.umask(mask)
    inherited = path.stat().st_mode & stat.S_ISGID
    path.chmod(base & ~mask | inherited)


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
