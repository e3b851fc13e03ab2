"""Run snippets on hostile files one after the other in a child process, watched.

A file may hang the process, or end it; the parent notices, and goes on with the next one in a new
process. Usage of the child: ``python shared_cases.py FOLDER...``, with a line before and after
each folder on stdout.
"""

from __future__ import annotations

import json
import selectors
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
STARTING = 60.0
"""Seconds that the import may take on a busy machine."""
LIMIT = 10.0
"""Seconds after which a file has hung the child; `SLOW` is what it may take."""
SLOW = 2.0


@dataclass(frozen=True)
class Result:
    """What a folder's snippet came to: ``ok``, an exception's name, ``hang`` or ``died``."""

    name: str
    end: str
    message: str = ""
    seconds: float = 0.0


def snippet(folder: Path) -> str:
    """Return the Python of ``cmd.sh``; a folder without one reads and writes its model."""
    command = folder / "cmd.sh"
    if not command.exists():
        return "from jaxsr.models import *; parse_model(model_text(read_model('m.toml')))"
    return command.read_text().partition('python -c "')[2].rpartition('"')[0]


def run_all(folders: Sequence[Path]) -> dict[str, Result]:
    """Run every folder's snippet and return results by the folder's name."""
    results: dict[str, Result] = {}
    left = list(folders)
    while left:
        done = _run_until_broken(left)
        results |= {r.name: r for r in done}
        if not done:
            raise RuntimeError("the child does not start")
        left = [f for f in left if f.name not in results]
    return results


def _run_until_broken(folders: Sequence[Path]) -> list[Result]:
    child = subprocess.Popen(
        [sys.executable, __file__, *map(str, folders)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert child.stdout is not None
    results: list[Result] = []
    current, limit = "", STARTING
    with selectors.DefaultSelector() as selector:
        selector.register(child.stdout, selectors.EVENT_READ)
        while True:
            start = time.monotonic()
            if not selector.select(limit):
                child.kill()
                child.wait()
                return [*results, Result(current, "hang", "", time.monotonic() - start)]
            line = child.stdout.readline()
            if not line:
                break
            row = json.loads(line)
            if "begins" in row:
                current, limit = row["begins"], LIMIT
            else:
                results.append(Result(**row))
                current = ""
    status = child.wait()
    if current:
        results.append(Result(current, "died", f"status {status}"))
    return results


def _child(folders: Sequence[str]) -> None:
    import contextlib
    import os
    import resource
    import warnings

    import jaxsr
    from jaxsr._result import InputError

    _ = jaxsr.Simulator, jaxsr.read_recording  # loaded before the first clock starts
    warnings.simplefilter("error")
    warnings.filterwarnings("ignore", category=DeprecationWarning)
    resource.setrlimit(resource.RLIMIT_AS, (16 << 30, 16 << 30))
    out = os.fdopen(os.dup(1), "w", buffering=1)
    for folder in map(Path, folders):
        out.write(json.dumps({"begins": folder.name}) + "\n")
        os.chdir(folder)
        start, end, message = time.monotonic(), "ok", ""
        try:
            with contextlib.redirect_stdout(None):
                exec(snippet(folder), {})
        except InputError as error:
            end, message = "InputError", str(error)
        except BaseException as error:
            end, message = type(error).__name__, str(error)[:300]
        seconds = time.monotonic() - start
        row = {"name": folder.name, "end": end, "message": message, "seconds": seconds}
        out.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    _child(sys.argv[1:])
