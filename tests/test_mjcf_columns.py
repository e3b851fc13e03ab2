"""Columns of recordings found by the names of a robot's elements, and its sidecar."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.models import Simulator, model_text
from jaxsr.models.formats.mjcf import Robot, read_mjcf, write_draft
from tests.mjcf_plants import ARM, mujoco, recording, robot

# -- columns ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "columns",
    [
        ("shoulder_pos", "elbow_pos", "m1_ctrl", "m2_ctrl"),
        ("q_shoulder", "q_elbow", "m1", "m2"),
        ("shoulder", "elbow", "u_m1", "tau_m2"),
        ("Shoulder [rad]", "Elbow [rad]", "shoulder torque [Nm]", "elbow torque [Nm]"),
        ("joint_shoulder_angle", "elbow_rad", "m1_torque", "motor m2"),
        ("q_shoulder_meas", "q_elbow_meas", "ctrl_m1", "ctrl_m2"),
    ],
)
def test_columns_are_found_by_name(tmp_path: Path, columns: tuple[str, ...]) -> None:
    found = robot(tmp_path, ARM, recording(**dict.fromkeys(columns, 0.1)))
    roles = ("q_shoulder_meas", "q_elbow_meas", "m1", "m2")
    assert [found.model.column(role) for role in roles] == list(columns)
    assert found.model.outputs == roles[:2]


def test_speeds_degrees_and_strangers(tmp_path: Path) -> None:
    names = ("shoulder_deg", "elbow_pos", "elbow_vel", "m1", "m2", "battery")
    found = robot(tmp_path, ARM, recording(**dict.fromkeys(names, 0.1)))
    assert found.model.readings["q_shoulder_meas"] == "q_shoulder*180/pi"
    assert found.model.units["q_shoulder_meas"] == "deg"
    assert found.model.column("v_elbow_meas") == "elbow_vel"
    said = [c["message"] for c in found.checks if c["check"] == "columns"]
    assert said and said[0].endswith("battery")


def test_sensors_have_columns_of_their_names(tmp_path: Path) -> None:
    sensor = '<sensor><jointvel name="gyro" joint="elbow"/></sensor></mujoco>'
    xml = ARM.replace("</mujoco>", sensor)
    names = ("shoulder_pos", "gyro", "m1", "m2")
    found = robot(tmp_path, xml, recording(**dict.fromkeys(names, 0.1)))
    assert found.model.readings["gyro"] == "v_elbow"
    assert found.model.column("gyro") == "gyro"


def test_columns_that_match_nothing_are_listed_with_the_names(tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        robot(tmp_path, ARM, recording(alpha=0.1, beta_1=0.2))
    text = str(error.value)
    assert "alpha, beta_1" in text and "joint elbow" in text and "actuator m2" in text
    assert "[columns] of robot.toml" in text


def test_a_column_that_may_be_two_things_is_refused_with_both(tmp_path: Path) -> None:
    xml = ARM.replace('name="m2"', 'name="elbow"')
    names = dict.fromkeys(("shoulder_pos", "elbow", "m1"), 0.1)
    with pytest.raises(InputError, match="joint 'elbow' or the control of actuator 'elbow'"):
        robot(tmp_path, xml, recording(**names))
    clear = dict.fromkeys(("shoulder_pos", "elbow_pos", "elbow_ctrl", "m1"), 0.1)
    model = robot(tmp_path, xml, recording(**clear)).model
    assert (model.column("q_elbow_meas"), model.column("elbow")) == ("elbow_pos", "elbow_ctrl")


# -- the sidecar --------------------------------------------------------------------------------


def drafted(tmp_path: Path) -> tuple[Robot, Path]:
    found = robot(tmp_path, ARM, recording(shoulder_pos=0.1, elbow_pos=0.1, m1=0.0, m2=0.0))
    path = write_draft(found)
    assert path == tmp_path / "robot.toml"
    return found, path


def test_a_draft_is_written_once_and_read_back(tmp_path: Path) -> None:
    found, path = drafted(tmp_path)
    assert "damping_elbow = { bounds = [0.0, " in path.read_text()
    again = read_mjcf(
        tmp_path / "robot.xml", None, [recording(shoulder_pos=0, elbow_pos=0, m1=0, m2=0)]
    )
    assert again.drafted == "" and not again.edited
    assert again.model == found.model
    assert [c["check"] for c in found.checks] == ["drafted"]


def test_a_damping_that_only_quiets_a_simulation_bounds_nothing(tmp_path: Path) -> None:
    """The bound is what stops the joint's inertia within a sample; a rotor may weigh as much."""
    xml = ARM.replace("damping='0.03'", "damping='1e-6' armature='1e-7'")
    columns = dict.fromkeys(("shoulder_pos", "elbow_pos", "m1", "m2"), 0.1)
    parameters = robot(tmp_path, xml, recording(**columns)).model.parameters
    m = mujoco.MjModel.from_xml_string(xml)
    data, whole = mujoco.MjData(m), np.zeros(2)
    mujoco.mj_forward(m, data)
    mujoco.mj_mulM(m, data, whole, np.array([0.0, 1.0]))
    assert parameters["damping_elbow"].bounds == pytest.approx((0.0, whole[1] / 0.01), rel=0.01)
    assert parameters["armature_elbow"].bounds == pytest.approx((0.0, whole[1]), rel=0.01)


def test_what_a_sidecar_says_holds(tmp_path: Path) -> None:
    _, path = drafted(tmp_path)
    text = re.sub(r"damping_elbow = .*\n", "", path.read_text())
    text = text.replace('input_hold = "zero"', 'input_hold = "linear"')
    text = text.replace(
        "\n[units]",
        'mass_fore = { bounds = [0.1, 2.0] }\nFc = { value = 0.1, unit = "N*m" }\n\n[units]',
    )
    path.write_text(text + '\n[additions]\nv_elbow = "-Fc*sign(v_elbow)"\n')
    found = read_mjcf(tmp_path / "robot.xml")
    assert not found.model.parameters["damping_elbow"].free
    assert found.model.parameters["mass_fore"].bounds == (0.1, 2.0)
    assert found.model.input_hold == "linear" and found.edited
    term = found.model.equation_terms["v_elbow"]
    assert any(node.op == "sign" for node in term.distinct())


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ('[model]\nbase = "other.xml"\n', "base is not robot.xml"),
        ('[model]\nbase = "robot.xml"\n[equations]\nx = "1"\n', "unknown table [equations]"),
        ('[model]\nbase = "robot.xml"\nstates = ["x"]\n', "unknown key 'states'"),
        ('[model]\nbase = "robot.xml"\n[parameters]\nfoo = 1\n', "unknown parameter 'foo'"),
    ],
)
def test_a_wrong_sidecar_is_refused(tmp_path: Path, text: str, what: str) -> None:
    (tmp_path / "robot.toml").write_text(text)
    with pytest.raises(InputError) as error:
        robot(tmp_path, ARM)
    assert what in str(error.value) and "\n" not in str(error.value)


def test_the_sidecar_alone_names_its_robot(tmp_path: Path) -> None:
    drafted(tmp_path)
    with pytest.raises(InputError, match=r"sidecar of robot\.xml"):
        Simulator.from_file(tmp_path / "robot.toml")


def test_a_formula_model_beside_gives_its_columns(tmp_path: Path) -> None:
    found = robot(tmp_path, ARM, recording(a_pos=0, shoulder_pos=0, elbow_pos=0, m1=0, m2=0))
    (tmp_path / "robot.toml").write_text(model_text(found.model))
    again = read_mjcf(tmp_path / "robot.xml")
    assert again.model.columns == found.model.columns
