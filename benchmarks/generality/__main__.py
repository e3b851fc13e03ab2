"""How far a diagnosis carries: planted cases of systems, sensing and mechanisms in groups.

    python -m benchmarks.generality [--out DIR] [--seed S] [--per-system N] [--jobs N]
                                    [--engine NAME ...] [--system NAME ...] [--budget SECONDS]
    python -m benchmarks.generality --score DIR [DIR ...]     # what was answered, without a run
    python -m benchmarks.generality --quick

Answers stand in DIR/answers.jsonl, a line each; a run goes on where it stopped. The scores go to
benchmarks/results/generality.json.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.generality.engines import BUDGET, ENGINES
from benchmarks.generality.plan import Ticket, dealt
from benchmarks.generality.running import answers, begun, gathered, made, run, seed_of, truth_of
from benchmarks.generality.scoring import common, marks, misses, plain, scored, settled_on, table
from benchmarks.generality.systems import SYSTEMS
from benchmarks.generality.tables import by_group, missed, side_by_side
from benchmarks.provenance import write
from jaxsr._result import InputError

OUT = Path("generality")
QUICK = (
    ("evidence", Ticket("quick-friction", "cart_pendulum", "encoder", "friction"), 160),
    ("diagnosis", Ticket("quick-nothing", "dc_motor", "white", "nothing"), 160),
)
QUICK_SECONDS = 6.0


def scores(folders: list[Path]) -> tuple[dict[str, Any], str]:
    """Return the scores of what was answered in some folders, and their text."""
    items = []
    for folder in folders:
        rows = answers(folder)
        truths = {r["case"]: truth_of(folder, r["case"]) for r in rows}
        items += scored(truths, rows, settled_on())
    found, both, wrong = table(items), common(items), misses(items)
    document = {
        "settled_on": settled_on(),
        "common": plain(table(both)),
        "table": plain(found),
        "misses": wrong,
    }
    parts = [f"All answers of each engine\n\n{side_by_side(found)}", by_group(found)]
    if both and len(found) > 1:
        parts.insert(0, f"Cases that every engine answered\n\n{side_by_side(table(both))}")
    text = "\n\n".join([*parts, "Misses", missed(wrong)])
    return {**document, "marks": marks(items)}, text


def quick() -> int:
    """Make and answer two small cases."""
    with tempfile.TemporaryDirectory() as name:
        out = Path(name)
        for engine, ticket, samples in QUICK:
            made(ticket, 1, out, samples)
            run(out, 1, [ticket], [engine], QUICK_SECONDS)
        document, text = scores([out])
    print(text)
    return int(any(row["broke"] for row in document["misses"]))


def main(arguments: list[str] | None = None) -> int:
    """Run; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.generality",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", type=Path, default=OUT, metavar="DIR")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--per-system", type=int, default=1, metavar="N")
    parser.add_argument("--jobs", type=int, default=1, metavar="N")
    parser.add_argument("--engine", nargs="+", default=list(ENGINES), choices=list(ENGINES))
    parser.add_argument("--system", nargs="+", default=[], choices=list(SYSTEMS), metavar="NAME")
    parser.add_argument("--budget", type=float, default=BUDGET, metavar="SECONDS")
    parser.add_argument("--score", nargs="+", type=Path, default=[], metavar="DIR")
    parser.add_argument("--no-result", action="store_true", help="leave the results file alone")
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args(arguments)
    if options.quick:
        return quick()
    folders = options.score
    if not folders:
        try:
            begun(options.out, options.seed)
        except InputError as error:
            print(error, file=sys.stderr)
            return 2
        tickets = dealt(options.seed, options.per_system, options.system)
        run(options.out, options.seed, tickets, options.engine, options.budget, options.jobs)
        gathered(options.out)
        folders = [options.out]
    document, text = scores(folders)
    print(text)
    if not options.no_result:
        write("generality", "planted cases in groups", [seed_of(f) for f in folders], document)
    return 0


if __name__ == "__main__":
    sys.exit(main())
