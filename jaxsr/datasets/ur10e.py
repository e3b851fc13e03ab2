"""UR10e six-axis arm: joint motion and motor currents at 100 Hz; upstream has no header line.

Each file is cut to the window in which the arm moves (rows counted from 1, both ends in), and
time starts at 0 there. The position, velocity and current of every joint are kept, with the
controller's desired current and torque. Beside the model of joint 1 alone stands the rigid arm of
six joints, written from the owners' URDF.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from jaxsr.datasets.arm import arm_model

GAINS = (10.0, 10.6956, 8.4566, 9.0029, 9.48, 10.1232)
"""Torque per motor current at each joint, in N m/A, as the owners estimated it."""
WINDOWS = {
    "ur10e_ident.csv": ("ident_30sec_12harm.csv", 635, 3510),
    "ur10e_unloaded.csv": ("unloaded_14harm50sec.csv", 195, 4966),
    "ur10e_ptp.csv": ("validation_ptp_10_points.csv", 700, 4200),
}
COLUMNS = [
    "t_s",
    *(
        f"{quantity}{joint}"
        for quantity in ("q", "qd", "i", "i_des", "tau_des")
        for joint in range(1, 7)
    ),
]


def convert(sources: Mapping[str, Path]) -> dict[str, pd.DataFrame]:
    """Return ``ur10e_ident.csv``, ``ur10e_unloaded.csv`` and ``ur10e_ptp.csv``.

    Parameters
    ----------
    sources : mapping of str to Path
        Upstream files by their path in the data set's folder.

    Returns
    -------
    dict of str to DataFrame
        Columns t_s [s], q1..q6 [rad], qd1..qd6 [rad/s], i1..i6 [A], i_des1..i_des6 [A],
        tau_des1..tau_des6 [N m].
    """
    return {
        name: _table(sources[upstream], first, last)
        for name, (upstream, first, last) in WINDOWS.items()
    }


def models(sources: Mapping[str, Path]) -> dict[str, str]:
    """Return ``ur10e_arm.toml``: six rigid links without friction, driven by motor currents."""
    joints = range(1, len(GAINS) + 1)
    columns = {"t": "t_s"}
    columns |= {f"{q}{k}_meas": f"{c}{k}" for q, c in (("q", "q"), ("v", "qd")) for k in joints}
    urdf = sources["ur10e.urdf"].read_text(encoding="utf-8")
    return {"ur10e_arm.toml": arm_model(urdf, "UR10e, six joints", GAINS, columns)}


def _table(path: Path, first: int, last: int) -> pd.DataFrame:
    raw = pd.read_csv(path, header=None, names=COLUMNS)
    table = raw.iloc[first - 1 : last].reset_index(drop=True)
    # Stamps have three decimals; rounding removes what the subtraction adds.
    table["t_s"] = (table["t_s"] - table["t_s"].iloc[0]).round(6)
    return table
