"""Hostile and damaged recordings, seeded; as a script it reads them and reports what they cost.

``python tests/fuzz_recordings.py FIRST LAST FOLDER`` reads the cases of these numbers one after
the other in one process and prints a JSON line for each that is not as it should be, then one of
totals. Whoever started it sees by its exit status whether a file ended the process.
"""

from __future__ import annotations

import gc
import json
import resource
import sys
import time
import warnings
from pathlib import Path

import numpy as np
from hostile_recordings import hostile

SECONDS = 2.0
MEGABYTES = 500.0
USUAL = 130.0
"""MB of a process that has imported the readers."""


def _worker(file: str) -> str:
    """Return what the system knows of the process that reads binary files."""
    from jaxsr.recordings.isolated import READER

    process = READER._process
    try:
        return "" if process is None else Path(f"/proc/{process.pid}/{file}").read_text()
    except OSError:
        return ""


def _megabytes(status: str, key: str) -> float:
    found = [line for line in status.splitlines() if line.startswith(key)]
    return int(found[0].split()[1]) / 1024.0 if found else 0.0


def _forget() -> float:
    """Begin to count peaks of memory anew; return the MB that what made the case has left."""
    gc.collect()
    Path("/proc/self/clear_refs").write_text("5")
    return max(_megabytes(Path("/proc/self/status").read_text(), "VmRSS") - USUAL, 0.0)


def _processor_seconds() -> float:
    """Return the processor time of this process and of those it started.

    The clock on the wall would count what other jobs of the machine take.
    """
    own = time.process_time()
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    fields = _worker("stat").rpartition(")")[2].split()
    alive = (int(fields[11]) + int(fields[12])) / 100.0 if len(fields) > 12 else 0.0
    return own + ended.ru_utime + ended.ru_stime + alive


def attempt(path: Path) -> tuple[str, float]:
    """Read a file; return what went wrong, empty if nothing, and the processor time."""
    from jaxsr._result import InputError
    from jaxsr.recordings import check_recording, read_recording, unwrap

    started = _processor_seconds()
    wrong = ""
    try:
        check_recording(unwrap(read_recording(path)))
    except InputError as error:
        if "\n" in str(error) or len(str(error)) > 1000:
            wrong = f"message of {len(str(error))} characters"
    except Exception as error:
        wrong = f"{type(error).__name__}: {str(error)[:200]}"
    return wrong, _processor_seconds() - started


def main(first: int, last: int, folder: Path) -> None:
    """Read the cases of these numbers and report."""
    warnings.simplefilter("error", RuntimeWarning)
    worst = np.zeros(3)
    for number in range(first, last):
        kind, ending, content = hostile(number)
        path = folder / f"case_{number}{ending}"
        path.write_bytes(content)
        del content
        (folder / "now").write_text(f"{number} {kind} {ending}")
        left = _forget()
        wrong, seconds = attempt(path)
        own = _megabytes(Path("/proc/self/status").read_text(), "VmHWM") - left
        worker = _megabytes(_worker("status"), "VmHWM")
        if seconds > SECONDS:
            wrong += f" {seconds:.1f} s"
        if own > MEGABYTES or worker > MEGABYTES:
            wrong += f" {own:.0f} and {worker:.0f} MB"
        worst = np.maximum(worst, [seconds, own, worker])
        if wrong:
            print(json.dumps({"case": number, "kind": kind, "file": path.name, "wrong": wrong}))
        else:
            path.unlink()
    print(json.dumps(dict(zip(("seconds", "megabytes", "worker"), worst.tolist(), strict=True))))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
