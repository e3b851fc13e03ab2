"""Samples in which limits or contacts act: left out, counted and said, refused where all do."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.cli import main
from jaxsr.diagnosis.setup import open_recording
from jaxsr.models.formats.plant import Plant
from jaxsr.models.formats.reach import Reach
from jaxsr.models.formats.running import held, run_steps
from jaxsr.models.segments import unbroken
from jaxsr.recordings import Recording
from tests.mjcf_plants import ARM, PENDULUM, mujoco, recording, robot

STOPPED = PENDULUM.replace('damping="0.02"', 'damping="0.02" limited="true" range="-0.8 0.8"')
FLOOR = '<geom name="floor" type="plane" size="2 2 0.1" pos="0 0 {}"/></worldbody>'
WALL = '<geom name="wall" type="box" size=".1 1 1" pos="-0.4 0 1"/></worldbody>'


def driven(xml: str, samples: int = 1500) -> tuple[Recording, np.ndarray]:
    """Return a pendulum thrown against what stops it, and the states that MuJoCo had."""
    m = mujoco.MjModel.from_xml_string(xml)
    data, time = mujoco.MjData(m), np.arange(samples) * float(m.opt.timestep)
    drive, states = 1.2 * np.sin(2.0 * np.pi * 0.4 * time), np.empty((samples, 2))
    for k in range(samples):
        states[k] = data.qpos[0], data.qvel[0]
        data.ctrl = drive[k]
        mujoco.mj_step(m, data)
    return Recording("run.csv", time, {"hinge_pos": states[:, 0], "drive": drive}), states


@pytest.mark.parametrize("kind", ["limit", "contact"])
def test_what_is_left_moves_as_the_formulas_say(tmp_path: Path, kind: str) -> None:
    xml = STOPPED if kind == "limit" else PENDULUM.replace("</worldbody>", WALL)
    moved, states = driven(xml)
    found = robot(tmp_path, xml, moved)
    left = open_recording(found.model, moved)
    assert len(moved) - 400 < len(left) < len(moved)
    free = copy.copy(found.plant.m)
    free.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    plant = Plant(found.plant.path, free)
    own = states[np.isin(moved.time, left.time)]
    drive = left.channels["drive"][:, None]
    parts = unbroken(left.time)
    assert len(parts) > 2
    for first, last in parts:
        part = slice(first, last)
        controls = held(left.time[part], drive[part], "zero")
        assert run_steps(plant, own[first], left.time[part], controls) == pytest.approx(
            own[part], abs=1e-9
        )
    # Where nothing is left out, the same run misses.
    controls = held(moved.time, moved.channels["drive"][:, None], "zero")
    whole = run_steps(plant, states[0], moved.time, controls)
    assert np.abs(whole - states).max() > 0.1
    # Each stretch left out is a break in the rows, and they are counted.
    (row,) = [r for r in left.remarks if r.check == "masked"]
    assert f"of {len(moved)} samples are left out" in row.message
    assert ("joint 'hinge' is at its limit" in row.message) == (kind == "limit")
    assert ("touch in" in row.message) == (kind == "contact")
    assert open_recording(found.model, left).time.size == left.time.size


def test_a_joint_at_rest_on_its_limit_is_left_out(tmp_path: Path) -> None:
    moved = recording(300, drive=0.0)
    swing = 0.8 - 0.2 * (1.0 + np.sin(4.0 * moved.time))
    swing[100:180] = 0.8
    swing += 1e-3 * np.random.default_rng(1).normal(size=300)
    resting = Recording("run.csv", moved.time, {**moved.channels, "hinge_pos": swing})
    left = open_recording(robot(tmp_path, STOPPED, resting).model, resting)
    assert not np.isin(moved.time[100:180], left.time).any()
    inside = Recording("run.csv", moved.time, {**moved.channels, "hinge_pos": swing - 0.1})
    assert open_recording(robot(tmp_path, STOPPED, inside).model, inside) is inside


def test_a_recording_with_nothing_left_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    xml = PENDULUM.replace("</worldbody>", FLOOR.format(0.6))
    (tmp_path / "robot.xml").write_text(xml)
    data = tmp_path / "run.csv"
    rows = [f"{k / 100},{0.05 * np.sin(k / 5):.6f},0" for k in range(60)]
    data.write_text("\n".join(["time,hinge_pos,drive", *rows]))
    assert main(["diagnose", str(tmp_path / "robot.xml"), str(data), "--out", f"{tmp_path}/o"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "geoms 'floor' and " in line and "touch in 60 samples" in line and "run.csv" in line
    assert not (tmp_path / "robot.toml").exists()


def test_angles_in_degrees_are_held_against_the_range(tmp_path: Path) -> None:
    xml = ARM.replace("damping='0.03'", "damping='0.03' limited='true' range='-30 30'")
    moved = recording(100, shoulder_pos=0.0, m1=0.0, m2=0.0)
    beyond = np.minimum(40.0 * np.sin(4.0 * moved.time), 30.5)
    degrees = Recording("run.csv", moved.time, {**moved.channels, "elbow_deg": beyond})
    found = robot(tmp_path, xml, degrees)
    assert found.model.readings["q_elbow_meas"] == "q_elbow*180/pi"
    left = open_recording(found.model, degrees)
    assert left.channels["elbow_deg"].max() < 30.0 and len(left) < 100


def test_a_sidecars_forces_are_not_run_through_a_limit(tmp_path: Path) -> None:
    moved, _ = driven(STOPPED, 800)
    found = robot(tmp_path, STOPPED, moved)
    assert isinstance(found.model.within, Reach)
    text = '[model]\nbase = "robot.xml"\n[additions]\nv_hinge = "-0.1*v_hinge"\n'
    (tmp_path / "robot.toml").write_text(text)
    path = tmp_path / "run.csv"
    table = np.column_stack([moved.time, moved.channels["hinge_pos"], moved.channels["drive"]])
    np.savetxt(path, table, delimiter=",", header="time,hinge_pos,drive", comments="")
    out = str(tmp_path / "sim.csv")
    assert main(["simulate", str(tmp_path / "robot.xml"), str(path), "--out", out]) == 2
    with pytest.raises(InputError, match="nothing is left"):
        found.model.within(recording(100, hinge_pos=0.8, drive=0.0))
