"""Dynamixel XL330 servo that lifts a pendulum: sixteen runs of 6 s at about 200 Hz.

The origin holds one JSON file a run, which becomes a table of seven digits before anything else.
Stamps are as logged, 3.4 to 7 ms apart. In ``lift_and_drop`` the motor is switched off after the
lift: ``torque_on`` says when.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from jaxsr.datasets.tables import as_text, from_zero

FULL_DUTY = 885
"""Count of the servo's present-PWM register at full duty."""
COLUMNS = {
    "t": "time_s",
    "position": "position_rad",
    "speed": "speed_rad_s",
    "goal_position": "goal_rad",
    "duty": "duty",
    "input_volts": "supply_V",
    "torque_enable": "torque_on",
    "temp": "temperature_C",
}


def make(path: str, raw: Sequence[Path]) -> str:
    """Return the table of one run from the origin's JSON.

    Parameters
    ----------
    path : str
        Name of the table, which is not looked at.
    raw : sequence of Path
        The origin's file.
    """
    entries = pd.DataFrame(json.loads(raw[0].read_text(encoding="utf-8"))["entries"])
    entries["duty"] = entries["load"] / FULL_DUTY
    entries = entries.rename(columns={"timestamp": "t"})
    return as_text(entries.loc[:, list(COLUMNS)], "%.7g")


def convert(sources: Mapping[str, Path]) -> dict[str, pd.DataFrame]:
    """Return ``bam_<run>.csv`` for the sixteen runs.

    Parameters
    ----------
    sources : mapping of str to Path
        Tables by their path in the data set's folder.

    Returns
    -------
    dict of str to DataFrame
        Columns time_s, position_rad (0 hangs down), speed_rad_s, goal_rad, duty (-1 to 1),
        supply_V, torque_on (0 or 1), temperature_C. Time starts at the first sample.
    """
    return {f"bam_{name}": _table(path) for name, path in sources.items()}


def _table(path: Path) -> pd.DataFrame:
    return from_zero(pd.read_csv(path).rename(columns=COLUMNS), digits=9)
