"""The commands ``jaxsr discover | diagnose | batch | monitor | simulate | export | demo | ...``.

Parsing and checking come first, inside typer; the job runs afterwards, outside of it, and imports
what it needs: ``jaxsr --help`` loads no numerical library.
"""

from __future__ import annotations

import contextlib
import shlex
import sys
import traceback
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from jaxsr._arguments import expand_file_lists
from jaxsr._batch_command import batch
from jaxsr._datasets_app import datasets_app
from jaxsr._demo_command import demo
from jaxsr._diagnose_command import diagnose
from jaxsr._discover_command import discover
from jaxsr._export_command import export
from jaxsr._job import RUN
from jaxsr._monitor_command import monitor
from jaxsr._options import Job
from jaxsr._output import close_stdout, print_line
from jaxsr._process import INTERRUPTED, listen, listening, say
from jaxsr._result import InputError
from jaxsr._simulate_command import simulate

OK, DEFECT, WRONG_USE = 0, 1, 2

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Equations of motion from recordings, and the physics that a simulator left out.",
)
app.add_typer(datasets_app, name="datasets")


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


for command in (discover, diagnose, simulate, batch, monitor, export, demo):
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
