"""Searches run again with other last digits: whether they find the same laws.

    python -m benchmarks.search_reruns [--quick] [--seeds N]

Three laws with noise beside columns of a known model, each search twice: as it is, and with target
and columns changed by 1e-15 of themselves, as another processor's sums are. *Digits left out* is
the search as it is; *all digits*, the ablation, compares losses and keeps constants to their last
digit. Results: ``results/search_reruns.json``; --quick (four searches, no file) fails where fewer
than two are the same.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterator
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.provenance import write
from jaxsr.evolution import SearchConfig, polish, propose
from jaxsr.evolution.config import SizeLimits
from jaxsr.evolution.propose import Proposal

SEEDS, QUICK = 30, 4
OFF = 1e-15
ROWS, NOISE = 300, 0.05
CONFIG = SearchConfig(population=60, generations=12, sizes=SizeLimits(terms=2))
LEFT_OUT, ALL = "digits left out", "all digits"


def found(seed: int, off: float) -> list[Proposal]:
    """Search for a law whose rows differ by a share `off` of themselves."""
    rng = np.random.default_rng([91, seed])
    x, v = rng.normal(size=(2, ROWS))
    law = (v / (1.0 + v**2), x**3 - 2.0 * v, np.abs(v) * v / (1.0 + x**2))[seed % 3]
    y = law + NOISE * rng.normal(size=ROWS)
    fixed = np.stack([x, 0.5 * x + 0.1 * rng.normal(size=ROWS)], axis=1)
    y, fixed = (a * (1.0 + off * rng.normal(size=a.shape)) for a in (y, fixed))
    return propose(np.random.default_rng(seed), y, {"x": x, "v": v}, fixed=fixed, config=CONFIG)


def same(seed: int) -> bool:
    """Whether both searches end with the same terms, constants included."""
    once, again = found(seed, 0.0), found(seed, OFF)
    return [p.terms for p in once] == [p.terms for p in again]


@contextlib.contextmanager
def all_digits() -> Iterator[None]:
    """Compare and keep numbers as they are."""

    def whole(values: Any, bits: int = 0) -> Any:
        return values

    with contextlib.ExitStack() as stack:
        for name, module in list(sys.modules.items()):
            if name.startswith("jaxsr.") and hasattr(module, "rounded"):
                stack.enter_context(patch.object(module, "rounded", whole))
        stack.enter_context(patch.object(polish, "CONSTANT_BITS", ()))
        yield


def main() -> int:
    """Run, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="four searches, no file")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="searches")
    given = parser.parse_args()
    if given.quick:
        count = sum(map(same, range(QUICK)))
        print(f"{LEFT_OUT}: the same laws in {count} of {QUICK}")
        return int(count < QUICK // 2)
    rows = []
    for way in (LEFT_OUT, ALL):
        with all_digits() if way == ALL else contextlib.nullcontext():
            rows += [{"way": way, "seed": k, "same": same(k)} for k in range(given.seeds)]
        print(f"{way}: the same laws in {sum(r['same'] for r in rows if r['way'] == way)}")
    summary = {
        way: {"same": sum(r["same"] for r in rows if r["way"] == way), "of": given.seeds}
        for way in (LEFT_OUT, ALL)
    }
    body = {"off": OFF, "summary": summary, "rows": rows}
    write("search_reruns", "searches with other last digits", list(range(given.seeds)), body)
    return 0


if __name__ == "__main__":
    sys.exit(main())
