"""A case of a batch: a search for equations from several seeds, of which the best is taken."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from jaxsr._arguments import check_roles
from jaxsr._files import atomic_directory, last_files
from jaxsr._result import InputError
from jaxsr.batch.checking import check_limits, check_seed, checksum, words


@dataclass(frozen=True)
class Islands:
    """One search for equations of motion, run from every seed by itself.

    Parameters
    ----------
    data, validation, held_out : tuple of str
        Paths of recordings.
    states, derivatives, inputs : tuple of str
        Columns.
    order : int
        2: the states are displacements.
    time : str, optional
        Column of time.
    columns : mapping of str to str
        Column of a name in the equations.
    units, known : str, optional
        Paths of the files of ``--units`` and ``--known``.
    modes : str or int
        Number of modes, or "auto".
    seeds : tuple of int
    budget : float, optional
        Seconds of each seed; unlimited by default.
    memory : float, optional
        Most memory of each process in GiB, where the system can limit it.

    Raises
    ------
    InputError
        A value cannot be what it is given for.
    """

    data: tuple[str, ...]
    states: tuple[str, ...]
    derivatives: tuple[str, ...] = ()
    order: int = 1
    inputs: tuple[str, ...] = ()
    time: str | None = None
    columns: Mapping[str, str] = field(default_factory=dict[str, str])
    units: str | None = None
    known: str | None = None
    validation: tuple[str, ...] = ()
    held_out: tuple[str, ...] = ()
    modes: str | int = "auto"
    seeds: tuple[int, ...] = (0,)
    budget: float | None = None
    memory: float | None = None

    def __post_init__(self) -> None:
        for name in ("data", "states", "derivatives", "inputs", "validation", "held_out"):
            object.__setattr__(self, name, words(getattr(self, name)))
        object.__setattr__(self, "seeds", tuple(self.seeds))
        if not self.data:
            raise InputError("no data", "discover", 'Write data = ["run.csv"]')
        if not self.states:
            raise InputError("no states", "discover", 'Write states = ["z1", "z2"]')
        if not self.seeds or len(set(self.seeds)) < len(self.seeds):
            raise InputError("no seed, or one twice", "discover", "Write seeds = [0, 1, 2]")
        for seed in self.seeds:
            check_seed(seed, "discover")
        check_limits({"budget": self.budget, "memory": self.memory}, "discover")

    @property
    def result(self) -> str:
        """File that is there when it is done."""
        return "discovery.json"

    def parts(self, name: str) -> Iterator[tuple[str, Islands]]:
        """Yield the searches of single seeds, each under the name of its folder."""
        for seed in self.seeds:
            yield f"{name}/seed_{seed}", replace(self, seeds=(seed,))

    def arguments(self, out: str) -> list[str]:
        """Return the command that searches from the first seed, without the program's name."""
        columns = ",".join(f"{name}={_quoted(column)}" for name, column in self.columns.items())
        options: dict[str, Sequence[str]] = {
            "--states": [_joined(self.states)],
            "--derivatives": [_joined(self.derivatives)] if self.derivatives else [],
            "--order": [str(self.order)],
            "--inputs": [_joined(self.inputs)] if self.inputs else [],
            "--time": [] if self.time is None else [self.time],
            "--columns": [columns] if columns else [],
            "--units": [] if self.units is None else [self.units],
            "--known": [] if self.known is None else [self.known],
            "--validation": self.validation,
            "--held-out": self.held_out,
            "--modes": [str(self.modes)],
            "--out": [out],
            "--seed": [str(self.seeds[0])],
            "--budget": [] if self.budget is None else [f"{self.budget:g}"],
        }
        given = [word for name, values in options.items() if values for word in (name, *values)]
        return ["discover", *self.data, *given]

    def check(self) -> None:
        """Raise unless every file is there, in one role.

        Raises
        ------
        InputError
            A file is missing, or stands twice.
        """
        check_roles(
            {
                **{"data": self.data, "validation": self.validation, "held_out": self.held_out},
                **{"units": words(self.units or ()), "known": words(self.known or ())},
            }
        )

    def key(self, out: str, directory: str = "") -> str:
        """Return a checksum of the command and of every file that it reads."""
        more = [path for path in (self.units, self.known) if path is not None]
        files = (*self.data, *self.validation, *self.held_out, *more)
        return checksum(self.arguments(out), files, directory)


def best(documents: Sequence[Mapping[str, Any]]) -> int:
    """Return which of several discoveries of the same data is taken.

    By the rule within one run: what holds as a law comes before what is undecided, then the least
    description length of free runs. Where no model could be run, the least error on rows held
    back, in the mean of its logarithm over the states; then the fewest operators.
    """
    return min(range(len(documents)), key=lambda place: (*_rank(documents[place]), place))


def take(chosen: Path, out: Path) -> None:
    """Make the results in one folder those of another, unless they are already."""
    names = sorted(last_files(chosen))
    if all(_same(chosen / name, out / name) for name in names):
        return
    with atomic_directory(out) as folder:
        for name in names:
            shutil.copyfile(chosen / name, folder / name)


def _rank(document: Mapping[str, Any]) -> tuple[bool, float, float, int]:
    length = document.get("description_length")
    equations: list[Mapping[str, Any]] = document.get("equations") or []
    errors = [e.get("validation_mse") or e.get("train_mse") or 0.0 for e in equations]
    level = sum(math.log(max(float(error), 1e-300)) for error in errors)
    size = sum(int(e.get("operators") or 0) + int(e.get("complexity") or 0) for e in equations)
    undecided = document.get("verdict") == "undecided"
    return undecided, math.inf if length is None else float(length), level, size


def _same(one: Path, other: Path) -> bool:
    return other.is_file() and one.read_bytes() == other.read_bytes()


def _quoted(name: str) -> str:
    return f'"{name}"' if "," in name else name


def _joined(names: Sequence[str]) -> str:
    return ",".join(_quoted(name) for name in names)
