"""The page on robots: its file and log give the sidecar that it shows."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from docs_blocks import ROOT, Block, blocks

import jaxsr
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


@pytest.mark.slow
def test_the_command_of_the_page_finds_the_friction_that_the_file_lacks(tmp_path: Path) -> None:
    """Three runs of MuJoCo itself, with dry friction of 0.3 N m in the hinge."""
    mujoco: Any = pytest.importorskip("mujoco")

    (tmp_path / "pendulum.xml").write_text(BLOCKS["pendulum.xml"].text)
    plant = mujoco.MjModel.from_xml_path(str(tmp_path / "pendulum.xml"))
    plant.dof_frictionloss[0] = 0.3
    plant.dof_solref[0] = (0.001, 1.0)  # friction that holds, as that of a real joint does
    for number in (1, 2, 3):
        rng, state = np.random.default_rng(number), mujoco.MjData(plant)
        rows = []
        for sample in range(400):
            state.ctrl[0] = rng.uniform(-1.5, 1.5) if sample % 25 == 0 else state.ctrl[0]
            angle = state.qpos[0] + 1e-4 * rng.normal()
            rows.append((0.01 * sample, angle, state.ctrl[0]))
            mujoco.mj_step(plant, state, 5)
        columns = BLOCKS["run1.csv"].text.strip().split(",")
        pd.DataFrame(rows, columns=columns).to_csv(tmp_path / f"run{number}.csv", index=False)
    (line,) = (b.text for b in blocks(ROOT / "docs" / "robots.md") if b.language == "console")
    environment = {"PYTHONPATH": str(ROOT), "PATH": "", "JAXSR_CLOCK": "processor"}
    words = [sys.executable, "-m", *shlex.split(line), "--budget", "60"]
    subprocess.run(words, cwd=tmp_path, env=environment, check=True, timeout=1200)
    found: Any = jaxsr.load(tmp_path / "result")
    assert "coulomb_friction" in [f.mechanism for f in found.findings]
    assert "frictionloss" in (tmp_path / "result" / "explained.xml").read_text()
