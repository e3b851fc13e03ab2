"""Run somebody's simulator in a process of its own; run as a script, never imported.

Native code may hang, crash, print or change the process it runs in. Here that costs a process,
not the user's session. It imports nothing of the package, so that it starts quickly.

A request is a JSON line with an ``op``, and for ``rates``, ``slopes`` and ``with_slopes`` the bytes
of a float64 array (rows, columns), a row being time, states, inputs and parameters. The answer is a
JSON line with the processor time used so far and, where it says ``size``, that many bytes of
float64.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import shutil
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any, Protocol

import numpy as np

STEP = 1e-4
"""Step of a central difference, relative to the size of what is moved."""


class Backend(Protocol):
    """What is asked of a simulator."""

    def describe(self) -> dict[str, Any]:
        """Say what there is: states, inputs, outputs, parameters."""
        ...

    def choose(self, chosen: dict[str, Any]) -> None:
        """Say which variables stand in the rows."""
        ...

    def evaluate(self, rows: np.ndarray) -> np.ndarray:
        """Return rates and readings, shape (rows, states + outputs); NaN where there are none."""
        ...

    def exact(self, rows: np.ndarray, columns: list[int]) -> dict[int, np.ndarray]:
        """Return derivatives that the simulator has itself, by those of the columns."""
        ...


ITERATES = (
    (-1.0, 1.0),
    (-1.5, 2.0, -0.5),
    (-11 / 6, 3.0, -1.5, 1 / 3),
)
"""Weights of x, S(x), S(S(x)), ... in the derivative at the start of the polynomial through them,
by its degree less one."""


def rates_of_steps(backend: Any, rows: np.ndarray, degree: int) -> np.ndarray:
    """Return the rates whose flow passes through the steps of a map, to an order up to 3.

    The map is the flow of a modified equation (Hairer, Lubich and Wanner, Geometric Numerical
    Integration, chapter IX), whose right-hand side is read off a few steps with inputs held:
    the derivative at the start of the polynomial through x, S(x), S(S(x)), ... The first order is
    the law that Euler's method steps along.
    """
    n, h = backend.count, backend.period
    found = np.zeros((len(rows), n))
    now = rows.copy()
    for k, weight in enumerate(ITERATES[degree - 1]):
        found += weight * now[:, 1 : 1 + n]
        if k < degree:
            now[:, 1 : 1 + n] = backend.advance(now)
            now[:, 0] += h
    return found / h


def run_of_steps(backend: Any, rows: np.ndarray) -> np.ndarray:
    """Return the states of a run by the simulator's own steps, shape (samples, states).

    Rows hold time, inputs and parameters of the samples, and the first one the start. A sample
    is as many steps as fit; inputs are held.
    """
    n, h = backend.count, backend.period
    found = np.full((len(rows), n), np.nan)
    found[0] = rows[0, 1 : 1 + n]
    for k in range(len(rows) - 1):
        now = rows[k].copy()
        now[1 : 1 + n] = found[k]
        for _ in range(max(1, round((rows[k + 1, 0] - rows[k, 0]) / h))):
            now[1 : 1 + n] = backend.advance(now[None])[0]
            now[0] += h
        found[k + 1] = now[1 : 1 + n]
    return found


def evaluated(backend: Any, rows: np.ndarray) -> np.ndarray:
    """Return rates and readings of a simulator of any kind."""
    if hasattr(backend, "advance"):
        return rates_of_steps(backend, rows, getattr(backend, "degree", 3))
    return backend.evaluate(rows)


def slopes(
    backend: Backend, rows: np.ndarray, scales: np.ndarray, columns: list[int]
) -> np.ndarray:
    """Return derivatives by some columns, shape (rows, results, columns)."""
    known = backend.exact(rows, columns)
    found: list[np.ndarray] = []
    for k in columns:
        if k in known:
            found.append(known[k])
            continue
        step = STEP * scales[k]
        low, high = rows.copy(), rows.copy()
        low[:, k] -= step
        high[:, k] += step
        moved = high[:, k] - low[:, k]
        found.append((evaluated(backend, high) - evaluated(backend, low)) / moved[:, None])
    return np.stack(found, axis=2)


def _watch_parent(folder: str) -> None:
    """End this process, whatever it is doing, when the one that started it is gone."""
    parent = os.getppid()
    while True:
        time.sleep(0.5)
        if os.getppid() != parent:
            shutil.rmtree(folder, ignore_errors=True)
            os._exit(0)


def _loaded(path: str) -> Any:
    sys.path.append(str(Path(path).parent))  # last, so that it hides nothing of the user's
    spec = importlib.util.spec_from_file_location(f"jaxsr_{Path(path).stem}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def answered(state: dict[str, Any], request: dict[str, Any], body: bytes) -> Any:
    """Do what a request asks, and return its answer."""
    op = request["op"]
    if op == "open":
        state["backend"] = _loaded(request["script"]).opened(request)
        return state["backend"].describe()
    backend: Backend = state["backend"]
    if op == "choose":
        state["scales"] = np.array(request["scales"], dtype=float)
        backend.choose(request)
        if hasattr(backend, "advance"):
            state["backend"].degree = request.get("degree", 3)
        return {}
    rows = np.frombuffer(body, dtype=float).reshape(request["rows"], -1)
    with np.errstate(all="ignore"):
        if op == "run":
            return run_of_steps(backend, rows)
        if op in ("slopes", "with_slopes"):
            found = slopes(backend, rows, state["scales"], request["columns"])
            if op == "slopes":
                return found
            return np.concatenate([evaluated(backend, rows)[:, :, None], found], axis=2)
        return evaluated(backend, rows)


def main() -> None:
    """Answer requests until there are no more."""
    own = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what the simulator prints is no answer
    with contextlib.suppress(ValueError):
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    folder = sys.argv[1]
    threading.Thread(target=_watch_parent, args=(folder,), daemon=True).start()
    state: dict[str, Any] = {}
    while line := sys.stdin.buffer.readline():
        request = json.loads(line)
        body = sys.stdin.buffer.read(request.get("size", 0))
        try:
            found = answered(state, request, body)
        except (Exception, SystemExit) as error:
            what = " ".join((str(error) or type(error).__name__).split())
            if getattr(error, "what", None) is None and not isinstance(error, SystemExit):
                what = f"{type(error).__name__}: {what}" if str(error) else what
            remedy = getattr(error, "remedy", "")
            head, data = {"refused": what[:160], "remedy": remedy}, b""
        else:
            head, data = found, b""
            if isinstance(found, np.ndarray):
                data = np.ascontiguousarray(found, dtype=float).tobytes()
                head = {"size": len(data)}
        own.write(json.dumps({**head, "used": time.process_time()}).encode() + b"\n" + data)
        own.flush()
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)  # libraries of others may hang in what they do at the end


if __name__ == "__main__":
    main()
