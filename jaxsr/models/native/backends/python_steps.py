"""A step function ``step(x, u, p) -> x_next`` of any library, in the worker's process."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import numpy as np


class Refused(Exception):
    """What is wrong with the function, and the remedy."""

    def __init__(self, what: str, remedy: str = "") -> None:
        super().__init__(what)
        self.what, self.remedy = what, remedy


def opened(request: dict[str, Any]) -> Steps:
    """Run a Python file, and take its function."""
    path, name = Path(request["path"]), request["function"]
    sys.path.insert(0, str(path.parent))  # as if the file had been run
    spec = importlib.util.spec_from_file_location(f"jaxsr_user_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise Refused("cannot be loaded as Python")
    module = importlib.util.module_from_spec(spec)
    # Compiled files are told apart by the second: one changed within it would be read as it was.
    sys.dont_write_bytecode = True
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        what = " ".join(f"{type(error).__name__}: {error}".split())[:120]
        raise Refused(f"fails on import: {what}") from None
    function = getattr(module, name, None)
    if not callable(function):
        raise Refused(f"has no function {name!r}", "Check the name after the colon")
    return Steps(function, request)


class Steps:
    """A function that takes the states a step further."""

    def __init__(self, function: Any, request: dict[str, Any]) -> None:
        self.function, self.period = function, float(request["step"])
        self.two = int(request["arguments"]) == 2  # step(x, u)
        self.count = len(request["states"])
        self.inputs = len(request["inputs"])
        self.parameters: list[str] = request["parameters"]
        row = np.array([0.0, *request["start"]])
        try:
            self._step(row)
        except Refused:
            raise
        except Exception as error:
            what = " ".join(f"{type(error).__name__}: {error}".split())[:120]
            raise Refused(f"raises {what}", "Run it once by hand") from None

    def describe(self) -> dict[str, Any]:
        """Say nothing: the table beside the file does."""
        return {"kind": "Steps", "step": self.period}

    def choose(self, chosen: dict[str, Any]) -> None:
        """Take what the request said."""

    def exact(self, rows: np.ndarray, columns: list[int]) -> dict[int, np.ndarray]:
        """Return no derivatives."""
        return {}

    def advance(self, rows: np.ndarray) -> np.ndarray:
        """Return the states a step later, shape (rows, states)."""
        found = np.full((len(rows), self.count), np.nan)
        for row, result in zip(rows, found, strict=True):
            if np.isfinite(row).all():
                try:
                    result[:] = self._step(row)
                except Refused:
                    raise
                except Exception:  # no such step: the rates are not a number here
                    continue
        return found

    def _step(self, row: np.ndarray) -> np.ndarray:
        x, u, p = np.split(row[1:], [self.count, self.count + self.inputs])
        values = dict(zip(self.parameters, p.tolist(), strict=True))
        given = (x.copy(), u.copy()) if self.two else (x.copy(), u.copy(), values)
        found = np.asarray(self.function(*given), dtype=float)
        if found.shape != (self.count,):
            raise Refused(
                f"returns states of shape {found.shape}, for {self.count} of them",
                "Return one number for each state, in the order of [model] states",
            )
        return found
