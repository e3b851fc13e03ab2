"""Cascaded tanks: pump voltage and level of the lower tank, 1024 samples, every 4 s.

One upstream sheet holds the estimation and the validation experiment side by side.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

SAMPLE_TIME = 4.0  # s


def convert(sources: Mapping[str, Path]) -> dict[str, pd.DataFrame]:
    """Return ``tanks_train.csv`` and ``tanks_validation.csv``.

    Parameters
    ----------
    sources : mapping of str to Path
        Upstream files by their path in the data set's folder.

    Returns
    -------
    dict of str to DataFrame
        Columns time_s, pump_V, level_V.
    """
    sheet = pd.read_csv(sources["dataBenchmark.csv"])
    return {
        "tanks_train.csv": _table(sheet, "uEst", "yEst"),
        "tanks_validation.csv": _table(sheet, "uVal", "yVal"),
    }


def _table(sheet: pd.DataFrame, pump: str, level: str) -> pd.DataFrame:
    time = SAMPLE_TIME * np.arange(len(sheet))
    return pd.DataFrame({"time_s": time, "pump_V": sheet[pump], "level_V": sheet[level]})
