"""The rigid-body model that is written from a URDF, against MuJoCo and laws of mechanics."""

from __future__ import annotations

import math
from xml.etree import ElementTree

import numpy as np
import pytest

from jaxsr import Simulator
from jaxsr._result import InputError
from jaxsr.datasets.arm import arm_model
from jaxsr.datasets.urdf import Body, read_arm, turned
from jaxsr.models.field import Field, Point
from jaxsr.models.reading import parse_model

# Quarter turns beside a skew joint, a tilted inertial, and a tool that is fixed to the last link.
URDF = """
<robot name="made up">
  <link name="world"/>
  <joint name="post" type="fixed">
    <parent link="world"/><child link="base"/><origin xyz="0 0 0.4" rpy="0 0 0.7"/>
  </joint>
  <link name="base"/>
  <joint name="a" type="revolute">
    <parent link="base"/><child link="one"/><axis xyz="0 0 1"/>
    <origin xyz="0.1 0 0.2" rpy="0 0 0"/>
  </joint>
  <link name="one"><inertial>
    <mass value="3.0"/><origin xyz="0.02 0.05 0.1" rpy="0.3 0 -0.4"/>
    <inertia ixx="0.03" ixy="0.002" ixz="-0.001" iyy="0.04" iyz="0.003" izz="0.02"/>
  </inertial></link>
  <joint name="b" type="continuous">
    <parent link="one"/><child link="two"/><axis xyz="0 1 0"/>
    <origin xyz="0 0.15 0.05" rpy="0 1.57079632679 0"/>
  </joint>
  <link name="two"><inertial>
    <mass value="2.0"/><origin xyz="0 0.01 0.25"/>
    <inertia ixx="0.05" ixy="0" ixz="0" iyy="0.06" iyz="0" izz="0.01"/>
  </inertial></link>
  <joint name="c" type="revolute">
    <parent link="two"/><child link="three"/><axis xyz="1 2 -2"/>
    <origin xyz="0 -0.1 0.5" rpy="0.2 -0.5 1.1"/>
  </joint>
  <link name="three"><inertial>
    <mass value="1.2"/><origin xyz="0.1 0 0.05"/>
    <inertia ixx="0.004" ixy="0" ixz="0.001" iyy="0.005" iyz="0" izz="0.003"/>
  </inertial></link>
  <joint name="flange" type="fixed">
    <parent link="three"/><child link="tool"/><origin xyz="0 0.1 0" rpy="0.4 0 0"/>
  </joint>
  <link name="tool"><inertial>
    <mass value="0.5"/><origin xyz="0 0 0.03"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.0015"/>
  </inertial></link>
</robot>
"""
DRIVES = np.array([0.1, 0.2, 0.3])
MODEL = parse_model(arm_model(URDF, "made up", [1.0, 2.0, 3.0], {"t": "t_s", "q1_meas": "q1"}))


def dynamics(q: np.ndarray, v: np.ndarray, **values: float) -> tuple[np.ndarray, np.ndarray]:
    """Mass matrix and loads at one state, without current."""
    values = {f"Ia{k}": drive for k, drive in enumerate(DRIVES, start=1)} | values
    simulator = Simulator(MODEL)
    field = Field(simulator, simulator.values(values))
    at = Point(0.0, [*q, *v], [0.0] * 3)
    mass = np.zeros((3, 3))
    for (row, column), (entry, _) in field.masses(at).items():
        mass[int(row[1]) - 1, int(column[1]) - 1] = entry
    forces = field.forces(at)
    return mass, -np.array([forces[f"v{k}"][0] for k in (1, 2, 3)])


def states(count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(3)
    return [(rng.uniform(-3.0, 3.0, 3), rng.normal(0.0, 2.0, 3)) for _ in range(count)]


def test_mass_matrix_and_loads_are_those_of_mujoco() -> None:
    mujoco = pytest.importorskip("mujoco")
    robot = ElementTree.fromstring(URDF)
    exactly = {"balanceinertia": "false", "boundmass": "0", "boundinertia": "0"}
    ElementTree.SubElement(ElementTree.SubElement(robot, "mujoco"), "compiler", exactly)
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(robot).decode())
    model.dof_armature[:] = DRIVES
    data = mujoco.MjData(model)
    column = np.zeros(3)
    for q, v in states(20):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        expected = np.zeros((3, 3))
        for k in range(3):  # one column at a time, whatever form MuJoCo keeps it in
            mujoco.mj_mulM(model, data, column, np.eye(3)[k])
            expected[:, k] = column
        mass, loads = dynamics(q, v)
        np.testing.assert_allclose(mass, expected, rtol=1e-9, atol=1e-9 * expected.max())
        bias = data.qfrc_bias
        np.testing.assert_allclose(loads, bias, rtol=1e-9, atol=1e-9 * np.abs(bias).max())


def test_mass_matrix_is_symmetric_and_positive() -> None:
    for q, v in states(20):
        mass, _ = dynamics(q, v)
        np.testing.assert_array_equal(mass, mass.T)
        assert np.linalg.eigvalsh(mass).min() > 0.0


def test_without_gravity_loads_do_the_work_that_inertia_stores() -> None:
    # d(v'Mv/2)/dt = v'(M dv/dt) + v'(dM/dt)v/2 is 0 in free motion, where M dv/dt = -load.
    step = 1e-5
    for q, v in states(10):
        _, loads = dynamics(q, v, g=0.0)
        ahead, behind = (dynamics(q + s * v, v)[0] for s in (step, -step))
        stored = 0.5 * v @ ((ahead - behind) / (2.0 * step)) @ v
        assert v @ loads == pytest.approx(stored, rel=1e-7, abs=1e-7)


def heights(bodies: list[Body], q: np.ndarray) -> float:
    """Sum of mass times height."""
    place, turn, total = np.zeros(3), np.eye(3), 0.0
    for body, angle in zip(bodies, q, strict=True):
        place = place + turn @ body.place
        turn = turn @ body.turn @ turned(body.axis, math.cos(angle), math.sin(angle))
        total += body.mass * place[2] + (turn @ body.moment)[2]
    return total


def test_at_rest_loads_are_the_slope_of_the_height() -> None:
    bodies, step = read_arm(URDF), 1e-6
    for q, _ in states(5):
        _, loads = dynamics(q, np.zeros(3), g=2.0)
        for k, unit in enumerate(np.eye(3)):
            ahead, behind = (heights(bodies, q + s * unit) for s in (step, -step))
            slope = (ahead - behind) / (2.0 * step)
            assert loads[k] == pytest.approx(2.0 * slope, abs=1e-7)


def test_what_is_fixed_counts_to_what_carries_it() -> None:
    bodies = read_arm(URDF)
    assert [round(body.mass, 12) for body in bodies] == [3.0, 2.0, 1.7]
    np.testing.assert_allclose(
        bodies[0].place, turned(np.eye(3)[2], *cosine(0.7)) @ [0.1, 0, 0.2] + [0, 0, 0.4]
    )
    assert set(np.abs(bodies[1].turn).ravel()) == {0.0, 1.0}  # the rounded pi/2 is exact


def cosine(angle: float) -> tuple[float, float]:
    return math.cos(angle), math.sin(angle)


def test_quarter_turns_and_zeros_leave_no_factors() -> None:
    texts = [*MODEL.definitions.values(), *MODEL.equations.values()]
    assert max(map(len, texts)) < 600
    assert not any("e-1" in text or "*1.0" in text or "0.0*" in text for text in texts)


def test_free_are_masses_and_drives() -> None:
    assert MODEL.free_parameters == ("m2", "m3", "Ia1", "Ia2", "Ia3")
    assert MODEL.columns == {"t": "t_s", "q1_meas": "q1"}
    assert MODEL.units["v3_meas"] == "rad/s"  # with all units known, reading has checked them


def test_what_is_no_serial_arm_is_refused() -> None:
    with pytest.raises(InputError, match="no XML"):
        read_arm("robot")
    with pytest.raises(InputError, match="prismatic"):
        read_arm(URDF.replace("continuous", "prismatic"))
    with pytest.raises(InputError, match="branches"):
        read_arm(URDF.replace('<parent link="two"/>', '<parent link="one"/>'))
    with pytest.raises(InputError, match="no <child>"):
        read_arm(URDF.replace('<child link="two"/>', ""))
