"""Staubli TX40, six joints: angles and joint torques of one run of 9 s at 1 kHz.

The origin holds motor angles and motor torques at 5 kHz. Motor 6 drives joint 6 through joint 5,
so that both reductions have an entry beside the diagonal. The last third is a recording of its
own, to be held out. The model is the owners' URDF: rigid links and no friction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from jaxsr.datasets.arm import write_arm
from jaxsr.datasets.drives import torques
from jaxsr.datasets.tables import as_text, from_zero
from jaxsr.datasets.urdf import read_arm

REDUCTION = (32.0, 32.0, 45.0, -48.0, 45.0, 32.0)
OFFSET = np.array([0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0])  # rad
MOTOR_STEP, EVERY = 2e-4, 5
"""Sample time of the motors, s, and how many of their samples make one here."""
JOINTS = range(1, 7)
HEADER = """\
# Staubli TX40: six rigid links without friction, driven by joint torques.
# Values: masses, centres and inertias of the owners' tx40_mdh_modified.urdf. The URDF has no rotor
# inertia: Ia1.. start at 0.1 kg m^2, so that the last links are no feathers.
# Source of the data: FIGAROH, examples/staubli_TX40.
"""
PARTS = {"tx40_train.csv": slice(0, 6000), "tx40_held_out.csv": slice(6000, 9000)}


def make(path: str, raw: Sequence[Path]) -> str:
    """Return joint angles and torques from the origin's motor angles and motor torques.

    Parameters
    ----------
    path : str
        Name of the table, which is not looked at.
    raw : sequence of Path
        The origin's files of positions and of torques.
    """
    angles, motor = (pd.read_csv(one).to_numpy() for one in raw)
    by_angle, by_torque = np.diag(REDUCTION), np.diag(REDUCTION)
    by_angle[5, 4] = by_torque[4, 5] = REDUCTION[5]
    q = angles @ np.linalg.inv(by_angle).T + OFFSET
    count = len(q) // EVERY
    tau = (motor @ by_torque.T)[: count * EVERY].reshape(count, EVERY, -1).mean(axis=1)
    middle = EVERY // 2
    q = q[middle::EVERY][:count]
    table = {"t": MOTOR_STEP * (middle + EVERY * np.arange(count))}
    table |= {f"q{k}": q[:, k - 1] for k in JOINTS} | {f"tau{k}": tau[:, k - 1] for k in JOINTS}
    return as_text(pd.DataFrame(table), "%.8g")


def convert(sources: Mapping[str, Path]) -> dict[str, pd.DataFrame]:
    """Return ``tx40_train.csv``, the first 6 s, and ``tx40_held_out.csv``, the last 3 s.

    Parameters
    ----------
    sources : mapping of str to Path
        Upstream files by their path in the data set's folder.

    Returns
    -------
    dict of str to DataFrame
        Columns time_s, q1_rad..q6_rad, tau1_Nm..tau6_Nm. Time starts at the first sample.
    """
    names = {"t": "time_s"}
    names |= {f"q{k}": f"q{k}_rad" for k in JOINTS} | {f"tau{k}": f"tau{k}_Nm" for k in JOINTS}
    whole = pd.read_csv(sources["tx40_1khz.csv"]).rename(columns=names)
    return {name: from_zero(whole.iloc[part]) for name, part in PARTS.items()}


def models(sources: Mapping[str, Path]) -> dict[str, str]:
    """Return ``tx40.toml``: six rigid links of the owners' URDF, driven by joint torques."""
    columns = {"t": "time_s"}
    columns |= {f"tau{k}": f"tau{k}_Nm" for k in JOINTS}
    columns |= {f"q{k}_meas": f"q{k}_rad" for k in JOINTS}
    urdf = sources["tx40_mdh_modified.urdf"].read_text(encoding="utf-8")
    bodies = read_arm(urdf)
    text = write_arm(bodies, torques(len(bodies)), "Staubli TX40, six joints", columns)
    return {"tx40.toml": HEADER + text}
