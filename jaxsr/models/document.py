"""TOML documents of users: bytes to tables, whatever the bytes are."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from jaxsr._quoting import shortened
from jaxsr._result import InputError

MAX_CHARACTERS = 400_000
MAX_NESTING = 20  # of arrays and tables; a model file has four
# Everything in which brackets and dots mean nothing; what is not closed runs to the end.
_QUOTED = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:"""|\\?\Z)'
    r"|'''(?:[^']|'(?!''))*+(?:'''|\Z)"
    r'|"(?:[^"\\\n]|\\[^\n])*+"?'
    r"|'[^'\n]*+'?"
    r"|\#[^\n]*+",
    re.DOTALL,
)
_LONG_KEY = re.compile(rf"(?:\.[ \t]*+[\w-]++[ \t]*+){{{MAX_NESTING}}}")
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")


def read_document(path: Path) -> dict[str, Any]:
    """Read a TOML file in UTF-8, or in UTF-16 with a byte order mark.

    Raises
    ------
    InputError
        There is no such file, it cannot be read, or it is no TOML.
    """
    try:
        if path.is_dir():
            raise InputError("is a folder", str(path), "Name the model file in it")
        with open(path, "rb") as stream:
            data = stream.read(4 * MAX_CHARACTERS + 4)
    except InputError:
        raise
    except (FileNotFoundError, NotADirectoryError):
        raise InputError("no such model file", str(path), "Check the path") from None
    except OSError as error:
        what = f"cannot be read: {error.strerror or error}"
        raise InputError(what, shortened(str(path), 200)) from None
    except ValueError:
        raise InputError("is no path of a file", shortened(repr(str(path))), "Check it") from None
    return parse_document(decoded(data, path.name), path.name)


def decoded(data: bytes, source: str) -> str:
    """Return the text of a file's bytes.

    Raises
    ------
    InputError
        The bytes are no text in UTF-8, or in UTF-16 with a byte order mark.
    """
    try:
        return data.decode("utf-16" if data.startswith(_UTF_16) else "utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        what = f"cannot be read as text (line {line}: {error.reason})"
        raise InputError(what, source, "Save it as TOML in UTF-8") from None


def parse_document(text: str, source: str) -> dict[str, Any]:
    """Read TOML text in a time that grows in proportion to its length.

    Raises
    ------
    InputError
        The text is too long, nested too deeply, or no TOML.
    """
    if len(text) > MAX_CHARACTERS:
        what = f"is longer than {MAX_CHARACTERS} characters"
        raise InputError(what, source, "Name a model file, or split the model")
    # The standard reader recurses into brackets and takes a square of the parts of a key.
    outline = _QUOTED.sub("s", text)
    if _nesting(outline) > MAX_NESTING or _LONG_KEY.search(outline):
        what = f"is nested deeper than {MAX_NESTING} tables or arrays"
        raise InputError(what, source, "A model file needs no more than four")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        what = f"is not valid TOML: {shortened(str(error), 160)}"
        raise InputError(what, source, "Put text in quotes, and each key on a line") from None
    except RecursionError:
        raise InputError("is nested too deeply", source, "Take brackets out") from None
    except ValueError as error:  # of numbers and dates that only look like ones
        what = f"holds a value that cannot be read ({shortened(str(error))})"
        raise InputError(what, source, "Write numbers such as 1.5e-3") from None


def _nesting(outline: str) -> int:
    depth = deepest = 0
    for character in re.findall(r"[\[\]{}]", outline):
        depth = depth + 1 if character in "[{" else max(depth - 1, 0)
        deepest = max(deepest, depth)
    return deepest
