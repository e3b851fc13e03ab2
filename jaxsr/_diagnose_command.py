"""The command ``jaxsr diagnose``."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from jaxsr._arguments import (
    check_roles,
    model_and_data,
    results_folder,
    split_names,
    table_of,
    written_back,
)
from jaxsr._job import before_writing, command_budget, loaded, save, session, verdict_line
from jaxsr._options import HeldOut, Job, Out, Seconds, Seed, Table, grouped
from jaxsr._progress import Budget, Progress
from jaxsr._result import InputError


@dataclass(frozen=True)
class SimulatorOptions:
    """The simulator, where the first argument does not say all of it."""

    simulated: Annotated[
        list[str] | None,
        typer.Option(metavar="FILE...", help="What the simulator gave, a file for each of DATA."),
    ] = None
    states: Annotated[
        str | None, typer.Option(metavar="z1,z2", help="Columns that are states.")
    ] = None
    table: Table = None


@dataclass(frozen=True)
class SearchOptions:
    """How a diagnosis runs."""

    held_out: HeldOut = None
    seed: Seed = 0
    budget: Seconds = None
    false_claim_cost: Annotated[
        float | None,
        typer.Option(
            metavar="NUMBER",
            min=0.0,
            help="What a wrong verdict costs, against abstaining (20): a verdict is given where it "
            "is so many times as probable as all others.",
        ),
    ] = None

    def keywords(self) -> dict[str, Any]:
        """Return what `jaxsr.diagnose` takes, its budget aside."""
        cost = self.false_claim_cost
        costs = {} if cost is None else {"false_claim_cost": cost}
        return {"held_out": self.held_out or [], "seed": self.seed, **costs}


@grouped
def diagnose(
    arguments: Annotated[
        list[str],
        typer.Argument(
            metavar="[MODEL] DATA...",
            help="The simulator (a .toml, robot.xml, plant.fmu, or file.py:function), and "
            "recordings to learn from. "
            "With --simulated, recordings alone.",
        ),
    ],
    out: Out,
    given: SimulatorOptions,
    search: SearchOptions,
) -> Job:
    """Find where a simulator differs from recordings, and name what was left out."""
    model, data = model_and_data(arguments, given.simulated, given.states)
    tables = table_of(model, given.table)
    files = {
        "MODEL": [model] if model is not None and ".py:" not in model else [],
        **{"--model": tables, "DATA": data},
        **{"--simulated": given.simulated or [], "--held-out": search.held_out or []},
    }
    check_roles(files)
    written = ("explained.toml", "diagnosis.json", "report.html")
    written += (() if model else ("learned.toml",)) + written_back(model)
    folder = results_folder(out, files, written)
    states = split_names(given.states, "--states")
    limit = command_budget(search.budget)
    searching = before_writing(limit)

    def job(command: str) -> None:
        with session(limit) as progress, contextlib.ExitStack() as ending:
            import jaxsr

            if model is None:
                pair = given.simulated or [], data
                simulator, more = _learned(pair, states, search.seed, searching, progress)
                opened = None
            else:
                opened = _opened(model, tables, data, folder, progress)
                ending.callback(opened.close)
                simulator, more = opened.simulator, {}
            diagnosis = loaded(jaxsr.diagnose)(
                simulator,
                data,
                budget=searching,
                progress=progress,
                command=command,
                **search.keywords(),
            )
            if opened is not None:
                more = opened.written_back(diagnosis, folder)
        options = {"more": more} if more else {}
        save(diagnosis, folder, verdict_line(diagnosis), budget=limit, **options)
        for error in diagnosis.unread:
            what = f"{error.what}; what was found without it is in {folder}"
            raise InputError(what, error.where, error.remedy)

    return job


def _learned(
    pair: tuple[Sequence[str], Sequence[str]],
    states: Sequence[str],
    seed: int,
    budget: Budget,
    progress: Progress,
) -> tuple[Any, dict[str, str]]:
    """Return the simulator behind its output and recordings, and its text under a file's name."""
    import jaxsr
    from jaxsr.models import model_text

    learned = loaded(jaxsr.learn_simulator)(
        *pair, states=states, seed=seed, budget=budget, progress=progress
    )
    return learned.simulator, {"learned.toml": model_text(learned.simulator.model)}


def _opened(
    model: str, tables: Sequence[str], data: Sequence[str], folder: Path, progress: Progress
) -> Any:
    """Return the simulator that the command names, and say what was drafted for it."""
    import jaxsr
    from jaxsr.models.formats.opening import open_simulator

    opened = open_simulator(model, tables, data, folder, jaxsr.Simulator.from_file)
    if opened.drafted is not None:
        progress.stage(f"drafted {opened.drafted}: what it assumes stands in it")
    return opened
