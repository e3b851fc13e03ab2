"""Errors of the register machine's functions in float32, over the whole range of the type."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxsr.evaluation import elementary
from jaxsr.expressions.primitives import PRIMITIVES

UNIT = 2.0**-24
LEAST = 2.0**-126  # smallest normal float32


def arguments(step: int = 4099) -> NDArray[np.float32]:
    """Return every ``step``-th float32 there is, zero and normal numbers of both signs."""
    x = np.arange(0, 2**32, step, dtype=np.uint64).astype(np.uint32).view(np.float32)
    return x[np.isfinite(x) & ((np.abs(x) >= LEAST) | (x == 0))]


def largest_error(name: str, *given: NDArray[np.float32]) -> float:
    """Return the largest relative error against float64, in units of 2^-24."""
    with np.errstate(all="ignore"):
        truth = PRIMITIVES[name].numpy(*(a.astype(np.float64) for a in given))
    size = np.abs(truth)
    normal = np.isfinite(truth) & (size >= LEAST) & (size < 3.4e38)
    found = elementary.evaluate(name, *given).astype(np.float64)
    return float(np.max(np.abs(found[normal] / truth[normal] - 1.0))) / UNIT


def measure(seed: int) -> dict[str, Any]:
    """Measure every function whose error is stated."""
    rng, whole = np.random.default_rng(seed), arguments()
    out = {}
    for name, stated in elementary.ERRORS.items():
        given = [rng.choice(whole, 500_000) for _ in range(elementary.arity(name))]
        if name == "pow":
            given = [np.abs(given[0]), rng.uniform(-5.0, 5.0, len(given[0])).astype(np.float32)]
        if len(given) == 1:
            given = [whole]
        out[name] = {"stated": stated, "measured": largest_error(name, *given)}
    words = (f"{n} {e['measured']:.2f}/{e['stated']:g}" for n, e in out.items())
    print(f"relative error, measured/stated, in 2^-24: {', '.join(words)}")
    return out
