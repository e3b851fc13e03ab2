"""URDF read through MuJoCo: repairs that are said, efforts by name, damping and friction back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.models import Edit, Parameter, apply_edit
from jaxsr.models.formats.agreement import (
    model_accelerations,
    mujoco_accelerations,
    random_points,
)
from jaxsr.models.formats.mjcf import Robot
from jaxsr.models.formats.opening import read_robot
from jaxsr.models.formats.write_back import write_back
from jaxsr.recordings import Recording
from tests.mjcf_plants import mujoco

ROBOT = """\
<?xml version="1.0"?>
<!-- an arm of two links -->
<robot name="arm">
  <material name="grey"><color rgba="1 1 1 1"/></material>
  <link name="base"/>
  <joint name="joint_1" type="revolute">
    <origin xyz="0 0 0.3" rpy="0 0.2 0"/>
    <parent link="base"/>
    <child link="upper"/>
    <axis xyz="0 1 0"/>
    <limit effort="20" lower="-3" upper="3" velocity="5"/>
    <dynamics damping="0.1" friction="0.0"/>
  </joint>
  <link name="upper">
    <visual><geometry><mesh filename="package://arm/meshes/upper.stl"/></geometry></visual>
    <inertial>
      <mass value="2"/>
      <origin xyz="0 0 0.2"/>
      <inertia ixx="0.03" ixy="0.001" ixz="0" iyy="0.03" iyz="0" izz="0.01"/>
    </inertial>
  </link>
  <joint name="joint_2" type="continuous">
    <origin xyz="0 0 0.4"/>
    <parent link="upper"/>
    <child link="fore"/>
    <axis xyz="0 1 0"/>
  </joint>
  <link name="fore">
    <inertial>
      <mass value="1"/>
      <origin xyz="0 0 0.15"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.002"/>
    </inertial>
  </link>
  <joint name="tool" type="fixed"><parent link="fore"/><child link="flange"/></joint>
</robot>
"""


def robot(tmp_path: Path, text: str = ROBOT, **columns: float) -> Robot:
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    time = np.arange(20) * 0.01
    data = [Recording("run.csv", time, {n: np.full(20, v) for n, v in columns.items()})]
    return read_robot(path, None, data if columns else [])


def said(found: Robot) -> list[str]:
    return [c["message"] for c in found.checks if c["check"] == "repair"]


def test_a_urdf_moves_as_mujoco_says(tmp_path: Path) -> None:
    found = robot(tmp_path)
    points = random_points(found.plant, np.random.default_rng(5))
    theirs = mujoco_accelerations(found.plant, points)
    own = model_accelerations(found.plant, found.model, points)
    assert own == pytest.approx(theirs, rel=1e-9)
    assert found.model.inputs == ("joint_1", "joint_2")
    assert found.model.units["joint_1"] == "N*m"
    assert found.model.free_parameters == ("damping_joint_1",)
    assert found.model.input_hold == "linear"


def test_efforts_and_angles_are_found_by_number(tmp_path: Path) -> None:
    found = robot(tmp_path, q1=0.1, q2=0.1, tau1=0.0, tau2=0.0)
    roles = ("q_joint_1_meas", "q_joint_2_meas", "joint_1", "joint_2")
    assert [found.model.column(r) for r in roles] == ["q1", "q2", "tau1", "tau2"]


BROKEN = {
    "shapes": (ROBOT, "shapes of links are left out"),
    "undeclared": (ROBOT, "link 'flange' is declared nowhere"),
    "effort": (ROBOT, "limits of effort are left out"),
    "tags": (
        ROBOT.replace("</robot>", "<gazebo/><transmission name='t'/></robot>"),
        "left out as no mechanics: <gazebo>, <transmission>",
    ),
    "prefix": (
        ROBOT.replace("</robot>", '<xacro:property name="x"/></robot>'),
        "the prefix xacro: is declared nowhere",
    ),
    "massless": (
        ROBOT[: ROBOT.rindex('<link name="fore">')]
        + '<link name="fore"/>'
        + ROBOT[ROBOT.rindex('  <joint name="tool"') :],
        "link 'fore' has no inertia",
    ),
    "no body": (ROBOT.replace('izz="0.01"', 'izz="0.09"'), "no body has the moments of inertia"),
    "no moments": (
        ROBOT.replace('ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.002"', ""),
        "link 'fore' has no moments of inertia",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_every_repair_is_said(tmp_path: Path, name: str) -> None:
    text, what = BROKEN[name]
    assert any(line.startswith(what) for line in said(robot(tmp_path, text)))


def test_what_needs_no_repair_is_not_mended(tmp_path: Path) -> None:
    whole = ROBOT.replace('<link name="base"/>', '<link name="base"/><link name="flange"/>')
    bare = whole[: whole.index("    <visual>")] + whole[whole.index("    <inertial>") :]
    assert said(robot(tmp_path, bare.replace('effort="20" ', ""))) == []


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ('type="continuous"', 'type="floating"', "joint 'joint_2': is floating"),
        ('<axis xyz="0 1 0"/>\n  </joint>', '<mimic joint="joint_1"/></joint>', "mimics another"),
        ("</robot>", "", "is no XML"),
        ("robot", "sdf", "is no URDF: its root is <sdf>"),
        ('<parent link="upper"/>', "", "joint 'joint_2': has no parent"),
        ("<!-- an arm of two links -->", '<!DOCTYPE x [<!ENTITY e "f">]>', "declares entities"),
    ],
)
def test_what_is_not_covered_is_refused(tmp_path: Path, old: str, new: str, what: str) -> None:
    with pytest.raises(InputError) as error:
        robot(tmp_path, ROBOT.replace(old, new))
    assert what in str(error.value) and "\n" not in str(error.value)


def test_damping_and_friction_are_written_into_the_urdf(tmp_path: Path) -> None:
    found = robot(tmp_path)
    equations = found.model.equations
    edit = {
        "equations.v_joint_1": f"{equations['v_joint_1']} - Fc*sign(v_joint_1)",
        "equations.v_joint_2": f"{equations['v_joint_2']} - Fv*v_joint_2 - k1*q_joint_2",
        **{f"parameters.{n}": Parameter(v) for n, v in (("Fc", 0.5), ("Fv", 0.2), ("k1", 3.0))},
    }
    explained = apply_edit(found.model, Edit(edit))
    rows = {
        "Fc": ("coulomb_friction", 1),
        "Fv": ("viscous_damping", 2),
        "k1": ("linear_stiffness", 2),
    }
    findings = [
        {"site": f"equation:v_joint_{k}", "mechanism": m, "parameters": {n: {}}}
        for n, (m, k) in rows.items()
    ]
    back = write_back(found.plant, found.model, explained, findings, tmp_path / "out")
    assert set(back.files) == {"explained.xml", "explained.urdf"}
    text = back.files["explained.urdf"]
    assert '<dynamics damping="0.1" friction="0.5"/>' in text
    assert '<joint name="joint_2" type="continuous"><dynamics damping="0.2" friction="0"/>' in text
    assert "<!-- an arm of two links -->" in text and "package://arm" in text
    m = mujoco.MjModel.from_xml_string(back.files["explained.xml"])
    assert list(m.dof_damping) == [0.1, 0.2] and list(m.dof_frictionloss) == [0.5, 0.0]
    assert list(m.jnt_stiffness) == [0.0, 3.0] and m.nu == 2
