"""The command ``jaxsr demo``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from jaxsr._arguments import results_folder
from jaxsr._job import command_budget, loaded, save, session, verdict_line

SECONDS = 60.0
"""Time after which the demonstration takes the best it has."""


def demo(
    out: Annotated[
        str, typer.Option(metavar="DIR", help="Directory for the results.")
    ] = "jaxsr-demo",
) -> Callable[[str], None]:
    """Diagnose the bundled recordings of a two-link arm, offline."""
    folder = results_folder(out, {}, ())
    limit = command_budget(SECONDS)

    def job(command: str) -> None:
        model, train, held_out = _files()
        with session(limit) as progress:
            import jaxsr

            simulator = jaxsr.Simulator.from_file(model)
            diagnosis = loaded(jaxsr.diagnose)(
                simulator,
                train,
                held_out=held_out,
                budget=limit,
                progress=progress,
                command=command,
            )
        save(diagnosis, folder, verdict_line(diagnosis), budget=limit)

    return job


def _files() -> tuple[Path, list[Path], list[Path]]:
    """Return the bundled model, recordings to learn from and held-out ones."""
    folder = Path(__file__).parent / "datasets" / "demo"
    return folder / "arm.toml", [folder / "set1_train.csv"], [folder / "set1_validation.csv"]
