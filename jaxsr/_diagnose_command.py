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
from jaxsr._job import RUN, before_writing, command_budget, loaded, save, session, verdict_line
from jaxsr._options import HeldOut, Job, Out, Seconds, Seed, Table, grouped
from jaxsr._output import print_line
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

    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Leave alone what the same command brought to its end; begin anew what was "
            "stopped.",
        ),
    ] = False

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
    if search.resume and not (model or "").lower().endswith(".toml"):
        # What else a robot, a function or a learnt simulator rests on is nowhere hashed.
        raise InputError("--resume goes with a model file", "", "Leave it out")
    limit = command_budget(search.budget)
    return _Work(model, tables, data, states, given.simulated or [], search, folder, limit)


@dataclass(frozen=True)
class _Work:
    """A diagnosis whose arguments were checked."""

    model: str | None
    tables: Sequence[str]
    data: Sequence[str]
    states: Sequence[str]
    simulated: Sequence[str]
    search: SearchOptions
    folder: Path
    limit: Budget

    def __call__(self, command: str) -> None:
        """Do it and write the results."""
        searching = before_writing(self.limit)
        with session(self.limit) as progress, contextlib.ExitStack() as ending:
            import jaxsr

            opened, more = None, {}
            if self.model is None:
                simulator, more = self._learned(searching, progress)
            else:
                if self.search.resume and self._is_done(command, progress):
                    return
                opened = self._opened(self.model, progress)
                ending.callback(opened.close)
                simulator = opened.simulator
            diagnosis = loaded(jaxsr.diagnose)(
                simulator,
                self.data,
                budget=searching,
                progress=progress,
                command=command,
                **self.search.keywords(),
            )
            if opened is not None:
                more = opened.written_back(diagnosis, self.folder)
        options = {"more": more} if more else {}
        save(diagnosis, self.folder, verdict_line(diagnosis), budget=self.limit, **options)
        for error in diagnosis.unread:
            what = f"{error.what}; what was found without it is in {self.folder}"
            raise InputError(what, error.where, error.remedy)

    def _is_done(self, command: str, progress: Progress) -> bool:
        """Return whether the folder holds what is asked for, and say what it holds."""
        import jaxsr
        from jaxsr._resume import Asked, earlier, why_anew

        folder, held_out = self.folder, self.search.held_out or []
        before = earlier(folder)
        if before is None:
            progress.stage(f"no diagnosis in {folder} yet: it begins")
            return False
        asked = Asked(command, str(self.model), self.data, held_out, jaxsr.__version__)
        why = why_anew(before, asked, folder)
        if why is not None:
            what = f"the diagnosis in {folder} {why}"
            progress.stage(f"{what}: it begins anew, with the time given now")
            return False
        RUN.get().outcome = f"the diagnosis in {folder} is whole"
        print_line(f"Verdict: {before['verdict']}. Complete in {folder}: nothing to do")
        return True

    def _learned(self, budget: Budget, progress: Progress) -> tuple[Any, dict[str, str]]:
        """Return the simulator behind its output, and its text under the name of a file."""
        import jaxsr
        from jaxsr.models import model_text

        learned = loaded(jaxsr.learn_simulator)(
            self.simulated,
            self.data,
            states=self.states,
            seed=self.search.seed,
            budget=budget,
            progress=progress,
        )
        return learned.simulator, {"learned.toml": model_text(learned.simulator.model)}

    def _opened(self, model: str, progress: Progress) -> Any:
        """Return the simulator that the command names, and say what was drafted for it."""
        import jaxsr
        from jaxsr.models.formats.opening import open_simulator

        read = jaxsr.Simulator.from_file
        opened = open_simulator(model, self.tables, self.data, self.folder, read)
        if opened.drafted is not None:
            progress.stage(f"drafted {opened.drafted}: what it assumes stands in it")
        return opened
