"""Logs of targets and angles alone: the controller's loop is part of the model; held bases."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.models import Edit, Parameter, apply_edit
from jaxsr.models.formats.mjcf import Robot, read_mjcf
from jaxsr.models.formats.write_back import write_back
from jaxsr.recordings import Recording
from tests.mjcf_plants import ARM, mujoco, recording, robot

LIMITED = ARM.replace('joint="elbow"/>', 'joint="elbow" ctrlrange="-3 3" ctrllimited="true"/>')
GAINS = {"m1": (40.0, 2.0), "m2": (15.0, 0.8)}
FLOATING = """\
<mujoco>
  <asset><mesh name="shell" file="shell.obj"/></asset>
  <worldbody>
    <body name="base" pos="0 0 1">
      <freejoint/>
      <inertial pos="0 0 0" mass="5" diaginertia="1 1 1"/>
      <geom type="mesh" mesh="shell"/>
      <geom name="box" type="box" size=".2 .2 .2"/>
      <body name="leg">
        <joint name="hip" axis="0 1 0" damping="1"/>
        <inertial pos="0 0 -0.2" mass="1" diaginertia="0.01 0.01 0.01"/>
        <geom name="bar" type="box" size=".1 .1 .3"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="hip_drive" joint="hip"/></actuator>
  <keyframe><key name="home" qpos="0 0 1 1 0 0 0 0.3"/></keyframe>
</mujoco>
"""


def logged(seed: int, samples: int = 2000, noise: float = 5e-5) -> Recording:
    """Let controllers follow targets at 500 Hz, and log targets and angles at 200 Hz."""
    m, rng = mujoco.MjModel.from_xml_string(LIMITED), np.random.default_rng(seed)
    m.opt.timestep, data = 0.0005, mujoco.MjData(m)
    time = np.arange(samples) * 0.005
    target = np.zeros((samples, 2))
    for j in range(2):
        for _ in range(5):
            phase = 2 * np.pi * rng.uniform(0.1, 1.5) * time + rng.uniform(0.0, 6.28)
            target[:, j] += rng.normal() * np.sin(phase)
        target[:, j] *= 0.6 / np.abs(target[:, j]).max()
    kp, kv = np.array(list(GAINS.values())).T
    angle = np.empty((samples, 2))
    for k in range(samples):
        angle[k] = data.qpos
        for _ in range(10):
            force = kp * (target[k] - data.qpos) - kv * data.qvel
            data.ctrl = force / (5.0, 1.0)  # the shoulder's motor has a gear
            mujoco.mj_step(m, data)
    angle += noise * rng.normal(size=angle.shape)
    names = ("shoulder_pos", "elbow_pos", "shoulder_target", "elbow_target")
    table = np.column_stack([angle, target])
    return Recording("run.csv", time, dict(zip(names, table.T, strict=True)))


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return robot(tmp_path_factory.mktemp("loops"), LIMITED, logged(3), logged(4))


def test_targets_put_loops_around_the_motors(found: Robot) -> None:
    """The model has the loops; their gains are those of the controller, damping beside kv."""
    assert [found.model.column(u) for u in ("m1", "m2")] == ["shoulder_target", "elbow_target"]
    for name, (kp, kv) in GAINS.items():
        own = found.model.parameters
        assert own[f"kp_{name}"].value == pytest.approx(kp, rel=0.1)
        assert own[f"kv_{name}"].value == pytest.approx(kv, rel=0.15)
        assert own[f"kp_{name}"].free and not own[f"kv_{name}"].free
    # The motor's range holds the loop's force, not the target.
    assert found.model.definitions["force_m2"].startswith("Max(Min(kp_m2*(m2 - q_elbow)")
    assert "ctrl_m2" not in found.model.definitions
    (said,) = [c["message"] for c in found.checks if c["check"] == "servos"]
    assert "estimated from the recordings" in said and "cannot be told apart" in said


def test_a_draft_with_loops_reads_back_as_it_was(found: Robot) -> None:
    path = found.plant.path
    path.with_suffix(".toml").write_text(found.drafted)
    again = read_mjcf(path, None, [logged(3), logged(4)])
    assert again.model == found.model
    assert again.plant.loops.keys() == found.plant.loops.keys()


def test_gains_that_a_sidecar_states_are_fixed(tmp_path: Path) -> None:
    head = '[model]\nbase = "robot.xml"\n[servos]\n'
    table = "m1 = { kp = 40.0, kv = 2.0 }\nm2 = { kp = 15.0 }\n"
    (tmp_path / "robot.toml").write_text(head + table)
    model = robot(tmp_path, LIMITED, logged(5, 50)).model
    assert model.parameters["kp_m1"].value == 40.0 and not model.parameters["kp_m1"].free
    assert "kv_m2" not in model.parameters
    for text in ("m3 = { kp = 1.0 }", "m1 = { kp = -1.0 }", "m1 = 3", "m1 = { kp = 1.0, ki = 1 }"):
        (tmp_path / "robot.toml").write_text(f"{head}{text}\n")
        with pytest.raises(InputError, match=r"robot\.toml \[servos\]"):
            robot(tmp_path, LIMITED, logged(5, 50))


def test_a_torque_is_no_target_and_a_target_no_torque(tmp_path: Path) -> None:
    names = ("shoulder_pos", "elbow_pos", "shoulder_torque", "shoulder_ref", "elbow_torque")
    model = robot(tmp_path, ARM, recording(**dict.fromkeys(names, 0.1))).model
    assert [model.column(u) for u in ("m1", "m2")] == ["shoulder_torque", "elbow_torque"]
    assert model.input_hold == "linear"
    servo = ARM.replace('<motor name="m2"', '<position name="m2" kp="9"')
    names = ("shoulder_pos", "elbow_pos", "shoulder_torque", "elbow_target", "elbow_torque")
    model = robot(tmp_path, servo, recording(**dict.fromkeys(names, 0.1))).model
    assert model.column("m2") == "elbow_target"


def test_gains_are_written_into_no_file_of_the_robot(found: Robot, tmp_path: Path) -> None:
    before = found.model.equations
    edit = {
        "parameters.kp_m1": Parameter(44.0, "N*m/rad", (4.0, 400.0)),
        "equations.v_elbow": f"{before['v_elbow']} - Fc*sign(v_elbow)",
        "parameters.Fc": Parameter(0.2),
    }
    explained = apply_edit(found.model, Edit(edit))
    finding = {
        "site": "equation:v_elbow",
        "mechanism": "coulomb_friction",
        "parameters": {"Fc": {}},
    }
    back = write_back(found.plant, found.model, explained, [finding], tmp_path)
    assert "kp of the controller's loop around m1 is 44" in back.said
    assert set(back.files) == {"explained.xml"}
    text = back.files["explained.xml"]
    assert text.count('frictionloss="0.2"') == 1 and '<motor name="m1"' in text


def test_a_base_that_stood_still_is_held(tmp_path: Path) -> None:
    data = recording(30, hip_pos=0.1, hip_torque=0.0)
    with pytest.raises(InputError, match="fixed_base = true"):
        robot(tmp_path, FLOATING.replace('<geom type="mesh" mesh="shell"/>', ""), data)
    head = '[model]\nbase = "robot.xml"\nfixed_base = true\n'
    (tmp_path / "robot.toml").write_text(head)
    with pytest.raises(InputError, match="contacts = false"):
        robot(tmp_path, FLOATING, data)
    (tmp_path / "robot.toml").write_text(head + "contacts = false\n")
    held = robot(tmp_path, FLOATING, data)
    assert held.model.states == ("q_hip", "v_hip")
    said = [c["message"] for c in held.checks if c["check"] == "repair"]
    assert said[0].startswith("1 meshes are absent (shell)") and "'base' is held" in said[1]
    edit = {"parameters.damping_hip": Parameter(0.4, "N*m/(rad/s)", (0.0, 10.0))}
    explained = apply_edit(held.model, Edit(edit))
    back = write_back(held.plant, held.model, explained, [], tmp_path / "out")
    assert '<joint name="hip" axis="0 1 0" damping="0.4"/>' in back.files["explained.xml"]
    assert "<freejoint/>" in back.files["explained.xml"]


def test_a_mesh_that_is_the_mass_of_a_body_is_missed(tmp_path: Path) -> None:
    start, end = FLOATING.index('<inertial pos="0 0 0"'), FLOATING.index('<geom type="mesh"')
    (tmp_path / "robot.xml").write_text(FLOATING[:start] + FLOATING[end:])
    with pytest.raises(InputError, match="mesh 'shell', which body 'base' has its mass of"):
        read_mjcf(tmp_path / "robot.xml")
