"""The process of a simulator that is no formulas: started, asked, and ended in time."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from jaxsr import _clock
from jaxsr._result import InputError

SCRIPT = Path(__file__).with_name("worker.py")
SECONDS = 20.0
"""Processor time in which a simulator must open, and a thousand rows must be answered."""
PATIENCE = 6.0
"""Times as much may pass on the clock of a loaded machine; one that sleeps is ended by it."""
ROWS = 20_000
"""Rows that are asked at once."""
KEPT = 24
"""Answers that are kept: the rates of several states are asked one after another."""
_ALIVE: weakref.WeakSet[Native] = weakref.WeakSet()


class Native:
    """A simulator in a process of its own.

    Parameters
    ----------
    script : Path
        Of the backend, beside the worker.
    path : Path
        Of the simulator.
    options : dict
        What else the backend needs to open it.
    seconds : float, optional
        Processor time that it may take to open or to answer a thousand rows, `SECONDS` by default.

    Attributes
    ----------
    about : dict
        What the backend says of it.

    Raises
    ------
    InputError
        It cannot be opened, ends, or does not answer in time.
    """

    def __init__(
        self, script: Path, path: Path, options: dict[str, Any], seconds: float | None = None
    ) -> None:
        self.path, self._seconds = path, SECONDS if seconds is None else seconds
        self._folder = tempfile.mkdtemp(prefix="jaxsr-native-")
        self._limit: _Limit | None = None
        self._late, self._gone, self._used = False, "", 0.0
        self._lock = threading.RLock()
        self._known: OrderedDict[tuple[Any, ...], np.ndarray] = OrderedDict()
        quiet = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(SCRIPT), self._folder],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=os.environ | quiet,
        )
        _ALIVE.add(self)
        weakref.finalize(self, _ended, self._process, self._folder)
        threading.Thread(target=_watch, args=(weakref.ref(self),), daemon=True).start()
        request = {"op": "open", "script": str(script), "path": str(path.resolve())}
        self.about: dict[str, Any] = self._asked(
            {**request, "folder": self._folder, **options}, b"", self._seconds
        )[0]
        self.results = 0

    def choose(self, results: int, scales: np.ndarray, **chosen: Any) -> None:
        """Say which variables stand in the rows, how many results there are, and their sizes."""
        self.results = results
        self._known.clear()
        request = {"op": "choose", "scales": [float(s) for s in scales], **chosen}
        self._asked(request, b"", self._seconds)

    def rates(self, rows: np.ndarray) -> np.ndarray:
        """Return rates and readings, shape (rows, results)."""
        return self._many("rates", rows, ())

    def slopes(self, rows: np.ndarray, columns: Sequence[int]) -> np.ndarray:
        """Return derivatives by some columns of the rows, shape (rows, results, columns)."""
        return self._many("slopes", rows, tuple(columns))

    def with_slopes(self, rows: np.ndarray, columns: Sequence[int]) -> np.ndarray:
        """Return rates and their derivatives in one request, shape (rows, results, 1 + columns).

        What else is asked at the rows, rates or those slopes, is known then.
        """
        found = self._many("with_slopes", rows, tuple(columns))
        with self._lock:
            key = np.ascontiguousarray(rows, dtype=float).tobytes()
            self._keep(("rates", (), key), found[:, :, 0])
            self._keep(("slopes", tuple(columns), key), found[:, :, 1:])
        return found

    def run(self, rows: np.ndarray) -> np.ndarray:
        """Return the states of a run by the simulator's own steps, shape (samples, states).

        Parameters
        ----------
        rows : ndarray, shape (samples, columns)
            As for `rates`; of the states the first row counts alone.
        """
        rows = np.ascontiguousarray(rows, dtype=float)
        body = rows.tobytes()
        head = {"op": "run", "rows": len(rows), "size": len(body)}
        _, data = self._asked(head, body, self._seconds * (1.0 + 1e-3 * len(rows)))
        return np.frombuffer(data, dtype=float).reshape(len(rows), self.results)

    def close(self) -> None:
        """End the process."""
        _ended(self._process, self._folder)

    def _many(self, op: str, rows: np.ndarray, columns: tuple[int, ...]) -> np.ndarray:
        rows = np.ascontiguousarray(rows, dtype=float)
        wide = {"rates": (), "slopes": (len(columns),), "with_slopes": (1 + len(columns),)}
        shape = self.results, *wide[op]
        with self._lock:
            key = op, columns, rows.tobytes()
            if key in self._known:
                self._known.move_to_end(key)
                return self._known[key]
            parts = []
            for first in range(0, len(rows), ROWS):
                part = rows[first : first + ROWS]
                body = part.tobytes()
                head = {"op": op, "rows": len(part), "size": len(body), "columns": columns}
                calls = 1 + 2 * len(columns)
                limit = self._seconds * (1.0 + 1e-3 * calls * len(part))
                _, data = self._asked(head, body, limit)
                parts.append(np.frombuffer(data, dtype=float).reshape(len(part), *shape))
            found = np.concatenate(parts) if parts else np.zeros((0, *shape))
            self._keep(key, found)
            return found

    def _keep(self, key: tuple[Any, ...], found: np.ndarray) -> None:
        self._known[key] = found
        if len(self._known) > KEPT:
            self._known.popitem(last=False)

    def _asked(self, head: dict[str, Any], body: bytes, limit: float) -> tuple[dict, bytes]:
        """Ask, and wait for the answer no longer than the limit in s."""
        with self._lock:
            if self._gone:
                raise self._lost()
            stdin, stdout = self._process.stdin, self._process.stdout
            assert stdin is not None and stdout is not None
            self._limit = _Limit(limit, time.monotonic() + PATIENCE * limit)
            try:
                stdin.write(json.dumps(head).encode() + b"\n" + body)
                stdin.flush()
                found = json.loads(_whole_line(stdout))
                data = stdout.read(found.get("size", 0))
                if len(data) < found.get("size", 0):
                    raise EOFError
            except (OSError, ValueError, EOFError):
                self._gone = "does not answer" if self._late else "ended while it ran"
                if self._late:
                    self._gone += f" within {limit:.3g} s"
                self.close()
                raise self._lost() from None
            except BaseException:  # interrupted: half an answer may be left in the pipe
                self._gone = "was interrupted"
                self.close()
                raise
            finally:
                self._limit = None
            used = float(found.pop("used", self._used))
            _clock.count(used - self._used)
            self._used = used
        if "refused" in found:
            raise InputError(str(found["refused"]), self.path.name, str(found.get("remedy", "")))
        return found, data

    def _lost(self) -> InputError:
        remedy = "Run it alone on these recordings first"
        return InputError(self._gone, self.path.name, remedy)

    def check_time(self) -> bool:
        """End the process if its time is up; tell whether there is anything left to watch."""
        limit = self._limit
        if limit is not None and limit.passed(self._process.pid):
            self._late = True
            self._process.kill()
        return self._process.poll() is None


@dataclass
class _Limit:
    """When a request has taken too long: by processor time in s, or by the clock."""

    seconds: float
    until: float
    began: float | None = None

    def passed(self, pid: int) -> bool:
        used = _processor_time(pid)
        if self.began is None:
            self.began = used
        late = used is not None and self.began is not None and used - self.began > self.seconds
        return late or time.monotonic() > self.until


def _processor_time(pid: int) -> float | None:
    """Return the processor time in s that a process has used (proc(5)); None where that is hid."""
    try:
        with open(f"/proc/{pid}/stat", "rb") as stream:
            parts = stream.read().rpartition(b")")[2].split()
        return (int(parts[11]) + int(parts[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError, AttributeError):
        return None


def _watch(owner: weakref.ref[Native]) -> None:
    """Look after the time limit: a pipe cannot be read with one everywhere."""
    while (native := owner()) is not None and native.check_time():
        del native
        time.sleep(0.1)


def _ended(process: subprocess.Popen[bytes], folder: str) -> None:
    process.kill()
    process.wait()
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            with contextlib.suppress(OSError):
                stream.close()
    shutil.rmtree(folder, ignore_errors=True)


def _whole_line(stream: IO[bytes]) -> bytes:
    line = stream.readline()
    if not line.endswith(b"\n"):
        raise EOFError
    return line


@atexit.register
def _close_all() -> None:
    for native in list(_ALIVE):
        native.close()
