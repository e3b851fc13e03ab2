"""The page on robots: its file and log give the sidecar that it shows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from docs_blocks import ROOT, Block, blocks

from jaxsr.models.formats.mjcf import Robot, read_mjcf
from jaxsr.models.formats.opening import open_simulator

pytest.importorskip("mujoco", reason="needs MuJoCo (the extra `mujoco`)")
BLOCKS: dict[str, Block] = {b.title: b for b in blocks(ROOT / "docs" / "robots.md") if b.title}


def log(folder: Path, *columns: str) -> Path:
    """Write a log of a small motion."""
    time = np.arange(200) / 100
    signals = [0.3 * np.sin(3 * time), 0.4 * np.sin(3 * time + 0.3)]
    table = dict(zip(columns, [time, *signals], strict=True))
    pd.DataFrame(table).to_csv(folder / "run1.csv", index=False)
    return folder / "run1.csv"


def test_the_first_call_drafts_the_sidecar_of_the_page(tmp_path: Path) -> None:
    (tmp_path / "pendulum.xml").write_text(BLOCKS["pendulum.xml"].text)
    data = log(tmp_path, *BLOCKS["run1.csv"].text.strip().split(","))
    opened = open_simulator(str(tmp_path / "pendulum.xml"), (), [str(data)], tmp_path)
    assert opened.drafted == tmp_path / "pendulum.toml"
    assert (tmp_path / "pendulum.toml").read_text() == BLOCKS["pendulum.toml"].text


def test_gains_of_the_page_are_those_of_the_model(tmp_path: Path) -> None:
    (tmp_path / "pendulum.xml").write_text(BLOCKS["pendulum.xml"].text)
    (tmp_path / "servo.toml").write_text(BLOCKS["servo.toml"].text)
    data = log(tmp_path, "time", "hinge_pos", "hinge_target")
    found: Robot = read_mjcf(tmp_path / "pendulum.xml", tmp_path / "servo.toml", [data])
    assert "kp_drive*(drive - q_hinge) - kv_drive*v_hinge" in found.model.equations["v_hinge"]
    assert found.model.parameters["kp_drive"].value == 30.0


def test_switches_of_the_page_are_known(tmp_path: Path) -> None:
    text = next(b.text for b in blocks(ROOT / "docs" / "robots.md") if "fixed_base" in b.text)
    (tmp_path / "robot.toml").write_text(text)
    xml = BLOCKS["pendulum.xml"].text.replace(
        '<body name="rod" pos="0 0 1">',
        '<body name="base"><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        '<body name="rod">',
    )
    (tmp_path / "robot.xml").write_text(xml.replace("</worldbody>", "</body></worldbody>"))
    data = log(tmp_path, "time", "hinge_pos", "drive_ctrl")
    assert read_mjcf(tmp_path / "robot.xml", None, [data]).model.states == ("q_hinge", "v_hinge")
