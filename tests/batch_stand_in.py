"""Cases that end in moments, for tests of what gives them out: everything but the diagnosis.

The functions run on the workers of a scheduler; as a program, this is the process of a case.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

SECONDS = 0.4
DOCUMENT = (
    '{"schema": "jaxsr.diagnosis/1", "verdict": "nothing", "findings": [], "fit": {},'
    ' "provenance": {}}\n'
)
MODEL = """
[model]
states = ["x"]
outputs = ["x"]
[equations]
x = "-k*x"
[readings]
x = "x"
[parameters]
k = { value = 1.0 }
"""


def stand_in(given: Any) -> Any:
    """Run a case as a worker does, its process this file's program."""
    from jaxsr.batch import task  # not by the program, which begins in no time

    task.command = command
    return task.run_task(given)


def command(given: Any) -> list[str]:
    results = os.path.join(given.directory, given.results)
    mark, key = str(given.mark), given.key()
    return [sys.executable, "-S", "-E", __file__, str(os.getpid()), results, mark, key]


def program(parent: int, results: Path, mark: Path, key: str) -> None:
    """Take a while, then write results and the mark; end with the parent."""
    log(results, "began")
    end = time.monotonic() + SECONDS
    while time.monotonic() < end:
        time.sleep(0.02)
        if os.getppid() != parent:
            log(results, "left")
            os._exit(1)
    results.mkdir(exist_ok=True)
    (results / "diagnosis.json").write_text(DOCUMENT)
    (results / "explained.toml").write_text(MODEL)
    mark.write_text(key)
    log(results, "ended")


def log(results: Path, word: str) -> None:
    with open(results.parent / "log.txt", "a") as stream:
        stream.write(f"{word} {results.name}\n")


if __name__ == "__main__":
    program(int(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4])
