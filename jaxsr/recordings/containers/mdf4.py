"""MDF 4 (measurement data format of ASAM) by asammdf: every channel on its own raster."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np


def read(path: str) -> list[tuple[str, np.ndarray, np.ndarray, str]]:
    """Return name, time in s, values and unit of every channel of numbers."""
    found = []
    MDF: Any = importlib.import_module("asammdf").MDF
    with MDF(path) as file:
        for number, group in enumerate(file.groups):
            clock = None
            for place, channel in enumerate(group.channels):
                if place == file.masters_db.get(number):
                    continue
                signal = file.get(group=number, index=place, ignore_invalidation_bits=False)
                values = np.asarray(signal.samples)
                if values.ndim != 1 or values.dtype.kind not in "fiub":
                    continue
                clock = signal.timestamps if clock is None else clock
                time = clock if len(clock) == len(values) else signal.timestamps
                found.append((channel.name, time, values, signal.unit or ""))
    names = [name for name, *_ in found]
    twice = {name for name in names if names.count(name) > 1}
    return [
        (f"{name}_{k + 1}" if name in twice else name, *rest)
        for k, (name, *rest) in enumerate(found)
    ]
