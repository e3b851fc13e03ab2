"""MJCF read into formulas: MuJoCo's accelerations, columns, the sidecar, refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from jaxsr._result import InputError
from jaxsr.cli import main
from jaxsr.expressions import evaluate
from jaxsr.models import Simulator, model_text, parse_model
from jaxsr.models.formats.agreement import (
    environment,
    model_accelerations,
    mujoco_accelerations,
    random_points,
)
from jaxsr.models.formats.mjcf import Robot
from jaxsr.models.formats.opening import open_simulator
from jaxsr.models.formats.time_step import step_rows
from jaxsr.recordings import read_recording
from tests.mjcf_plants import ARM, EVERYTHING, PENDULUM, mujoco, record, recording, robot


def difference(found: Robot) -> float:
    points = random_points(found.plant, np.random.default_rng(5))
    theirs = mujoco_accelerations(found.plant, points)
    own = model_accelerations(found.plant, found.model, points)
    return float(np.abs(own - theirs).max() / np.abs(theirs).max())


def random_tree(rng: np.random.Generator, joints: int) -> str:
    """Return an MJCF with a random tree of bodies, each with one or two joints."""
    bodies: list[list[str]] = [[]]
    parent = [0]
    left = joints
    while left:
        count = min(left, int(rng.integers(1, 3)))
        left -= count
        parts = []
        for k in range(count):
            kind = "slide" if rng.random() < 0.3 else "hinge"
            axis, place = rng.normal(size=3), rng.normal(size=3) * 0.2
            parts.append(
                f'<joint name="j{left + k}" type="{kind}" axis="{_text(axis)}" '
                f'pos="{_text(place)}" damping="{rng.uniform(0.0, 0.3):.3f}" '
                f'armature="{rng.uniform(0.0, 0.2):.3f}"/>'
            )
        parts.append(
            f'<inertial pos="{_text(rng.normal(size=3) * 0.2)}" mass="{rng.uniform(0.3, 2):.3f}" '
            f'quat="{_text(rng.normal(size=4))}" diaginertia="0.03 0.025 0.02"/>'
        )
        bodies.append(parts)
        parent.append(int(rng.integers(0, len(bodies) - 1)) if len(bodies) > 2 else 0)

    def written(body: int) -> str:
        inner = "".join(written(b) for b in range(1, len(bodies)) if parent[b] == body)
        if body == 0:
            return inner
        place, turn = rng.normal(size=3) * 0.3, rng.normal(size=4)
        own = "".join(bodies[body])
        return f'<body pos="{_text(place)}" quat="{_text(turn)}">{own}{inner}</body>'

    gravity = _text(rng.normal(size=3) * 6)
    return f'<mujoco><option gravity="{gravity}"/><worldbody>{written(0)}</worldbody></mujoco>'


def _text(values: np.ndarray) -> str:
    return " ".join(f"{v:.6f}" for v in values)


@pytest.mark.parametrize("xml", [PENDULUM, ARM, EVERYTHING], ids=["pendulum", "arm", "everything"])
def test_accelerations_are_those_of_mujoco(tmp_path: Path, xml: str) -> None:
    assert difference(robot(tmp_path, xml)) < 1e-12


@pytest.mark.long
@pytest.mark.parametrize("joints", [1, 2, 3, 5, 7])
def test_random_trees_move_as_in_mujoco(tmp_path: Path, joints: int) -> None:
    xml = random_tree(np.random.default_rng(joints), joints)
    found = robot(tmp_path, xml)
    assert found.plant.m.njnt == joints
    assert difference(found) < 1e-10
    # definitions, not expansion: what a joint adds does not depend on how many there are
    assert len(model_text(found.model)) < 20_000 * joints
    assert max(len(t) for t in found.model.definitions.values()) < 2_000


def test_activations_move_as_in_mujoco(tmp_path: Path) -> None:
    found = robot(tmp_path, EVERYTHING)
    plant, model = found.plant, found.model
    points = random_points(plant, np.random.default_rng(1))
    env = environment(plant, model, points)
    data = mujoco.MjData(plant.m)
    for k in range(5):
        data.qpos, data.qvel, data.ctrl = (points[n][k] for n in ("q", "v", "u"))
        data.act = points["act"][k]
        mujoco.mj_forward(plant.m, data)
        for i, state in plant.activations.items():
            here = {n: v[k] if np.ndim(v) else v for n, v in env.items()}
            own = float(evaluate(model.equation_terms[state], here))
            theirs = data.act_dot[plant.m.actuator_actadr[i]]
            # MuJoCo's filterexact keeps the rate of a plain filter.
            assert own == pytest.approx(theirs, rel=1e-9)


def test_the_model_is_a_model_file(tmp_path: Path) -> None:
    model = robot(tmp_path, ARM).model
    again = parse_model(model_text(model))
    assert again.equations == model.equations
    assert again.parameters == model.parameters
    assert model.free_parameters == (
        "damping_shoulder",
        "armature_shoulder",
        "damping_elbow",
        "armature_elbow",
        "gain_m1",
    )
    assert model.states == ("q_shoulder", "q_elbow", "v_shoulder", "v_elbow")


def test_dry_friction_is_a_term(tmp_path: Path) -> None:
    xml = ARM.replace("damping='0.03'", "damping='0.03' frictionloss='0.2'")
    model = robot(tmp_path, xml).model
    assert "- frictionloss_elbow*sign(v_elbow)" in model.equations["v_elbow"]
    assert model.parameters["frictionloss_elbow"].bounds == (0.0, 2.0)


# -- refusals -----------------------------------------------------------------------------------

BALL = '<body><joint type="ball" name="b"/><geom size=".1"/></body></worldbody>'
FREE = '<body name="base"><freejoint name="f"/><geom size=".1"/></body></worldbody>'
LOOP = '<equality><connect body1="fore" body2="upper" anchor="0 0 0"/></equality></mujoco>'
SPATIAL = (
    '<tendon><spatial name="rope"><site site="s1"/><site site="s2"/></spatial></tendon></mujoco>'
)
MUSCLE = '<muscle name="m3" joint="elbow" lengthrange="0 1"/></actuator>'
REFUSED = {
    "ball": (("</worldbody>", BALL), "joint 'b': is a ball joint"),
    "free": (("</worldbody>", FREE), "joint 'f': is a free joint"),
    "loop": (("</mujoco>", LOOP), "active equality constraint"),
    "muscle": (("</actuator>", MUSCLE), "actuator 'm3': has a muscle gain"),
    "fluid": (("<option ", '<option viscosity="1" '), "forces of a fluid"),
    "gravcomp": (('<body name="fore"', '<body name="fore" gravcomp="1"'), "has gravcomp"),
    "syntax": (("</mujoco>", ""), "MuJoCo cannot read it"),
    "tendon": (("</mujoco>", SPATIAL), "tendon 'rope': is a spatial tendon"),
    "site": (
        ("</actuator>", '<motor name="jet" site="s1"/></actuator>'),
        "actuator 'jet': acts on a site",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_covered_is_refused_in_a_line(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (old, new), what = REFUSED[name]
    assert old in ARM
    (tmp_path / "robot.xml").write_text(_with_sites(ARM).replace(old, new))
    data = tmp_path / "run.csv"
    data.write_text("time,shoulder_pos,elbow_pos,m1,m2\n0,0,0,0,0\n1,0,1,0,0\n2,0,0,0,0\n")
    out = tmp_path / "out"
    assert main(["diagnose", str(tmp_path / "robot.xml"), str(data), "--out", str(out)]) == 2
    errors = capsys.readouterr().err.strip().splitlines()
    assert what in errors[-1] and "robot.xml" in errors[-1]
    assert len(errors) == 1
    assert not (tmp_path / "robot.toml").exists()


def _with_sites(xml: str) -> str:
    return xml.replace(
        '<body name="fore" pos="0 0 -0.4">', '<site name="s1"/><body name="fore" pos="0 0 -0.4">'
    ).replace("<joint name='elbow'", "<site name=\"s2\"/><joint name='elbow'")


def test_a_force_that_nobody_knows_is_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("jaxsr.models.formats.formulas.passive_forces", lambda *_: None)
    with pytest.raises(InputError, match="force or inertia of joint 'hinge' differs"):
        robot(tmp_path, PENDULUM)


# -- running ------------------------------------------------------------------------------------


def test_a_control_range_is_left_out_where_it_is_never_reached(tmp_path: Path) -> None:
    inside = robot(tmp_path, PENDULUM, recording(hinge_pos=0.1, drive=1.9)).model
    beyond = robot(tmp_path, PENDULUM, recording(hinge_pos=0.1, drive=2.1)).model
    assert "ctrl_drive" not in inside.definitions
    assert beyond.definitions["ctrl_drive"] == "Max(Min(drive, 2.0), -2.0)"


def test_simulate_takes_the_steps_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(PENDULUM.replace('timestep="0.002"', 'timestep="0.005"'))
    data = record(PENDULUM, tmp_path / "run.csv", 3, samples=60, noise=0.0)
    (tmp_path / "robot.toml").write_text(
        '[model]\nbase = "robot.xml"\n[initial]\nq_hinge = 0.0\nv_hinge = 0.0\n'
    )
    out = tmp_path / "sim.csv"
    assert main(["simulate", str(path), str(data), "--out", str(out)]) == 0
    m = mujoco.MjModel.from_xml_path(str(path))
    state, recorded = mujoco.MjData(m), pd.read_csv(data)
    expected = []
    for u in recorded["drive_ctrl"]:
        expected.append(state.qpos[0])
        state.ctrl = u
        for _ in range(2):
            mujoco.mj_step(m, state)
    assert pd.read_csv(out)["hinge_pos"].to_numpy() == pytest.approx(expected, abs=1e-12)


def test_without_a_recording_a_robot_starts_where_its_file_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    xml = PENDULUM.replace('axis="0 1 0"', 'axis="0 1 0" ref="0.5"')
    xml = xml[: xml.index("<actuator>")] + "</mujoco>"
    (tmp_path / "robot.xml").write_text(xml)
    out = tmp_path / "sim.csv"
    command = ["simulate", str(tmp_path / "robot.xml"), "--duration", "1", "--dt", "0.01"]
    assert main([*command, "--out", str(out)]) == 0
    assert pd.read_csv(out)["hinge"][0] == 0.5
    assert "start: all states at rest, where the file puts them" in capsys.readouterr().out


def test_a_robot_is_opened_by_its_name(tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text(ARM)
    simulator = Simulator.from_file(tmp_path / "robot.xml")
    assert simulator.model.column("q_elbow_meas") == "elbow"
    assert simulator.model.column("m1") == "m1"


def test_the_draft_goes_elsewhere_where_the_folder_takes_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "robot.xml").write_text(PENDULUM)
    data = record(PENDULUM, tmp_path / "run.csv", 3, samples=20)
    from jaxsr.models.formats import mjcf

    plain = mjcf.atomic_write_text

    def refusing(path: Path, text: str) -> None:
        if path.parent == tmp_path:
            raise InputError("cannot be written", str(path))
        plain(path, text)

    monkeypatch.setattr(mjcf, "atomic_write_text", refusing)
    opened = open_simulator(str(tmp_path / "robot.xml"), (), [str(data)], tmp_path / "out")
    assert opened.drafted == tmp_path / "out" / "robot.toml"


def test_a_time_step_that_shows_is_said(tmp_path: Path) -> None:
    path = record(PENDULUM, tmp_path / "run.csv", 3, samples=150)
    found = robot(tmp_path, PENDULUM.replace("0.002", "0.01"), read_recording(path))
    ((row),) = step_rows(found, found.recordings, 1.0, 0.01)
    assert row["check"] == "time_step" and "robot.xml (0.01 s)" in row["message"]
    assert step_rows(found, found.recordings, 1.0, 10.0) == []
