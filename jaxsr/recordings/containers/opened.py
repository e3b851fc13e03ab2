"""A container file, read in a process of its own that a damaged file cannot take along."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxsr._result import InputError

SCRIPT = Path(__file__).with_name("child.py")
LIBRARIES = {
    ".h5": "h5py",
    ".hdf5": "h5py",
    ".tdms": "npTDMS",
    ".mf4": "asammdf",
    ".mcap": "mcap",
    ".bag": "rosbags",
    ".db3": "rosbags",
}
"""Endings, and what reads them."""
SECONDS, PER_BYTE = 120.0, 3e-6
"""Seconds that a file may take, and for each of its bytes."""


@dataclass(frozen=True, eq=False)
class Channel:
    """One channel of a file.

    Attributes
    ----------
    name : str
    unit : str
    clock : str or None
        Of which time it is, where it has its own.
    time : ndarray, shape (samples,), or None
        In s.
    values : ndarray, shape (samples,)
    """

    name: str
    unit: str
    clock: str | None
    time: np.ndarray | None
    values: np.ndarray


def opened(kind: str, path: Path) -> list[Channel]:
    """Return the channels of a file.

    Raises
    ------
    InputError
        The library that reads it is not installed, or the file is damaged.
    """
    limit = SECONDS + PER_BYTE * path.stat().st_size
    command = [sys.executable, "-P", str(SCRIPT), kind, str(path.resolve())]
    try:
        done = subprocess.run(command, capture_output=True, timeout=limit, check=False)
    except subprocess.TimeoutExpired:
        remedy = "Save it anew, or as CSV"
        raise InputError(f"takes longer than {limit:.0f} s to read", path.name, remedy) from None
    if done.returncode != 0:
        raise _refusal(kind, path, done.stderr)
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as held:
        header = json.loads(held["header"].tobytes())
        return [
            Channel(name, unit, clock, None if clock is None else held[clock], held[values])
            for name, unit, clock, values in header
        ]


def _refusal(kind: str, path: Path, said: bytes) -> InputError:
    lines = said.decode("utf-8", "replace").strip().splitlines()
    try:
        why = json.loads(lines[-1])
    except (ValueError, IndexError):
        why = {}
    if "missing" in why:
        remedy = 'python -m pip install "jaxsr-dynamics[formats]", or save it as CSV'
        return InputError(f"reading {kind} needs {LIBRARIES[kind]}", path.name, remedy)
    what = str(why.get("wrong", "damaged"))[:80]
    return InputError(f"cannot be read as {kind}: {what}", path.name, "Save it anew, or as CSV")
