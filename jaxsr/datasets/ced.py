"""Coupled electric drives: voltage of two motors and speed of the pulley, three records at 50 Hz.

The pulse counter at the pulley reads the speed without its sign. These are the three records with
a binary input of 1, 1.5 and 0.5 V; the benchmark's own split has two uniform records instead.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.io

SAMPLE_TIME = 0.02  # s
RECORDS = (1, 2, 3)


def convert(sources: Mapping[str, Path]) -> dict[str, pd.DataFrame]:
    """Return ``ced_prbs1.csv`` to ``ced_prbs3.csv``.

    Parameters
    ----------
    sources : mapping of str to Path
        Upstream files by their path in the data set's folder.

    Returns
    -------
    dict of str to DataFrame
        Columns time_s, drive_V, speed_ticks_s.
    """
    raw = scipy.io.loadmat(sources["drive.mat"])
    return {f"ced_prbs{k}.csv": _table(raw[f"u{k}"], raw[f"z{k}"]) for k in RECORDS}


def _table(drive: np.ndarray, speed: np.ndarray) -> pd.DataFrame:
    time = np.round(SAMPLE_TIME * np.arange(drive.size), 6)
    return pd.DataFrame(
        {"time_s": time, "drive_V": drive.ravel(), "speed_ticks_s": speed.ravel()}, dtype=float
    )
