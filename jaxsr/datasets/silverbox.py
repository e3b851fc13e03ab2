"""Silverbox: circuit that imitates a mass on a hardening spring, 610.35 Hz, no time column.

``SNLS80mV.mat`` holds the "arrow" (noise of growing amplitude, samples 100 to 40 575) and then
ten realisations of an odd random-phase multisine. The input shows their bounds: silence of 100
samples, then 400 samples of run-in that repeat at a distance of 8192 (the period), every 8692
samples from 40 575 on. Each file keeps run-in, period and the silence after it, so it starts
and ends near rest. ``Schroeder80mV.mat`` holds another multisine; one period of 1024 samples
is taken where its readme says (10 585 counted from 1). Offsets are left in.

References
----------
Wigren, Schoukens, European Control Conference, 2013.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.io

SAMPLE_RATE = 1e7 / 2**14  # Hz
ARROW = slice(100, 40_575)
MULTISINE_START, MULTISINE_LENGTH, MULTISINES = 40_575, 8_692, 10
SCHROEDER = slice(10_584, 10_584 + 1_024)


def convert(sources: Mapping[str, Path]) -> dict[str, pd.DataFrame]:
    """Return the arrow, ten multisines and one period of the Schroeder multisine.

    Parameters
    ----------
    sources : mapping of str to Path
        Upstream files by their path in the data set's folder.

    Returns
    -------
    dict of str to DataFrame
        Columns time_s, input_V, output_V.
    """
    main = scipy.io.loadmat(sources["SNLS80mV.mat"])
    tables = {"silverbox_arrow.csv": _table(main, ARROW)}
    for index in range(MULTISINES):
        start = MULTISINE_START + index * MULTISINE_LENGTH
        part = slice(start, start + MULTISINE_LENGTH)
        tables[f"silverbox_multisine_{index + 1:02d}.csv"] = _table(main, part)
    schroeder = scipy.io.loadmat(sources["Schroeder80mV.mat"])
    tables["silverbox_schroeder.csv"] = _table(schroeder, SCHROEDER)
    return tables


def _table(raw: Mapping[str, np.ndarray], part: slice) -> pd.DataFrame:
    u, y = raw["V1"].ravel()[part], raw["V2"].ravel()[part]
    return pd.DataFrame(
        {"time_s": np.arange(u.size) / SAMPLE_RATE, "input_V": u, "output_V": y},
    )
