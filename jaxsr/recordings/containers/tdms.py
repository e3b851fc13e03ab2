"""TDMS (LabVIEW) by npTDMS: channels, with the time of their waveform where they have one."""

from __future__ import annotations

import numpy as np
from nptdms import TdmsFile


def read(path: str) -> list[tuple[str, np.ndarray | None, np.ndarray, str]]:
    """Return name, time in s, values and unit of every channel."""
    file = TdmsFile.read(path)
    every = [channel for group in file.groups() for channel in group.channels()]
    names = [channel.name for channel in every]
    single = len(set(names)) == len(names)
    clocks: dict[tuple[float, float, int], np.ndarray] = {}
    found = []
    for channel in every:
        name = channel.name if single else f"{channel.group_name}/{channel.name}"
        values = np.asarray(channel[:])
        step = channel.properties.get("wf_increment")
        time = None
        if step and len(values):
            offset = float(channel.properties.get("wf_start_offset", 0.0))
            key = float(step), offset, len(values)
            time = clocks.setdefault(key, offset + float(step) * np.arange(len(values)))
        found.append((name, time, values, str(channel.properties.get("unit_string", ""))))
    return found
