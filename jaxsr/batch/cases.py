"""Cases of a batch: a model and recordings each, as CASES.toml lists them."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from jaxsr._arguments import check_roles, is_model
from jaxsr._files import sha256
from jaxsr._quoting import quoted
from jaxsr._result import InputError
from jaxsr.models.document import read_document

_NAME = re.compile(r"[A-Za-z0-9][\w.-]{0,79}", re.ASCII)
_KEYS = ("model", "data", "held_out", "seed", "budget", "memory")
_REMEDY = f"Use {', '.join(_KEYS)}"


@dataclass(frozen=True)
class Case:
    """One diagnosis of a batch.

    Parameters
    ----------
    model : str
        Path of a model file, ``robot.xml`` or ``robot.urdf``; in Python also
        ``file.py:function``.
    data, held_out : tuple of str
        Paths of recordings.
    seed : int
    budget : float, optional
        Seconds; unlimited by default.
    memory : float, optional
        Most memory of its process in GiB, where the system can limit it.

    Raises
    ------
    InputError
        A value cannot be what it is given for.
    """

    model: str
    data: tuple[str, ...]
    held_out: tuple[str, ...] = ()
    seed: int = 0
    budget: float | None = None
    memory: float | None = None

    def __post_init__(self) -> None:
        for name in ("data", "held_out"):
            given: Any = getattr(self, name)
            paths = [given] if isinstance(given, str | Path) else cast("list[str | Path]", given)
            object.__setattr__(self, name, tuple(os.fspath(path) for path in paths))
        object.__setattr__(self, "model", os.fspath(self.model))
        if not is_model(self.model):
            remedy = "Name a .toml, robot.xml or file.py:function"
            raise InputError(f"{quoted(self.model)} is no model", "", remedy)
        if not self.data:
            raise InputError("no data", self.model, 'Write data = ["run.csv"]')
        seed: Any = self.seed
        if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
            raise InputError(f"seed {quoted(self.seed)}", self.model, "Write 0, 1, 2, ...")
        for name in ("budget", "memory"):
            value = getattr(self, name)
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if value is not None and not (number and 0 < value < float("inf")):
                raise InputError(f"{name} {quoted(value)}", self.model, "Write more than zero")

    def arguments(self, out: str) -> list[str]:
        """Return the command that makes this diagnosis alone, without the program's name."""
        held_out = ["--held-out", *self.held_out] if self.held_out else []
        limit = [] if self.budget is None else ["--budget", f"{self.budget:g}"]
        options = ["--out", out, "--seed", str(self.seed), *limit]
        return ["diagnose", self.model, *self.data, *held_out, *options]

    def check(self) -> None:
        """Raise unless every file is there, in one role.

        Raises
        ------
        InputError
            A file is missing, or stands twice.
        """
        check_roles({"model": [self._file], "data": self.data, "held_out": self.held_out})

    @property
    def _file(self) -> str:
        head, python, _ = self.model.rpartition(".py:")
        return f"{head}.py" if python else self.model

    def key(self, out: str) -> str:
        """Return a checksum of the command and of every file that it reads."""
        files = (self._file, *self.data, *self.held_out)
        parts = [*self.arguments(out), *(sha256(Path(path)) for path in files)]
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def read_cases(path: str | Path) -> dict[str, Case]:
    """Read CASES.toml.

    Parameters
    ----------
    path : path
        TOML with a table ``[cases.NAME]`` for every case: the fields of `Case`, paths relative to
        the file's folder. ``[defaults]`` holds what a case does not say.

    Raises
    ------
    InputError
        The file is no such TOML; it names Python, which runs only where a call names it.
    """
    path = Path(path)
    document = read_document(path)
    unknown = [key for key in document if key not in ("defaults", "cases")]
    if unknown:
        what = f"unknown table {quoted(unknown[0])}"
        raise InputError(what, path.name, "Write [defaults] and [cases.NAME]")
    tables = _table(document.get("cases", {}), path.name, "[cases.NAME]")
    defaults = _table(document.get("defaults", {}), path.name, "[defaults]")
    if not tables:
        raise InputError("no case", path.name, "Write [cases.NAME] with model and data")
    return {
        check_name(name, path.name): _case(
            {**defaults, **_table(row, path.name, f"[cases.{name}]")}, path, f"[cases.{name}]"
        )
        for name, row in tables.items()
    }


def check_name(name: Any, where: str = "cases") -> str:
    """Return the name of a case, which is that of its folder too.

    Raises
    ------
    InputError
        It could not name a folder everywhere.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        remedy = "Use letters, digits, _, - and ., at most 80"
        raise InputError(f"{quoted(name)} cannot name a case", where, remedy)
    return name


def _table(value: Any, file: str, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(
            f"must be a table, got {quoted(value)}", f"{file} {where}", "Write a table"
        )
    return cast("Mapping[str, Any]", value)


def _case(row: Mapping[str, Any], path: Path, where: str) -> Case:
    place = f"{path.name} {where}"
    unknown = [key for key in row if key not in _KEYS]
    if unknown:
        raise InputError(f"unknown key {quoted(unknown[0])}", place, _REMEDY)
    if not isinstance(row.get("model"), str):
        raise InputError("no model", place, 'Write model = "model.toml"')
    if ".py:" in row["model"]:
        what = f"{quoted(row['model'])} is Python, which runs only where a call names it"
        raise InputError(what, place, "Call jaxsr.diagnose_many with it")
    paths = {key: _paths(row.get(key, []), path.parent, f"{place} {key}") for key in _KEYS[1:3]}
    more = {key: row[key] for key in _KEYS[3:] if key in row}
    try:
        return Case(str(path.parent / row["model"]), **paths, **more)
    except InputError as error:
        raise InputError(error.what, place, error.remedy) from None


def _paths(value: Any, folder: Path, where: str) -> tuple[str, ...]:
    given = cast("list[Any]", value) if isinstance(value, list) else [value]
    if not all(isinstance(item, str) for item in given):
        raise InputError(f"must name files, got {quoted(value)}", where, 'Write ["a.csv"]')
    return tuple(str(folder / item) for item in given)
