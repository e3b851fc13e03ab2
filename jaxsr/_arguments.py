"""Arguments of the commands: lists of files after one option, and the role of each file."""

from __future__ import annotations

import os
import stat
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

from jaxsr._result import InputError

FILE_LISTS = ("--held-out", "--validation", "--simulated", "--normal")


def expand_file_lists(argv: Sequence[str]) -> list[str]:
    """Repeat the name of a file-list option before each of its files.

    ``--held-out a b`` becomes ``--held-out a --held-out b``: parsers of the click family take
    one value and would let ``b`` fall through to the positional arguments, silently.

    Parameters
    ----------
    argv : sequence of str
        Arguments after the program's name. A list ends at the next option or at ``--``.

    Raises
    ------
    InputError
        If a file-list option has no file.
    """
    expanded: list[str] = []
    current: str | None = None  # the option that takes the files
    empty = False  # whether it still waits for its first

    def close() -> None:
        if empty:
            raise InputError(f"{current} names no file", "", f"Give {current} FILE...")

    for position, argument in enumerate(argv):
        name, equals, value = argument.partition("=")
        if argument == "--":
            close()
            return [*expanded, *argv[position:]]
        if name in FILE_LISTS:
            close()
            current, empty = name, not equals
            if equals:
                expanded += [name, value]
        elif argument.startswith("-") and argument != "-":
            close()
            current, empty = None, False
            expanded.append(argument)
        elif current is not None:
            expanded += [current, argument]
            empty = False
        else:
            expanded.append(argument)
    close()
    return expanded


FORMATS = (".xml", ".urdf", ".fmu")
"""Endings of the files of simulators that people have."""


def is_format(argument: str) -> bool:
    """Return whether an argument names ``robot.xml``, ``robot.urdf`` or ``plant.fmu``."""
    return argument.lower().endswith(FORMATS) and ".py:" not in argument


def written_back(model: str | None) -> tuple[str, ...]:
    """Return the names of the files in which a diagnosis edits a simulator in its own format."""
    if model is None or not is_format(model):
        return ()
    if model.lower().endswith(".fmu"):
        return "explained.ssv", "explained.py"
    names = "explained.xml", "explained.py"
    return (*names, "explained.urdf") if model.lower().endswith(".urdf") else names


def is_model(argument: str) -> bool:
    """Return whether a positional argument names a model: a TOML, a simulator, a function."""
    return argument.lower().endswith(".toml") or ".py:" in argument or is_format(argument)


def table_of(model: str | None, table: str | None) -> list[str]:
    """Return the model file that ``--model`` names beside a function or a simulator, in a list.

    Raises
    ------
    InputError
        If the model is neither a Python function nor a simulator's own file.
    """
    if table is None:
        return []
    if model is None or not (".py:" in model or is_format(model)):
        raise InputError(
            "--model goes with file.py:function, robot.xml or plant.fmu",
            f"--model {table}",
            "Leave it out",
        )
    return [table]


def check_roles(roles: Mapping[str, Iterable[str]]) -> None:
    """Raise unless every file exists and has one role.

    Parameters
    ----------
    roles : mapping of str to paths
        Files by role, named as on the command line (``DATA``, ``--held-out``, ...). A path is
        followed through links, and hard links to one file count as that file.

    Raises
    ------
    InputError
        If a file is missing, is not a file, may not be read, or is named twice.
    """
    seen: dict[tuple[int, int], tuple[str, str]] = {}
    for role, paths in roles.items():
        for path in paths:
            try:
                status = os.stat(path)
            except (OSError, ValueError) as error:
                reason = error.strerror if isinstance(error, OSError) else str(error)
                raise InputError(f"cannot be read: {reason}", f"{role} {path}") from error
            if not stat.S_ISREG(status.st_mode):
                kind = "a directory" if stat.S_ISDIR(status.st_mode) else "no plain file"
                raise InputError(f"is {kind}", f"{role} {path}", "Name the files of the recordings")
            # Asked, not tried: held-out files are opened once, at the end.
            if not os.access(path, os.R_OK):
                raise InputError("cannot be read: Permission denied", f"{role} {path}")
            key = (status.st_dev, status.st_ino)
            if key in seen:
                first_role, first = seen[key]
                raise InputError(
                    f"one file in two places: {first_role} {first} and {role} {path}",
                    "",
                    "Each file has one role, once",
                )
            seen[key] = role, path


def split_names(text: str | None, option: str) -> tuple[str, ...]:
    """Return the names in ``a,b,c``; a name in double quotes may hold commas.

    Raises
    ------
    InputError
        If a name is empty or stands twice.
    """
    if text is None:
        return ()
    names = tuple(_unquoted(name) for name in split_outside(text))
    if not all(names):
        raise InputError(f"an empty name in {text!r}", option, "Write names as a,b,c")
    if len(set(names)) < len(names):
        raise InputError(f"a name stands twice in {text!r}", option)
    return names


def split_pairs(texts: Sequence[str] | None, option: str) -> dict[str, str]:
    """Return the columns by name in ``z1=Angle,z2="Speed, rpm"``, given once or several times.

    Raises
    ------
    InputError
        If a part is no such pair, or a name stands twice.
    """
    out: dict[str, str] = {}
    for part in (part for text in texts or () for part in split_outside(text)):
        name, equals, column = part.partition("=")
        name, column = _unquoted(name), _unquoted(column)
        if not (equals and name and column):
            raise InputError(
                f"{part[:80]!r} names no column", option, 'Write NAME="Name of the column"'
            )
        if name in out:
            raise InputError(f"{name!r} stands twice", option)
        out[name] = column
    return out


def split_outside(text: str, brackets: bool = False) -> list[str]:
    """Split at commas that stand outside of double quotes, and of `brackets` if asked."""
    parts, inside, depth = [""], False, 0
    for letter in text:
        inside ^= letter == '"'
        if brackets and not inside:
            depth += (letter in "([") - (letter in ")]")
        if letter == "," and not inside and depth <= 0:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


def _unquoted(text: str) -> str:
    text = text.strip()
    quoted = len(text) > 1 and text[0] == text[-1] == '"'
    return text[1:-1].strip() if quoted else text


def model_and_data(
    arguments: Sequence[str], simulated: Sequence[str] | None, states: str | None
) -> tuple[str | None, list[str]]:
    """Split the positional arguments of ``diagnose`` into the model, if any, and the recordings.

    Raises
    ------
    InputError
        If they fit neither ``MODEL DATA...`` nor ``DATA... --simulated FILE...``.
    """
    first, *rest = arguments
    if simulated is None:
        if not is_model(first):
            raise InputError(
                f"the first argument is no model: {first}",
                "",
                "Name a .toml, robot.xml or file.py:function first, or give --simulated FILE...",
            )
        if states is not None:
            raise InputError("--states goes with --simulated", "", "The model names its states")
        if not rest:
            raise InputError("no DATA", "", "Name recordings after the model")
        return first, rest
    if is_model(first):
        raise InputError(
            f"both a model ({first}) and --simulated", "", "Give one: the model or its output"
        )
    if len(simulated) != len(arguments):
        raise InputError(
            f"{len(simulated)} simulated files for {len(arguments)} of DATA",
            "",
            "Give one for each, in the same order",
        )
    return None, list(arguments)


def results_folder(out: str, roles: Mapping[str, Iterable[str]], written: Collection[str]) -> Path:
    """Return the directory of the results, mended if a run was killed while it wrote them.

    Parameters
    ----------
    out : str
        Its path.
    roles : mapping of str to paths
        Input files by role.
    written : collection of str
        Names of files that the job writes.

    Raises
    ------
    InputError
        If `out` cannot be written, holds a directory in the place of a result, or a result
        would overwrite an input.
    """
    from jaxsr._files import check_writable_directory, last_files, mend_directory

    folder = Path(out)
    check_writable_directory(folder)
    mend_directory(folder)
    for name in written:
        if (folder / name).is_dir():
            raise InputError(f"holds a directory named {name}", out, "Name another --out")
    targets = {(folder / name).resolve() for name in {*written, *last_files(folder)}}
    for role, paths in roles.items():
        for path in paths:
            if Path(path).resolve() in targets:
                raise InputError(
                    f"would be overwritten by the results in {out}",
                    f"{role} {path}",
                    "Name another --out",
                )
    return folder
