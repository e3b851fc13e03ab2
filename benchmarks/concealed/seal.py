"""Draw planted cases: ``python -m benchmarks.concealed.seal --seed S --cases N --out DIR``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.concealed.sealing import seal, seed_of
from jaxsr._result import InputError


def main(arguments: list[str] | None = None) -> int:
    """Seal cases and print the truth's checksum."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.concealed.seal", description=__doc__
    )
    parser.add_argument("--seed", required=True, help="a whole number, or commit")
    parser.add_argument("--cases", type=int, required=True, metavar="N")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args(arguments)
    try:
        if options.cases < 1 or options.jobs < 1:
            raise InputError("must be at least 1", "--cases and --jobs")
        seed = seed_of(options.seed)
        digest = seal(seed, options.cases, options.out, options.jobs)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    print(f"seed {seed}\ntruth sha256 {digest}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
