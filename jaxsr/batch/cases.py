"""A case of a batch: a diagnosis of one machine."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, date, datetime
from typing import Any

from jaxsr._arguments import check_roles, is_model
from jaxsr._quoting import quoted
from jaxsr._result import InputError
from jaxsr.batch.checking import check_limits, check_seed, checksum, words

_NAME = re.compile(r"[A-Za-z0-9][\w.-]{0,79}", re.ASCII)


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
    machine : str, optional
        Cases of one machine count as one where machines are compared; its own by default.
    date : datetime, optional
        When it was recorded, as a date, a time or in ISO 8601: over the dates of one machine a
        drift of its constants shows.

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
    machine: str | None = None
    date: datetime | None = None

    def __post_init__(self) -> None:
        for name in ("data", "held_out"):
            object.__setattr__(self, name, words(getattr(self, name)))
        object.__setattr__(self, "model", os.fspath(self.model))
        if not is_model(self.model):
            remedy = "Name a .toml, robot.xml or file.py:function"
            raise InputError(f"{quoted(self.model)} is no model", "", remedy)
        if not self.data:
            raise InputError("no data", self.model, 'Write data = ["run.csv"]')
        check_seed(self.seed, self.model)
        check_limits({"budget": self.budget, "memory": self.memory}, self.model)
        machine: Any = self.machine
        if machine is not None and not (isinstance(machine, str) and machine):
            raise InputError(f"machine {quoted(machine)}", self.model, "Write its name")
        object.__setattr__(self, "date", _moment(self.date, self.model))

    @property
    def result(self) -> str:
        """File that is there when it is done."""
        return "diagnosis.json"

    def parts(self, name: str) -> Iterator[tuple[str, Case]]:
        """Yield what runs by itself, under a name that is its folder too: the whole case."""
        yield name, self

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

    def key(self, out: str, directory: str = "") -> str:
        """Return a checksum of the command and of every file that it reads."""
        return checksum(self.arguments(out), (self._file, *self.data, *self.held_out), directory)


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


def _moment(given: Any, where: str) -> datetime | None:
    """Return a date or time, in UTC where it names no zone."""
    if given is None:
        return None
    try:
        moment = datetime.fromisoformat(given) if isinstance(given, str) else given
    except ValueError:
        moment = None
    if isinstance(moment, date) and not isinstance(moment, datetime):
        moment = datetime(moment.year, moment.month, moment.day)
    if not isinstance(moment, datetime):
        raise InputError(f"date {quoted(given)}", where, "Write 2024-05-31 or 2024-05-31T08:00:00")
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
