"""Rotors behind gears: a URDF has no word for them, the recordings tell their inertia."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.models import Edit, Parameter, apply_edit
from jaxsr.models.formats.loading import read_plant_file
from jaxsr.models.formats.mjcf import Robot
from jaxsr.models.formats.opening import read_robot
from jaxsr.models.formats.urdf import read_urdf
from jaxsr.models.formats.write_back import write_back
from jaxsr.recordings import Recording
from tests.mjcf_plants import mujoco
from tests.test_urdf import ROBOT

ROTORS = (0.3, 0.05)
HANGING = ROBOT.replace('rpy="0 0.2 0"', 'rpy="3.14159265358979 0.2 0"')


def written(tmp_path: Path) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(HANGING)
    return path


def logged(path: Path, rotors: tuple[float, float], seed: int) -> Recording:
    """Drive the arm with friction and rotors, and log angles and torques at 200 Hz."""
    plant, _ = read_urdf(path)
    m, rng = plant.m, np.random.default_rng(seed)
    m.dof_armature[:] = rotors
    m.dof_damping[:], m.dof_frictionloss[:] = (0.8, 0.3), (0.5, 0.1)
    m.opt.timestep, m.opt.integrator = 0.0005, 3
    m.dof_solref[:], m.dof_solimp[:, :3] = (0.004, 1.0), (0.99, 0.999, 0.001)
    data, time = mujoco.MjData(m), np.arange(1600) * 0.005
    torque, angle = np.zeros((1600, 2)), np.empty((1600, 2))
    for j, size in enumerate((6.0, 1.5)):
        for _ in range(5):
            phase = 2 * np.pi * rng.uniform(0.2, 2.0) * time + rng.uniform(0.0, 6.28)
            torque[:, j] += rng.normal() * np.sin(phase)
        torque[:, j] *= size / np.abs(torque[:, j]).max()
    for k in range(1600):
        angle[k] = data.qpos
        for step in range(10):  # the torque is measured: a line between samples
            later = torque[min(k + 1, 1599)]
            data.ctrl = torque[k] + (step + 0.5) / 10 * (later - torque[k])
            mujoco.mj_step(m, data)
    angle += 1e-5 * rng.normal(size=angle.shape)
    table = np.column_stack([angle, torque]).T
    return Recording("run.csv", time, dict(zip(("q1", "q2", "tau1", "tau2"), table, strict=True)))


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    path = written(tmp_path_factory.mktemp("rotors"))
    data = logged(path, ROTORS, 3)
    return read_robot(path, None, [data])


def test_recordings_tell_the_rotors(found: Robot) -> None:
    for name, value in zip(("joint_1", "joint_2"), ROTORS, strict=True):
        parameter = found.model.parameters[f"armature_{name}"]
        assert parameter.value == pytest.approx(value, rel=0.1)
        assert parameter.free and parameter.bounds is not None and parameter.bounds[0] == 0.0
    (said,) = [c["message"] for c in found.checks if c["check"] == "rotors"]
    assert "joint_1 0.3" in said or "joint_1 0.2" in said


@pytest.mark.parametrize("seed", range(3))
def test_where_there_is_no_rotor_none_is_told(tmp_path: Path, seed: int) -> None:
    path = written(tmp_path)
    data = logged(path, (0.0, 0.0), seed)
    robot = read_robot(path, None, [data])
    for j, name in enumerate(("joint_1", "joint_2")):
        parameter = robot.model.parameters.get(f"armature_{name}")
        # A few per cent of what the joint moves may be told: the sensor's smoothing.
        assert parameter is None or parameter.value < 0.05 * robot.plant.inertias[j]


def test_a_draft_with_rotors_reads_back_and_is_written_back(found: Robot, tmp_path: Path) -> None:
    path = found.plant.path
    path.with_suffix(".toml").write_text(found.drafted)
    again = read_robot(path, None, found.recordings)
    path.with_suffix(".toml").unlink()
    assert again.model == found.model and not again.edited
    edit = {"parameters.damping_joint_1": Parameter(0.9, "N*m/(rad/s)", (0.0, 10.0))}
    explained = apply_edit(again.model, Edit(edit))
    back = write_back(again.plant, again.model, explained, [], tmp_path)
    (tmp_path / "explained.xml").write_text(back.files["explained.xml"])
    m = read_plant_file(tmp_path / "explained.xml")[0].m
    assert list(m.dof_armature) == pytest.approx(list(again.plant.m.dof_armature))
    assert m.dof_damping[0] == 0.9


def test_a_rotor_that_is_none_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.with_suffix(".toml").write_text(
        '[model]\nbase = "arm.urdf"\n[parameters]\narmature_joint_1 = -1\n'
    )
    with pytest.raises(InputError, match=r"armature_joint_1 is no inertia above 0"):
        read_robot(path)
