"""DFKI torque-controlled pendulum: four runs at 200 to 500 Hz.

``energy_shaping_1kg`` is the same rig with another mass. Time increases strictly in all four
files and there are no duplicate rows, so none is dropped; the steps vary by a few per cent.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

RUNS = ("ddp", "energy_shaping", "energy_shaping_1kg", "sysid")
COLUMNS = {
    "time": "time_s",
    "position": "position_rad",
    "velocity": "velocity_rad_s",
    "torque": "torque_Nm",
}


def convert(sources: Mapping[str, Path]) -> dict[str, pd.DataFrame]:
    """Return ``pendulum_<run>.csv`` for the four runs.

    Parameters
    ----------
    sources : mapping of str to Path
        Upstream files by their path in the data set's folder.

    Returns
    -------
    dict of str to DataFrame
        Columns time_s, position_rad, velocity_rad_s, torque_Nm.
    """
    return {f"pendulum_{run}.csv": _table(sources[f"simple/{run}_measured.csv"]) for run in RUNS}


def _table(path: Path) -> pd.DataFrame:
    return pd.read_csv(path, usecols=list(COLUMNS)).rename(columns=COLUMNS)
