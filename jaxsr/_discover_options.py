"""The options of ``jaxsr discover``, and what they say in Python."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from jaxsr._arguments import split_names, split_outside, split_pairs
from jaxsr._options import HeldOut, Seconds, Seed
from jaxsr._result import InputError

_SIGNS = {"+": 1, "-": -1}
_TREATMENT = ("smoothing", "derivative", "view")


@dataclass(frozen=True)
class ColumnOptions:
    """Which column is what, and how it is treated."""

    states: Annotated[str, typer.Option(metavar="z1,z2", help="Columns that are states.")]
    derivatives: Annotated[
        str | None, typer.Option(metavar="dz1,dz2", help="Columns of their derivatives.")
    ] = None
    order: Annotated[int, typer.Option(min=1, max=2, help="2: the states are displacements.")] = 1
    inputs: Annotated[str | None, typer.Option(metavar="u1", help="Columns of inputs.")] = None
    time: Annotated[str | None, typer.Option(metavar="t", help="Column of time.")] = None
    autonomous: Annotated[
        bool, typer.Option("--autonomous", help="Keep time itself out of the equations.")
    ] = False
    columns: Annotated[
        list[str] | None,
        typer.Option(metavar='z1="Angle/rad"', help="Names in the equations, and their columns."),
    ] = None
    treatment: Annotated[
        str | None,
        typer.Option(
            metavar="view=weak,...",
            help="How states are treated: smoothing=, derivative= and view=, each chosen from the "
            "data by default.",
        ),
    ] = None

    def roles(self) -> dict[str, Any]:
        """Return what `jaxsr.Roles` takes, the treatment aside."""
        states = split_names(self.states, "--states")
        derivatives = split_names(self.derivatives, "--derivatives") or None
        inputs = split_names(self.inputs, "--inputs")
        columns = split_pairs(self.columns, "--columns")
        if derivatives and len(derivatives) != len(states):
            raise InputError(f"{len(derivatives)} names for {len(states)} states", "--derivatives")
        return {
            "states": states,
            "derivatives": derivatives,
            "order": self.order,
            "inputs": inputs,
            "time": self.time,
            "autonomous": self.autonomous,
            "columns": columns,
        }

    def treated(self) -> dict[str, str]:
        """Return what `jaxsr.Treatment` takes."""
        given: dict[str, str] = {}
        for part in [] if self.treatment is None else self.treatment.split(","):
            name, _, value = (piece.strip() for piece in part.partition("="))
            if name not in _TREATMENT or not value or name in given:
                raise InputError(
                    f"{part.strip()[:80]!r} says nothing of how states are treated",
                    "--treatment",
                    "Write smoothing=..., derivative=... and view=..., each once at most",
                )
            given[name] = value
        return given


@dataclass(frozen=True)
class LawOptions:
    """What is known of the law before the search."""

    units: Annotated[
        str | None, typer.Option(metavar="FILE", help="TOML with a [units] table.")
    ] = None
    known: Annotated[
        str | None, typer.Option(metavar="FILE", help="Model file of the known part.")
    ] = None
    signs: Annotated[
        list[str] | None,
        typer.Option(
            metavar='"v: v=-, q=-"',
            help="Signs of coefficients in a state's equation, + or - for each term; once a state.",
        ),
    ] = None
    guesses: Annotated[
        list[str] | None,
        typer.Option(
            metavar='"v: sin(q) - v"',
            help="An expression to start a state's search from; may be repeated.",
        ),
    ] = None
    modes: Annotated[str, typer.Option(metavar="auto|N", help="Number of modes.")] = "auto"

    def check_modes(self) -> None:
        """Raise unless the number of modes is one."""
        modes = self.modes
        if modes != "auto" and not (modes.isascii() and modes.isdigit() and int(modes) > 0):
            raise InputError(f"must be auto or a whole number above 0, got {modes!r}", "--modes")

    def prior(self) -> dict[str, Any]:
        """Return what `jaxsr.Prior` takes."""
        return {
            "units": self.units,
            "known": self.known,
            "signs": _signs(self.signs or ()),
            "guesses": _guesses(self.guesses or ()),
            "modes": self.modes,
        }


@dataclass(frozen=True)
class RunOptions:
    """On what the law is judged, and how the search runs."""

    validation: Annotated[
        list[str] | None, typer.Option(metavar="FILE...", help="Recordings to choose a model by.")
    ] = None
    held_out: HeldOut = None
    checkpoint: Annotated[
        str | None,
        typer.Option(
            metavar="DIR",
            help="Directory that keeps the searches: the same command again goes on from there.",
        ),
    ] = None
    seed: Seed = 0
    budget: Seconds = None

    def check_checkpoint(self, results: Path) -> None:
        """Raise unless the directory of the checkpoint can be written and is one of its own."""
        if self.checkpoint is None:
            return
        from jaxsr._files import check_writable_directory

        if Path(self.checkpoint).resolve() == results.resolve():
            raise InputError(
                "is the directory of the results",
                f"--checkpoint {self.checkpoint}",
                "Name another one",
            )
        try:
            check_writable_directory(Path(self.checkpoint))
        except InputError as error:
            where = f"--checkpoint {self.checkpoint}"
            raise InputError(error.what, where, "Name another place") from error


def _of_states(texts: Sequence[str], option: str, form: str) -> Iterator[tuple[str, str]]:
    """Yield state and rest of ``STATE: REST``."""
    for text in texts:
        state, colon, rest = (part.strip() for part in text.partition(":"))
        if not (state and colon and rest):
            raise InputError(f"{text[:80]!r} names no state", option, f"Write {form}")
        yield state, rest


def _signs(texts: Sequence[str]) -> dict[str, dict[str, int]]:
    """Return the signs by term by state in ``v: v=-, Abs(v)*v=-``."""
    out: dict[str, dict[str, int]] = {}
    for state, rest in _of_states(texts, "--signs", '"STATE: TERM=+, TERM=-"'):
        own = out.setdefault(state, {})
        for part in split_outside(rest, brackets=True):
            term, _, sign = (piece.strip() for piece in part.rpartition("="))
            if not term or sign not in _SIGNS:
                raise InputError(
                    f"{part.strip()[:80]!r} is no term with a sign",
                    "--signs",
                    'Write "STATE: TERM=+, TERM=-"',
                )
            if term in own:
                raise InputError(f"{term!r} stands twice for {state}", "--signs")
            own[term] = _SIGNS[sign]
    return out


def _guesses(texts: Sequence[str]) -> dict[str, list[str]]:
    """Return the expressions by state in ``v: sin(q)``."""
    out: dict[str, list[str]] = {}
    for state, expression in _of_states(texts, "--guesses", '"STATE: EXPRESSION"'):
        out.setdefault(state, []).append(expression)
    return out
