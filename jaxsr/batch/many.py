"""Many diagnoses, with their table and their page kept up to date."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from jaxsr._files import check_writable_directory
from jaxsr._progress import Progress, Silent
from jaxsr._result import InputError
from jaxsr.batch.cases import Case, check_name, read_cases
from jaxsr.batch.engine import Engine, Stop, never
from jaxsr.batch.fleet import Fleet
from jaxsr.batch.task import DONE, Outcome, Task


def diagnose_many(
    cases: str | Path | Mapping[str, Case],
    out: str | Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    stop: Stop = never,
) -> Fleet:
    """Diagnose many machines or recordings, each in a process of its own.

    The files of a case are those of ``jaxsr diagnose`` by itself, byte for byte but for seconds.

    Parameters
    ----------
    cases : path or mapping of str to Case
        CASES.toml, or the cases by name.
    out : path
        Every case gets a folder in it; ``batch.csv`` and ``batch.html`` are over all.
    workers : int
        Cases at a time on this machine; more than one needs Dask.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers see the same files under the same paths.
    resume : bool
        Leave out cases that are done: the same options on the same files.
    progress : Progress, optional
    stop : callable
        Whether to end now; cases that run give the best so far.

    Returns
    -------
    Fleet
        A case that failed was tried twice, unless its input was refused.

    Raises
    ------
    InputError
        A case names a file that is not there, `out` cannot be written, or Dask is missing.
    """
    table = cases if isinstance(cases, Mapping) else read_cases(cases)
    if workers < 1:
        raise InputError(f"{workers} workers", "--workers", "Give 1 or more")
    if not table:
        raise InputError("no case", "cases", "Give one")
    folder, progress = str(out), progress or Silent()
    for name, case in table.items():
        check_name(name)
        case.check()
    check_writable_directory(Path(folder))
    tasks = [Task(name, case, folder, os.getcwd()) for name, case in table.items()]
    fleet = Fleet(Path(folder), tuple(table), {}, {})
    for task in tasks:
        if resume and task.is_done():
            fleet = fleet.with_outcome(Outcome(task.name, DONE))
        else:
            task.mark.unlink(missing_ok=True)
    if fleet.outcomes:
        progress.stage(f"{len(fleet.outcomes)} of {len(tasks)} cases are done already")
    engine = Engine(workers, scheduler, stop)
    first = [task for task in tasks if task.name not in fleet.outcomes]
    for outcome in engine.outcomes(first):
        fleet = fleet.with_outcome(outcome)
        fleet.write()
        count = f"{len(fleet.outcomes)} of {len(tasks)}"
        progress.stage(f"{count}: {outcome.name}: {outcome.message or 'done'}")
    again = [t for t in tasks if t.name in fleet.outcomes and fleet.outcomes[t.name].repeatable]
    for outcome in engine.outcomes(again):
        fleet = fleet.with_outcome(outcome)
        progress.stage(f"tried again: {outcome.name}: {outcome.message or 'done'}")
    fleet.write()
    return fleet
