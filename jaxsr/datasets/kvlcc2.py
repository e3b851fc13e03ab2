"""KVLCC2 ship model, 1:68: three free roll decays in a towing tank.

The origin holds six motions at 100 Hz; a table here is the roll angle at 50 Hz from its largest
value until it has died down, since the model is held by hand before. Runs 21337 and 21338 are at
zero speed, 21340 at 15.5 knots (full scale), of which the end is a transient of the tank: within
two swings the amplitude falls from 1.7 to 0.4 degrees.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from jaxsr.datasets.tables import as_text

SAMPLES = {"roll_21337.csv": 3337, "roll_21338.csv": 9329, "roll_21340.csv": 2875}
SAMPLE_TIME = 0.02  # s, of every second sample
LAST = {"roll_21340.csv": 50.0}
"""Seconds after which a run is no roll decay any more."""


def make(path: str, raw: Sequence[Path]) -> str:
    """Return the roll angle of one run from the origin's six motions.

    Parameters
    ----------
    path : str
        Name of the table, which says how many samples to keep.
    raw : sequence of Path
        The origin's file.
    """
    roll = pd.read_csv(raw[0])["phi"].to_numpy()
    kept = roll[int(np.argmax(np.abs(roll))) :: 2][: SAMPLES[path]]
    table = pd.DataFrame({"time": SAMPLE_TIME * np.arange(kept.size), "phi": kept})
    return as_text(table, {"time": "%.4f", "phi": "%.7f"})


def convert(sources: Mapping[str, Path]) -> dict[str, pd.DataFrame]:
    """Return ``kvlcc2_21337.csv``, ``kvlcc2_21338.csv`` and ``kvlcc2_21340.csv``.

    Parameters
    ----------
    sources : mapping of str to Path
        Tables by their path in the data set's folder.

    Returns
    -------
    dict of str to DataFrame
        Columns time_s, roll_rad.
    """
    return {
        name.replace("roll", "kvlcc2"): _table(sources[name], LAST.get(name)) for name in SAMPLES
    }


def _table(path: Path, last: float | None) -> pd.DataFrame:
    table = pd.read_csv(path).rename(columns={"time": "time_s", "phi": "roll_rad"})
    return table if last is None else table.iloc[: round(last / SAMPLE_TIME) + 1]
