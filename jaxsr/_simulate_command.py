"""The command ``jaxsr simulate``."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from jaxsr._arguments import check_roles, is_model, table_of
from jaxsr._job import RUN
from jaxsr._options import Job, Table, grouped
from jaxsr._output import print_line
from jaxsr._process import say
from jaxsr._result import InputError


@dataclass(frozen=True)
class Grid:
    """The rows of a run that follows no recording."""

    duration: Annotated[float | None, typer.Option(help="Seconds, without DATA.")] = None
    dt: Annotated[float | None, typer.Option(help="Seconds between rows, without DATA.")] = None

    def check(self, data: str | None) -> None:
        """Raise unless a run has either a recording or both of these, positive."""
        if data is None and (self.duration is None or self.dt is None):
            raise InputError("no DATA to follow", "", "Give DATA, or both --duration and --dt")
        if data is not None and not (self.duration is None and self.dt is None):
            raise InputError("--duration and --dt are for runs without DATA", "", "Leave them out")
        for option, value in (("--duration", self.duration), ("--dt", self.dt)):
            if value is not None and not 0 < value < float("inf"):
                raise InputError(f"must be positive seconds, got {value}", option)


@grouped
def simulate(
    model: Annotated[
        str,
        typer.Argument(metavar="MODEL", help="A .toml, robot.xml, plant.fmu, or file.py:function."),
    ],
    grid: Grid,
    out: Annotated[str, typer.Option(metavar="FILE.csv", help="File for the outputs.")],
    data: Annotated[
        str | None, typer.Argument(metavar="[DATA]", help="Recording with the inputs.")
    ] = None,
    table: Table = None,
) -> Job:
    """Run a model freely, with recorded inputs or without any."""
    if not is_model(model):
        raise InputError(
            "is not a model", model, "Name a .toml, robot.xml or file.py:function first"
        )
    grid.check(data)
    inputs = ([model] if ".py:" not in model else []) + ([data] if data is not None else [])
    tables = table_of(model, table)
    check_roles({"MODEL": inputs[:1], "--model": tables, "DATA": inputs[1:]})
    target = _target(out, [*inputs, *tables])

    def job(command: str) -> None:
        from jaxsr._files import atomic_write_text, check_writable

        check_writable(target)
        run, start = _table(model, tables, data, grid)
        atomic_write_text(target, run.to_csv(index=False, lineterminator="\n"))
        RUN.get().outcome = f"{target} is whole"
        print_line(f"{len(run)} rows in {target}; {start}")

    return job


def _target(out: str, inputs: Sequence[str]) -> Path:
    """Return the file to write, which is none of the inputs and no directory."""
    target = Path(out)
    if any(Path(path).resolve() == target.resolve() for path in inputs):
        raise InputError("would overwrite an input", f"--out {out}", "Name another file")
    if os.path.isdir(target):
        raise InputError("is a directory", f"--out {out}", "Name a file, such as run.csv")
    return target


def _table(model: str, tables: Sequence[str], data: str | None, grid: Grid) -> tuple[Any, str]:
    """Return the run of a model as a table, and how it starts."""
    import jaxsr
    from jaxsr.models.formats.opening import open_simulator, simulated_table
    from jaxsr.models.simulation import start_told

    opened = open_simulator(model, tables, [data] if data is not None else [])
    with contextlib.closing(opened):
        if opened.drafted is not None:
            say(f"drafted {opened.drafted}: what it assumes stands in it")
        recording, given = None, opened.simulator.model
        if data is not None:
            recording = jaxsr.read_recording(
                data, time=given.columns.get(given.time), sample_time=given.sample_time
            )
        run = simulated_table(opened, recording, grid.duration, grid.dt)
        return run, start_told(given, recording)
