"""Score answers: ``python -m benchmarks.concealed.score DIR [--out DIR]``.

Writes score.json, score.md and the figures; refuses a truth that is not the one sealed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.concealed.figures import draw
from benchmarks.concealed.scoring import score
from benchmarks.concealed.tables import markdown
from jaxsr._files import atomic_write_text, dump_json
from jaxsr._result import InputError


def main(arguments: list[str] | None = None) -> int:
    """Score every method that has answers."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.concealed.score", description=__doc__
    )
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("--out", type=Path, default=None, metavar="DIR")
    options = parser.parse_args(arguments)
    try:
        document = score(options.folder)
        if not document["methods"]:
            raise InputError("holds no answers", str(options.folder), "Run the cases first")
        out = options.out or options.folder / "score"
        text = markdown(document)
        draw(document, out)
        atomic_write_text(out / "score.json", dump_json(document))
        atomic_write_text(out / "score.md", text)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    print(text.split("\n## Failures")[0])
    return 0


if __name__ == "__main__":
    sys.exit(main())
