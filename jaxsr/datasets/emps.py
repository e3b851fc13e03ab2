"""EMPS: prismatic drive with dry friction, closed loop, 24 841 samples at 1 kHz.

Motor force is ``gtau * vir`` (35.15 N/V times the controller's output). The second file
repeats the reference of the first with force pulses every 0.5 s (recorded as 0 or 5); they
are part of the motor force already, so ``pulses_N`` is for information only.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd
import scipy.io


def convert(sources: Mapping[str, Path]) -> dict[str, pd.DataFrame]:
    """Return ``emps_train.csv`` and ``emps_pulses.csv``.

    Parameters
    ----------
    sources : mapping of str to Path
        Upstream files by their path in the data set's folder.

    Returns
    -------
    dict of str to DataFrame
        Columns time_s, motor_force_N, position_m, reference_m; pulses_N in the second.
    """
    return {
        "emps_train.csv": _table(sources["DATA_EMPS.mat"]),
        "emps_pulses.csv": _table(sources["DATA_EMPS_PULSES.mat"]),
    }


def _table(path: Path) -> pd.DataFrame:
    raw = scipy.io.loadmat(path)
    columns = {
        "time_s": raw["t"].ravel(),
        "motor_force_N": float(raw["gtau"].item()) * raw["vir"].ravel(),
        "position_m": raw["qm"].ravel(),
        "reference_m": raw["qg"].ravel(),
    }
    if "pulses_N" in raw:
        columns["pulses_N"] = raw["pulses_N"].ravel().astype(float)
    return pd.DataFrame(columns)
