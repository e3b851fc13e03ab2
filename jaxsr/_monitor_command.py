"""The command ``jaxsr monitor``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from jaxsr._arguments import check_roles, results_folder
from jaxsr._job import RUN, loaded, session
from jaxsr._output import print_line
from jaxsr._result import InputError


def monitor(
    model: Annotated[
        str, typer.Argument(metavar="RESULT", help="A folder of results, or an explained.toml.")
    ],
    data: Annotated[
        list[str], typer.Argument(metavar="DATA...", help="Recordings, or folders of them.")
    ],
    normal: Annotated[
        list[str], typer.Option(metavar="FILE...", help="Recordings of normal running.")
    ],
    out: Annotated[str, typer.Option(metavar="DIR", help="Directory for the results.")],
    rate: Annotated[
        float, typer.Option(metavar="PER_HOUR", help="False alarms per hour, at most.")
    ] = 0.1,
    follow: Annotated[bool, typer.Option("--follow", help="Wait for files that come.")] = False,
    diagnose: Annotated[
        bool, typer.Option("--diagnose", help="Diagnose the stretch behind an alarm.")
    ] = False,
    budget: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Time limit of each diagnosis.")
    ] = None,
) -> Callable[[str], None]:
    """Say when a machine stops following its model."""
    table = Path(model) / "explained.toml" if Path(model).is_dir() else Path(model)
    files = [d for d in data if not Path(d).is_dir()]
    roles = {"RESULT": [str(table)], "--normal": normal, "DATA": files}
    check_roles(roles)
    if not rate > 0.0:
        raise InputError(f"must be above 0, got {rate}", "--rate")
    if budget is not None and not diagnose:
        raise InputError("--budget is that of --diagnose", "", "Give both, or none")
    folder = results_folder(out, roles, ("monitor.json",))

    def job(command: str) -> None:
        run = RUN.get()
        with session() as progress:
            import jaxsr
            from jaxsr.monitoring.folder import recordings
            from jaxsr.monitoring.journal import Journal

            progress.stage("learning what is normal")
            watch = loaded(jaxsr.monitor)(table, normal, false_alarms_per_hour=rate)
            progress.stage(repr(watch)[1:-1])
            journal = Journal(watch, folder, command)
            run.outcome = f"what was judged is in {folder}"
            for path in recordings([Path(d) for d in data], follow, run.asked.is_set):
                progress.stage(f"judging {path.name}")
                alarms = journal.judge(path)
                if str(path) in journal.skipped:
                    progress.stage(f"left out: {journal.skipped[str(path)]}")
                for alarm in alarms[:1]:
                    print_line(alarm.sentence + _more(len(alarms) - 1))
                    if diagnose:
                        print_line(f"  {journal.diagnose(alarm, path, budget)}")
        print_line(f"{journal.sentence}: {folder / 'monitor.json'}")
        if journal.skipped and not journal.files:
            raise InputError(next(iter(journal.skipped.values())), "")

    return job


def _more(count: int) -> str:
    return f" (and {count} more in this file)" if count else ""
