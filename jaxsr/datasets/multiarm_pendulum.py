"""Single, double and triple pendulum on a cart that is held: free swings, encoders, 500 Hz.

The origin keeps the swing in pieces, at 1 kHz, some for identification and the last ones for
validation; a table here is all pieces of a kind, every second sample. Angles are absolute and
pi hangs down. The rates are the owners' derivatives after wavelets: no sensor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.io

from jaxsr.datasets.tables import as_text, from_zero

ARMS = {"single": 1, "double": 2, "triple": 3}
EVERY = 2


def make(path: str, raw: Sequence[Path]) -> str:
    """Return one swing from the owners' pieces.

    Parameters
    ----------
    path : str
        Name of the table: ``<pendulum>_id.csv`` or ``<pendulum>_vad.csv``.
    raw : sequence of Path
        The origin's MAT file.
    """
    pendulum, part = path.removesuffix(".csv").split("_")
    pieces = scipy.io.loadmat(raw[0])
    time = np.concatenate([piece.ravel() for piece in pieces[f"Time_{part}"].ravel()])
    values = np.concatenate([piece for piece in pieces[f"Y_{part}"].ravel()], axis=1)
    numbers = range(1, ARMS[pendulum] + 1)
    names = [f"theta{k}" for k in numbers] + [f"dtheta{k}" for k in numbers]
    table = pd.DataFrame({"t": time, **dict(zip(names, values, strict=True))})
    return as_text(table.iloc[::EVERY], "%.7g")


def convert(sources: Mapping[str, Path]) -> dict[str, pd.DataFrame]:
    """Return ``<pendulum>_id.csv`` and ``<pendulum>_vad.csv`` for the three pendulums.

    Parameters
    ----------
    sources : mapping of str to Path
        Tables by their path in the data set's folder.

    Returns
    -------
    dict of str to DataFrame
        Columns time_s, theta1_rad.., dtheta1_rad_s... Time starts at the first sample.
    """
    return {name: _table(path) for name, path in sources.items()}


def _table(path: Path) -> pd.DataFrame:
    table = pd.read_csv(path)
    names = {"t": "time_s"}
    names |= {c: f"{c}_rad_s" if c.startswith("d") else f"{c}_rad" for c in table.columns[1:]}
    return from_zero(table.rename(columns=names))
