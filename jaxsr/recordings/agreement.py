"""Whether recordings that are used together agree in the unit of their time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr._result import InputError
from jaxsr.recordings.recording import Recording

_FACTOR = 2.0
"""A sample time may differ from a thousand times another by as much, and it is still the unit."""
_SAMPLES = 30.0
"""Ratio of the numbers of samples from which sensors of different rates are likelier."""


def check_time_units(recordings: Sequence[Recording]) -> None:
    """Refuse files in seconds beside files in milliseconds.

    Sample times a thousandfold apart (or a millionfold) in files of comparably many samples are
    taken for different units, unless every file states the unit of its time.

    Parameters
    ----------
    recordings : sequence of Recording

    Raises
    ------
    InputError
        Naming both files.
    """
    if len(recordings) < 2 or all(r.time_stated for r in recordings):
        return
    ordered = sorted(recordings, key=lambda r: r.sample_time)
    fine = ordered[0]
    for coarse in ordered[1:]:
        ratio = coarse.sample_time / fine.sample_time
        power = round(float(np.log10(ratio)) / 3.0)
        apart = ratio / 1000.0**power
        if power < 1 or not 1.0 / _FACTOR < apart < _FACTOR:
            continue
        if not 1.0 / _SAMPLES < len(fine) / len(coarse) < _SAMPLES:
            continue
        if coarse.time_stated and fine.time_stated:
            continue
        word = {1: "a thousandfold", 2: "a millionfold"}.get(power, f"1000**{power}-fold")
        raise InputError(
            f"samples of {coarse.name} are {coarse.sample_time:.4g} apart, those of {fine.name} "
            f"{fine.sample_time:.4g}, {word}: time may be in s in one and in ms or us in the other",
            "DATA",
            "Name the column of time after its unit in both files (time_s, time_ms)",
        )
