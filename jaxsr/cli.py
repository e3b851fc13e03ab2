"""The commands ``jaxsr discover | diagnose | batch | monitor | simulate | export | demo | ...``.

Parsing and checking come first, inside typer; the job runs afterwards, outside of it, and imports
what it needs: ``jaxsr --help`` loads no numerical library.
"""

from __future__ import annotations

import contextlib
import os
import shlex
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from jaxsr._arguments import (
    check_roles,
    expand_file_lists,
    is_model,
    model_and_data,
    results_folder,
    split_names,
    split_pairs,
    table_of,
    written_back,
)
from jaxsr._batch_command import batch
from jaxsr._datasets_app import datasets_app
from jaxsr._demo_command import demo
from jaxsr._export_command import export
from jaxsr._job import RUN, before_writing, command_budget, loaded, save, session, verdict_line
from jaxsr._monitor_command import monitor
from jaxsr._output import close_stdout, print_line
from jaxsr._process import INTERRUPTED, listen, listening, say
from jaxsr._result import InputError

OK, DEFECT, WRONG_USE = 0, 1, 2

Job = Callable[[str], None]  # of the command line, for the provenance

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Equations of motion from recordings, and the physics that a simulator left out.",
)
app.add_typer(datasets_app, name="datasets")

Data = Annotated[list[str], typer.Argument(metavar="DATA...", help="Recordings to learn from.")]
Out = Annotated[str, typer.Option(metavar="DIR", help="Directory for the results.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of every random choice.")]
Seconds = Annotated[float | None, typer.Option("--budget", metavar="SECONDS", help="Time limit.")]
HeldOut = Annotated[
    list[str] | None,
    typer.Option(metavar="FILE...", help="Recordings opened once, at the end, to report the fit."),
]
FalseClaim = Annotated[
    float | None,
    typer.Option(
        metavar="NUMBER",
        min=0.0,
        help="What a wrong verdict costs, against abstaining (20): a verdict is given where it is "
        "so many times as probable as all others.",
    ),
]
States = Annotated[str | None, typer.Option(metavar="z1,z2", help="Columns that are states.")]
Table = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="FILE.toml",
        help="With file.py:function, the model file that stands on it, such as an explained.toml; "
        "with robot.xml or plant.fmu, its sidecar; file.toml, robot.toml or plant.toml by default.",
    ),
]


def _show_version(asked: bool) -> None:
    if asked:
        from jaxsr import __version__

        print_line(f"jaxsr {__version__}")
        raise typer.Exit()


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Take the options that stand before a command."""


@app.command()
def discover(
    data: Data,
    states: Annotated[str, typer.Option(metavar="z1,z2", help="Columns that are states.")],
    out: Out,
    derivatives: Annotated[
        str | None, typer.Option(metavar="dz1,dz2", help="Columns of their derivatives.")
    ] = None,
    order: Annotated[int, typer.Option(min=1, max=2, help="2: the states are displacements.")] = 1,
    inputs: Annotated[str | None, typer.Option(metavar="u1", help="Columns of inputs.")] = None,
    time: Annotated[str | None, typer.Option(metavar="t", help="Column of time.")] = None,
    columns: Annotated[
        list[str] | None,
        typer.Option(metavar='z1="Angle/rad"', help="Names in the equations, and their columns."),
    ] = None,
    units: Annotated[
        str | None, typer.Option(metavar="FILE", help="TOML with a [units] table.")
    ] = None,
    known: Annotated[
        str | None, typer.Option(metavar="FILE", help="Model file of the known part.")
    ] = None,
    validation: Annotated[
        list[str] | None, typer.Option(metavar="FILE...", help="Recordings to choose a model by.")
    ] = None,
    held_out: HeldOut = None,
    modes: Annotated[str, typer.Option(metavar="auto|N", help="Number of modes.")] = "auto",
    seed: Seed = 0,
    budget: Seconds = None,
) -> Job:
    """Find equations of motion in recordings."""
    extra = {"--units": [units] if units else [], "--known": [known] if known else []}
    roles = {"DATA": data, "--validation": validation or [], "--held-out": held_out or [], **extra}
    check_roles(roles)
    if modes != "auto" and not (modes.isascii() and modes.isdigit() and int(modes) > 0):
        raise InputError(f"must be auto or a whole number above 0, got {modes!r}", "--modes")
    folder = results_folder(out, roles, ("model.toml", "discovery.json", "report.html"))
    names = split_names(states, "--states")
    rates = split_names(derivatives, "--derivatives") or None
    driving = split_names(inputs, "--inputs")
    pairs = split_pairs(columns, "--columns")
    if rates and len(rates) != len(names):
        raise InputError(f"{len(rates)} names for {len(names)} states", "--derivatives")
    limit = command_budget(budget)

    def job(command: str) -> None:
        with session() as progress:
            import jaxsr
            from jaxsr.discovery.page import reserve

            found = loaded(jaxsr.discover)(
                data,
                jaxsr.Roles(names, rates, order, driving, time, columns=pairs),
                prior=jaxsr.Prior(units=units, known=known, modes=modes),
                run=jaxsr.Run(
                    validation=validation or [],
                    held_out=held_out or [],
                    seed=seed,
                    budget=reserve(limit, len(names), len(held_out or [])),
                    progress=progress,
                    command=command,
                ),
            )
        save(found, folder, found.summary(), budget=limit)

    return job


@app.command()
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
    simulated: Annotated[
        list[str] | None,
        typer.Option(metavar="FILE...", help="What the simulator gave, a file for each of DATA."),
    ] = None,
    states: States = None,
    held_out: HeldOut = None,
    table: Table = None,
    seed: Seed = 0,
    budget: Seconds = None,
    false_claim_cost: FalseClaim = None,
) -> Job:
    """Find where a simulator differs from recordings, and name what was left out."""
    model, data = model_and_data(arguments, simulated, states)
    tables = table_of(model, table)
    roles = {
        "MODEL": [model] if model is not None and ".py:" not in model else [],
        **{"--model": tables},
        **{"DATA": data, "--simulated": simulated or [], "--held-out": held_out or []},
    }
    check_roles(roles)
    written = ("explained.toml", "diagnosis.json", "report.html")
    written += (() if model else ("learned.toml",)) + written_back(model)
    folder = results_folder(out, roles, written)
    named = split_names(states, "--states")
    limit = command_budget(budget)
    searching = before_writing(limit)
    costs = {} if false_claim_cost is None else {"false_claim_cost": false_claim_cost}

    def job(command: str) -> None:
        with session() as progress, contextlib.ExitStack() as ending:
            import jaxsr

            learnt: dict[str, Any] = {}
            if model is None:
                from jaxsr.models import model_text

                learned = loaded(jaxsr.learn_simulator)(
                    simulated or [],
                    data,
                    states=named,
                    seed=seed,
                    budget=searching,
                    progress=progress,
                )
                simulator = learned.simulator
                learnt = {"more": {"learned.toml": model_text(simulator.model)}}
            else:
                from jaxsr.models.formats.opening import open_simulator

                read = jaxsr.Simulator.from_file
                opened = open_simulator(model, tables, data, folder, read)
                ending.callback(opened.close)
                simulator = opened.simulator
                if opened.drafted is not None:
                    progress.stage(f"drafted {opened.drafted}: what it assumes stands in it")
            diagnosis = loaded(jaxsr.diagnose)(
                simulator,
                data,
                held_out=held_out or [],
                seed=seed,
                budget=searching,
                progress=progress,
                command=command,
                **costs,
            )
            if model is not None and (texts := opened.written_back(diagnosis, folder)):
                learnt = {"more": texts}
        save(diagnosis, folder, verdict_line(diagnosis), budget=limit, **learnt)
        for error in diagnosis.unread:
            what = f"{error.what}; what was found without it is in {folder}"
            raise InputError(what, error.where, error.remedy)

    return job


@app.command()
def simulate(
    model: Annotated[
        str,
        typer.Argument(metavar="MODEL", help="A .toml, robot.xml, plant.fmu, or file.py:function."),
    ],
    out: Annotated[str, typer.Option(metavar="FILE.csv", help="File for the outputs.")],
    data: Annotated[
        str | None, typer.Argument(metavar="[DATA]", help="Recording with the inputs.")
    ] = None,
    duration: Annotated[float | None, typer.Option(help="Seconds, without DATA.")] = None,
    dt: Annotated[float | None, typer.Option(help="Seconds between rows, without DATA.")] = None,
    table: Table = None,
) -> Job:
    """Run a model freely, with recorded inputs or without any."""
    if not is_model(model):
        raise InputError(
            "is not a model", model, "Name a .toml, robot.xml or file.py:function first"
        )
    if data is None and (duration is None or dt is None):
        raise InputError("no DATA to follow", "", "Give DATA, or both --duration and --dt")
    if data is not None and not (duration is None and dt is None):
        raise InputError("--duration and --dt are for runs without DATA", "", "Leave them out")
    for option, value in (("--duration", duration), ("--dt", dt)):
        if value is not None and not 0 < value < float("inf"):
            raise InputError(f"must be positive seconds, got {value}", option)
    inputs = ([model] if ".py:" not in model else []) + ([data] if data is not None else [])
    tables = table_of(model, table)
    check_roles({"MODEL": inputs[:1], "--model": tables, "DATA": inputs[1:]})
    inputs += tables
    target = Path(out)
    if any(Path(path).resolve() == target.resolve() for path in inputs):
        raise InputError("would overwrite an input", f"--out {out}", "Name another file")
    if os.path.isdir(target):
        raise InputError("is a directory", f"--out {out}", "Name a file, such as run.csv")

    def job(command: str) -> None:
        from jaxsr._files import atomic_write_text, check_writable

        check_writable(target)
        import jaxsr
        from jaxsr.models.formats.opening import open_simulator, simulated_table

        opened = open_simulator(model, tables, [data] if data is not None else [])
        with contextlib.closing(opened):
            if opened.drafted is not None:
                say(f"drafted {opened.drafted}: what it assumes stands in it")
            recording = None
            if data is not None:
                given = opened.simulator.model
                recording = jaxsr.read_recording(
                    data, time=given.columns.get(given.time), sample_time=given.sample_time
                )
            run = simulated_table(opened, recording, duration, dt)
        atomic_write_text(target, run.to_csv(index=False, lineterminator="\n"))
        RUN.get().outcome = f"{target} is whole"
        print_line(f"{len(run)} rows in {target}")

    return job


for command in (batch, monitor, export, demo):
    app.command()(command)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments after the program's name; those of the process by default.

    Returns
    -------
    int
        0 the job ran, 2 wrong use or unreadable input, 130 interrupted, 1 a defect of jaxsr.
    """
    if argv is None:
        listen()  # this process is the command and nothing else
    with listening() as run:
        token = RUN.set(run)
        try:
            status = _status(sys.argv[1:] if argv is None else list(argv))
        except KeyboardInterrupt:
            status = INTERRUPTED
        finally:
            RUN.reset(token)
    if status == INTERRUPTED or (status == OK and run.asked.is_set()):
        say(f"interrupted; {run.outcome}")
        return INTERRUPTED
    return status


def _status(given: list[str]) -> int:
    """Run a command and return its exit status, but for interruptions."""
    try:
        asked = given if given not in ([], ["datasets"]) else [*given, "--help"]
        arguments = expand_file_lists(asked)
        command = typer.main.get_command(app)
        outcome: Any = command.main(args=arguments, prog_name="jaxsr", standalone_mode=False)
        if outcome is None or isinstance(outcome, int):  # --help
            status = outcome or OK
            sys.stdout.flush()  # a closed pipe is noticed here, not at exit
            return status
        job: Job = outcome
        job(shlex.join(["jaxsr", *given]))
        return OK
    except InputError as error:
        return _wrong_use(str(error))
    except BrokenPipeError:  # the reader of our output left, as in `jaxsr --help | head -1`
        close_stdout()
        return OK
    except Exception as error:
        # typer's usage errors; older releases take their classes from click, newer from inside.
        message = getattr(error, "format_message", None)
        if callable(message):
            return _wrong_use(str(message()))
        with contextlib.suppress(OSError):  # a terminal that closed
            traceback.print_exc()
        say("this is a defect of jaxsr, please report it")
        return DEFECT


def _wrong_use(message: str) -> int:
    say(f"error: {' '.join(message.split())}")
    return WRONG_USE
