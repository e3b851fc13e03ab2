"""The commands ``jaxsr datasets list | fetch``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import typer

from jaxsr._output import print_line

Job = Callable[[str], None]  # of the command line

datasets_app = typer.Typer(
    rich_markup_mode=None, help="Real recordings, from their origin, checksummed."
)


@datasets_app.command("list")
def list_command() -> Job:
    """List the recordings that can be fetched."""

    def job(command: str) -> None:
        from jaxsr.datasets import list_datasets

        for dataset in list_datasets():
            print_line(f"{dataset.name:16} {dataset.title} ({dataset.licence})")

    return job


@datasets_app.command("fetch")
def fetch_command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="A name that `list` shows.")],
    out: Annotated[
        str | None, typer.Option(metavar="DIR", help="Directory, ./NAME by default.")
    ] = None,
) -> Job:
    """Write one CSV per experiment, with the model file beside."""

    def job(command: str) -> None:
        from jaxsr.datasets import fetch

        for path in fetch(name, out):
            print_line(str(path))

    return job
