"""Unitree Go2 with its base held: twelve position servos, targets and angles at 200 Hz.

The recording is a row of linear moves to and fro, each faster than the one before. The last third
is a recording of its own, to be held out. Neither speed nor torque is recorded, and the uniform
time was put on by the owners. A model is one leg of the owners' MJCF, three joints, with the
controller's gains from their configuration; the base is level.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from jaxsr.datasets.arm import write_arm
from jaxsr.datasets.drives import servos
from jaxsr.datasets.mjcf import read_leg
from jaxsr.datasets.tables import from_zero

KP, KD = 20.0, 1.5
"""Gains of the controller in N m/rad and N m s/rad, from the owners' config.py."""
HEADER = """\
# Unitree Go2, one leg with the base held level: hip, thigh and calf, driven by position servos.
# Values: masses, centres, inertias, damping d, dry friction Fc and armature Ia of the owners'
# go2.xml; gains kp and kd of their config.py. Fixed are the gains and the masses.
# Source of the data: iit-DLSLab, sim2real-robot-identification.
"""
LEGS = ("FL", "FR", "RL", "RR")
JOINTS = ("hip", "thigh", "calf")
PARTS = {"go2_train.csv": slice(0, 3132), "go2_held_out.csv": slice(3132, 4698)}


def convert(sources: Mapping[str, Path]) -> dict[str, pd.DataFrame]:
    """Return ``go2_train.csv``, the first 15.7 s, and ``go2_held_out.csv``, the last 7.8 s.

    Parameters
    ----------
    sources : mapping of str to Path
        Files by their path in the data set's folder.

    Returns
    -------
    dict of str to DataFrame
        Columns time_s, then q_<leg>_<joint>_rad measured and target_<leg>_<joint>_rad commanded.
        Time starts at the first sample.
    """
    whole = pd.read_csv(sources["traj_0.csv"])
    whole.columns = ["time_s", *(f"{c.replace('qdes', 'target')}_rad" for c in whole.columns[1:])]
    return {name: from_zero(whole.iloc[part]) for name, part in PARTS.items()}


def models(sources: Mapping[str, Path]) -> dict[str, str]:
    """Return ``go2.toml``, the front left leg, and ``go2_<leg>.toml`` for the others."""
    xml = sources["go2.xml"].read_text(encoding="utf-8")
    return {f"go2{'' if leg == LEGS[0] else f'_{leg}'}.toml": _leg(xml, leg) for leg in LEGS}


def _leg(xml: str, leg: str) -> str:
    bodies, passive = read_leg(xml, f"{leg}_hip")
    columns = {"t": "time_s"}
    columns |= {f"target{k}": f"target_{leg}_{j}_rad" for k, j in enumerate(JOINTS, start=1)}
    columns |= {f"q{k}_meas": f"q_{leg}_{j}_rad" for k, j in enumerate(JOINTS, start=1)}
    drives = servos(KP, KD, passive)
    text = write_arm(bodies, drives, f"Unitree Go2, {leg} leg", columns, fixed_masses=True)
    return HEADER + text
