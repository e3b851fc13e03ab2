"""The command ``jaxsr discover``."""

from __future__ import annotations

from jaxsr._arguments import check_roles, results_folder
from jaxsr._discover_options import ColumnOptions, LawOptions, RunOptions
from jaxsr._job import command_budget, loaded, save, session
from jaxsr._options import Data, Job, Out, grouped


@grouped
def discover(data: Data, columns: ColumnOptions, law: LawOptions, run: RunOptions, out: Out) -> Job:
    """Find equations of motion in recordings."""
    validation, held_out = run.validation or [], run.held_out or []
    files = {
        **{"DATA": data, "--validation": validation, "--held-out": held_out},
        **{
            "--units": [law.units] if law.units else [],
            "--known": [law.known] if law.known else [],
        },
    }
    check_roles(files)
    law.check_modes()
    folder = results_folder(out, files, ("model.toml", "discovery.json", "report.html"))
    run.check_checkpoint(folder)
    roles, treated, prior = columns.roles(), columns.treated(), law.prior()
    limit = command_budget(run.budget)

    def job(command: str) -> None:
        with session(limit) as progress:
            import jaxsr
            from jaxsr.discovery.page import reserve

            found = loaded(jaxsr.discover)(
                data,
                jaxsr.Roles(**roles, treatment=jaxsr.Treatment(**treated)),
                prior=jaxsr.Prior(**prior),
                run=jaxsr.Run(
                    validation=validation,
                    held_out=held_out,
                    checkpoint=run.checkpoint,
                    seed=run.seed,
                    budget=reserve(limit, len(roles["states"]), len(held_out)),
                    progress=progress,
                    command=command,
                ),
            )
        save(found, folder, found.summary(), budget=limit)

    return job
