"""Options that several commands share, and commands that take their options in groups."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable
from typing import Annotated, Any, cast

import typer

Job = Callable[[str], None]
"""What a command does once its arguments are checked; it takes the command line."""

Data = Annotated[list[str], typer.Argument(metavar="DATA...", help="Recordings to learn from.")]
Out = Annotated[str, typer.Option(metavar="DIR", help="Directory for the results.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of every random choice.")]
Seconds = Annotated[float | None, typer.Option("--budget", metavar="SECONDS", help="Time limit.")]
HeldOut = Annotated[
    list[str] | None,
    typer.Option(metavar="FILE...", help="Recordings opened once, at the end, to report the fit."),
]
Table = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="FILE.toml",
        help="With file.py:function, the model file that stands on it, such as an explained.toml; "
        "with robot.xml or plant.fmu, its sidecar; file.toml, robot.toml or plant.toml by default.",
    ),
]


def grouped(command: Callable[..., Job]) -> Callable[..., Job]:
    """Let a command take its options in groups, for typer knows none.

    Parameters
    ----------
    command : callable
        A parameter whose annotation is a dataclass stands for one option for each of its fields.

    Returns
    -------
    callable
        As typer reads it: a parameter for each option.
    """
    signature = inspect.signature(command, eval_str=True)
    groups: dict[str, type[Any]] = {
        name: p.annotation
        for name, p in signature.parameters.items()
        if isinstance(p.annotation, type) and dataclasses.is_dataclass(p.annotation)
    }
    options = [
        option.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for name, p in signature.parameters.items()
        for option in (
            inspect.signature(groups[name], eval_str=True).parameters.values()
            if name in groups
            else [p]
        )
    ]

    @functools.wraps(command)
    def flat(**given: Any) -> Job:
        own = {
            name: kind(**{field.name: given.pop(field.name) for field in dataclasses.fields(kind)})
            for name, kind in groups.items()
        }
        return command(**given, **own)

    read = cast(Any, flat)
    read.__signature__ = signature.replace(parameters=options)
    read.__annotations__ = {option.name: option.annotation for option in options}
    return flat
