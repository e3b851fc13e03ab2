"""What a committed result says of itself: machine, versions, seeds, command."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jaxsr
from jaxsr._files import atomic_write_text, dump_json

ROOT = Path(__file__).resolve().parents[1]
RESULTS = Path(__file__).parent / "results"
_PACKAGES = ("jax", "numpy", "scipy", "sympy", "pyoperon", "pysindy")


def versions() -> dict[str, str]:
    """Return the commit of the engine, and the versions of Python and of what is installed."""
    out = {"jaxsr": jaxsr.__version__, "commit": engine(), "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            out[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            out[name] = "not installed"
    return out


def machine() -> str:
    """Return processor, system and number of cores in a line."""
    return f"{platform.machine()}, {platform.system()}, {os.cpu_count()} cores"


def engine() -> str:
    """Return the commit of the code that runs, or "" where there is none."""
    words = ["git", "-C", str(ROOT), "log", "-1", "--format=%h", "--", "jaxsr"]
    done = subprocess.run(words, capture_output=True, text=True)
    return done.stdout.strip()


def origin_of(seed: int) -> dict[str, Any]:
    """Return seed, versions and machine of a run in one flat row."""
    return {
        "seed": seed,
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in ("jax", "numpy")},
        "jaxsr": jaxsr.__version__,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
    }


def write(name: str, title: str, seeds: Sequence[int], body: dict[str, Any]) -> None:
    """Write ``results/NAME.json``: the title, the body, seeds, versions, machine."""
    document = {
        "case": title,
        **body,
        "seeds": list(seeds),
        "versions": versions(),
        "machine": machine(),
        # above the number of cores, other work slowed this one down
        "load_average": [round(x, 1) for x in os.getloadavg()]
        if hasattr(os, "getloadavg")
        else None,
    }
    atomic_write_text(RESULTS / f"{name}.json", dump_json(document))
    print(f"written: benchmarks/results/{name}.json")
