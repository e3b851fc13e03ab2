"""The process that reads binary files: started when first needed, ended with this one."""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np

from jaxsr import _clock
from jaxsr._result import InputError

SCRIPT = Path(__file__).with_name("worker.py")
NUMBERS = 10_000_000
"""Numbers that a file of any size may hold, e.g. ten channels of a million samples."""
NUMBERS_PER_BYTE = 4
"""And those that a byte may stand for; recordings are compressed to 1 to 8 bytes a number."""
MEMORY = 240_000_000
"""Bytes beside those for the numbers."""
SECONDS = 0.8
SECONDS_PER_BYTE = {".xlsx": 6e-6}
"""Of processor time; a workbook is text that is unpacked and parsed cell by cell."""
_TIME_UP = 27  # SIGPROF, on the systems that have it
PATIENCE = 20.0
"""Times the processor time that may pass on the clock of a loaded machine."""


@dataclass
class Contents:
    """What a binary file holds.

    Attributes
    ----------
    numbers : dict of str to ndarray, shape (samples,)
        float64, int64, datetime64[ns] or timedelta64[ns].
    texts : dict of str to list of str
    odd : dict of str to str
        What is no channel, with the reason.
    sheets : list of str
        Of a workbook: the sheets that hold rows.
    csv : str
        Of a workbook: its first sheet.
    """

    numbers: dict[str, np.ndarray] = field(default_factory=dict)
    texts: dict[str, list[str]] = field(default_factory=dict)
    odd: dict[str, str] = field(default_factory=dict)
    sheets: list[str] = field(default_factory=list)
    csv: str = ""


class _Died(Exception):
    """The process ended while it read; `late` if because its time was up."""

    late = False


class Reader:
    """Hold a process that reads one file after another."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0
        self._used = 0.0  # s of processor time, by the process that is held
        self._lock = threading.Lock()

    def read(self, kind: str, raw: bytes | Path, file: str) -> Contents:
        """Read a file.

        Parameters
        ----------
        kind : str
            ``.npz``, ``.mat``, ``.parquet`` or ``.xlsx``.
        raw : bytes or Path
            What it holds, or where it lies.
        file : str
            For messages.

        Raises
        ------
        InputError
            If the file is damaged, or costs more than its size can account for.
        """
        with self._lock:
            fresh = self._process is None or self._process.poll() is not None
            fresh |= self._owner != os.getpid()
            try:
                return self._exchange(kind, raw, file)
            except _Died as error:
                again = not (fresh or error.late)  # an earlier file may have left it ill
            try:
                if again:
                    return self._exchange(kind, raw, file)
            except _Died:
                pass
        raise InputError(
            f"cannot be read as {kind}: damaged, or unpacks far beyond its size",
            file,
            "Save it anew, or as CSV",
        )

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is None or self._owner != os.getpid():
            return
        process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                try:
                    stream.close()
                except OSError:
                    pass  # it was ended with a request half written

    def _exchange(self, kind: str, raw: bytes | Path, file: str) -> Contents:
        process = self._started(file)
        lies = isinstance(raw, Path)
        try:
            size = raw.stat().st_size if lies else len(raw)
        except OSError as error:  # it was there when its first bytes were read
            raise InputError(f"cannot be read: {error.strerror}", file) from error
        seconds = SECONDS + SECONDS_PER_BYTE.get(kind, 3e-7) * size
        request = {
            "kind": kind,
            "path": str(raw.absolute()) if lies else None,
            "size": size,
            "seconds": seconds,
            "memory": MEMORY + 20 * size,
            "numbers": NUMBERS + NUMBERS_PER_BYTE * size,
        }
        timer = threading.Timer(PATIENCE * seconds, process.kill)
        timer.daemon = True
        timer.start()
        done = False
        try:
            assert process.stdin is not None and process.stdout is not None
            process.stdin.write(json.dumps(request).encode() + b"\n")
            if not lies:
                process.stdin.write(raw)
            process.stdin.flush()
            head = json.loads(_line(process.stdout))
            contents = _contents(head, process.stdout)
            done = True
            used = float(head["used"])
            _clock.count(used - self._used)
            self._used = used
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise _Died from error
        except _Died as error:
            error.late = process.wait() == -_TIME_UP
            raise
        finally:
            timer.cancel()
            if not done:  # interrupted too: half an answer may be left in the pipe
                self.close()
        if "refused" in head:
            raise InputError(str(head["refused"]), file, str(head.get("remedy", "")))
        return contents

    def _started(self, file: str) -> subprocess.Popen[bytes]:
        if self._owner != os.getpid():
            self._process = None  # a fork shares the pipes of its parent's process: leave them
        if self._process is not None and self._process.poll() is None:
            return self._process
        self.close()
        self._owner, self._used = os.getpid(), 0.0
        # pools of threads and of memory would count against the limits
        quiet = {
            "OPENBLAS_NUM_THREADS": "1",
            "OMP_NUM_THREADS": "1",
            "ARROW_DEFAULT_MEMORY_POOL": "system",
        }
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", str(SCRIPT)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=os.environ | quiet,
            )
        except OSError as error:
            what = f"no process can be started to read it: {error.strerror}"
            raise InputError(what, file, "Save it as CSV") from error
        return self._process


def _line(stream: IO[bytes]) -> bytes:
    line = stream.readline()
    if not line.endswith(b"\n"):
        raise _Died
    return line


def _contents(head: dict[str, Any], stream: IO[bytes]) -> Contents:
    contents = Contents(odd=head.get("odd", {}), sheets=head.get("sheets", []))
    dtypes = {"float64": "f8", "int64": "i8", "instant": "M8[ns]", "span": "m8[ns]"}
    for name, kind, size in head.get("columns", []):
        body = stream.read(size)
        if len(body) != size:
            raise _Died
        if kind in dtypes:
            contents.numbers[name] = np.frombuffer(body, dtype=dtypes[kind])
        elif kind == "text":
            contents.texts[name] = json.loads(body)
        else:
            contents.csv = body.decode("utf-8")
    return contents


READER = Reader()
atexit.register(READER.close)
