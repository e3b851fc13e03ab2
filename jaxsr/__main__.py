"""Run the commands with ``python -m jaxsr``, or as the program ``jaxsr``."""

import sys

from jaxsr._process import listen


def main() -> int:
    """Run the command of this process and return its exit status."""
    listen()  # before the imports, which take seconds on a busy machine
    from jaxsr.cli import main as run

    return run()


if __name__ == "__main__":
    sys.exit(main())
