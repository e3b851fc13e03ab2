"""Diagnose sealed cases: ``python -m benchmarks.concealed.run DIR [--jobs 1] [--limit SECONDS]``.

What is done is not done again. With --baselines the baselines run in place of the tool.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.concealed.running import run
from jaxsr._result import InputError


def main(arguments: list[str] | None = None) -> int:
    """Run the tool or the baselines on all cases that have no answer yet."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.concealed.run", description=__doc__)
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--limit", type=float, default=120.0, metavar="SECONDS")
    parser.add_argument("--again", action="store_true", help="run cases again that failed")
    parser.add_argument("--baselines", action="store_true")
    parser.add_argument("--only", nargs="*", default=[], metavar="CASE")
    options = parser.parse_args(arguments)
    chosen = None
    if options.baselines:
        from benchmarks.concealed.baselines import BASELINES

        chosen = BASELINES
    try:
        if options.jobs < 1 or not options.limit > 0:
            raise InputError("must be positive", "--jobs and --limit")
        count = run(
            options.folder, options.limit, options.jobs, options.again, chosen, options.only
        )
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    print(f"{count} runs")
    return 0


if __name__ == "__main__":
    sys.exit(main())
