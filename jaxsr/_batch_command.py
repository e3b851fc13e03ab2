"""The command ``jaxsr batch``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from jaxsr._arguments import check_roles
from jaxsr._job import RUN
from jaxsr._output import print_line
from jaxsr._progress import progress_on
from jaxsr._result import InputError


def batch(
    cases: Annotated[
        str, typer.Argument(metavar="CASES.toml", help="The cases: a model and recordings each.")
    ],
    out: Annotated[str, typer.Option(metavar="DIR", help="Directory for the results.")],
    workers: Annotated[
        int, typer.Option(min=1, metavar="N", help="Cases at a time on this machine.")
    ] = 1,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler that runs the cases.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Leave out cases that are done.")
    ] = False,
) -> Callable[[str], None]:
    """Diagnose many machines, each by itself; a table and a page over all."""
    check_roles({"CASES.toml": [cases]})
    if scheduler is not None and workers > 1:
        raise InputError(
            "--workers and --scheduler", "", "Give one: a scheduler has its own workers"
        )

    def job(command: str) -> None:
        import jaxsr

        run = RUN.get()
        run.keeps = True
        run.outcome = f"the cases that are done are in {out}; --resume goes on"
        with progress_on() as progress:
            fleet = jaxsr.diagnose_many(
                cases,
                out,
                workers=workers,
                scheduler=scheduler,
                resume=resume,
                progress=progress,
                stop=run.asked.is_set,
            )
        print_line(str(fleet))
        print_line(f"Page: {Path(out) / 'batch.html'}")
        if fleet.failures and not run.asked.is_set():
            name, why = next(iter(fleet.failures.items()))
            what = f"{len(fleet.failures)} of {len(fleet.names)} cases failed, first {name}: {why}"
            raise InputError(what, "", "The others are whole; --resume runs these again")

    return job
