"""Seal, run and score a few tiny cases: ``python -m benchmarks.concealed --quick``."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from benchmarks.concealed import run, score
from benchmarks.concealed.sealing import seal

SEED, CASES, SECONDS, JOBS = 222, 3, 5.0, 2


def main(arguments: list[str] | None = None) -> int:
    """Go once through everything, small."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.concealed", description=__doc__)
    parser.add_argument("--quick", action="store_true", required=True)
    parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print("truth sha256", seal(SEED, CASES, folder, tiny=True))
        for words in (
            run.main([name, "--limit", f"{SECONDS:g}", "--jobs", f"{JOBS}"]),
            score.main([name]),
        ):
            if words:
                return words
    return 0


if __name__ == "__main__":
    sys.exit(main())
