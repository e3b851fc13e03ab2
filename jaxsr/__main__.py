"""Run the commands with ``python -m jaxsr``, or as the program ``jaxsr``."""

import atexit
import contextlib
import os
import sys
from typing import NoReturn

from jaxsr._process import listen


def main() -> int:
    """Run the command of this process and return its exit status."""
    listen()  # before the imports, which take seconds on a busy machine
    from jaxsr.cli import main as run

    return run()


def program() -> NoReturn:
    """Run the command of this process, and end it there.

    To take down what numerical libraries have built up takes an interpreter most of a second,
    which no budget knows of: what is registered to be done at the end is done, and no more.
    """
    status = main()
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            stream.flush()
    os._exit(status)


if __name__ == "__main__":
    program()
