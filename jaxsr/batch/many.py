"""Many diagnoses, with their table and their page kept up to date."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from jaxsr._files import check_writable_directory
from jaxsr._progress import Progress, Silent
from jaxsr._result import InputError
from jaxsr.batch.board import Board
from jaxsr.batch.cases import check_name
from jaxsr.batch.engine import Engine, Stop, never
from jaxsr.batch.fleet import Fleet
from jaxsr.batch.listing import AnyCase, read_cases
from jaxsr.batch.tally import Tally
from jaxsr.batch.task import DONE, Outcome


def diagnose_many(
    cases: str | Path | Mapping[str, AnyCase],
    out: str | Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    stop: Stop = never,
) -> Fleet:
    """Diagnose many machines or recordings, each in a process of its own.

    The files of a case are those of ``jaxsr diagnose`` by itself, byte for byte but for seconds;
    those of a search that of ``jaxsr discover`` from the best of its seeds.

    Parameters
    ----------
    cases : path or mapping of str to Case or Islands
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
        A case names a file that is not there, `out` cannot be written, Dask is missing, or its
        scheduler is gone: what is done stays, and `resume` goes on.
    """
    table = cases if isinstance(cases, Mapping) else read_cases(cases)
    if workers < 1:
        raise InputError(f"{workers} workers", "--workers", "Give 1 or more")
    if not table:
        raise InputError("no case", "cases", "Give one")
    folder = str(out)
    for name, case in table.items():
        check_name(name)
        case.check()
    check_writable_directory(Path(folder))
    board = Board.of(table, folder)
    for task in board.tasks:
        if resume and task.is_done():
            board.end(Outcome(task.name, DONE))
        else:
            task.mark.unlink(missing_ok=True)
    tally = Tally(progress or Silent(), board)
    engine = Engine(workers, scheduler, stop, tally.run)
    left, again = [task for task in board.tasks if task.name not in board.ended], False
    while left:
        for outcome in engine.outcomes(left):
            repeated = board.end(outcome)
            tally.end(outcome, repeated)
            board.write_now_and_then()
        # What failed is tried once more.
        ended = [board.ended.get(task.name) for task in left]
        left = [t for t, o in zip(left, ended, strict=True) if o and o.repeatable and not again]
        again = True
    board.fleet.write()
    return board.fleet
