"""What a diagnosis found, written back into MJCF: reloaded, MuJoCo moves as the formulas do."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from jaxsr.models import Edit, Model, Parameter, Simulator, apply_edit, model_text, parse_model
from jaxsr.models.formats.agreement import (
    model_accelerations,
    mujoco_accelerations,
    random_points,
)
from jaxsr.models.formats.loading import read_plant_file
from jaxsr.models.formats.mjcf import Robot, read_mjcf
from jaxsr.models.formats.plant import Plant
from jaxsr.models.formats.running import held, run_steps
from jaxsr.models.formats.summands import sum_difference, summands
from jaxsr.models.formats.write_back import WrittenBack, write_back
from jaxsr.models.simulation import simulate_to_csv
from jaxsr.recordings import Recording
from tests.mjcf_plants import ARM, EVERYTHING, mujoco

Changes = dict[str, Any]


@pytest.fixture(autouse=True)
def no_callback() -> Iterator[None]:
    yield
    mujoco.set_mjcb_passive(None)


def written(
    tmp_path: Path, xml: str, changes: Callable[[Model], Changes], site: str, mechanism: str
) -> tuple[Robot, Model, WrittenBack, Path]:
    """Edit the formulas of a robot, and write the edit back into its format."""
    (tmp_path / "robot.xml").write_text(xml)
    robot = read_mjcf(tmp_path / "robot.xml")
    edit = changes(robot.model)
    explained = parse_model(model_text(apply_edit(robot.model, Edit(edit))))
    new = [n.partition(".")[2] for n in edit if n.startswith("parameters.")]
    own = [n for n in new if n not in robot.model.parameters]
    finding = {"site": site, "mechanism": mechanism, "parameters": {n: {} for n in own}}
    out = tmp_path / "out"
    out.mkdir()
    back = write_back(robot.plant, robot.model, explained, [finding] if own else [], out)
    for name, text in back.files.items():
        (out / name).write_text(text)
    return robot, explained, back, out


def loaded(out: Path) -> Plant:
    plant = read_plant_file(out / "explained.xml")[0]
    if (out / "explained.py").exists():
        callback(out).install(plant.m)
    return plant


def callback(out: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("explained", out / "explained.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def difference(robot: Robot, explained: Model, plant: Plant) -> float:
    points = random_points(plant, np.random.default_rng(1), frozenset(plant.inputs))
    theirs = mujoco_accelerations(plant, points)
    own = model_accelerations(robot.plant, explained, points)
    return float(np.abs(theirs - own).max() / np.abs(own).max())


def term(state: str, text: str, **values: float) -> Callable[[Model], Changes]:
    def changes(model: Model) -> Changes:
        key = f"equations.{state}"
        new = {f"parameters.{n}": Parameter(v, None, (0.0, 10.0)) for n, v in values.items()}
        return {key: f"{model.equations[state]} {text}", **new}

    return changes


def inertia(model: Model) -> Changes:
    text = model.inertia["v_elbow"]["v_elbow"]
    return {"inertia.v_elbow.v_elbow": f"{text} + ma", "parameters.ma": Parameter(0.2)}


ELBOW = "equation:v_elbow"
NATIVE = {
    "viscous_damping": (term("v_elbow", "- Fv*v_elbow", Fv=0.3), ELBOW, " damping='0.33'"),
    "quadratic_drag": (
        term("v_elbow", "- kd*v_elbow*Abs(v_elbow)", kd=0.3),
        ELBOW,
        " damping='0.03 0.3'",
    ),
    "linear_stiffness": (term("v_elbow", "- k1*q_elbow", k1=3.0), ELBOW, ' stiffness="3"'),
    "quadratic_stiffness": (term("v_elbow", "- k2*q_elbow**2", k2=3.0), ELBOW, ' stiffness="0 3"'),
    "cubic_stiffness": (term("v_elbow", "- k3*q_elbow**3", k3=3.0), ELBOW, ' stiffness="0 0 3"'),
    "added_mass": (inertia, ELBOW, ' armature="0.21"'),
    "input_gain": (
        term("v_shoulder", "+ gain_m1*((g1 - 1)*m1)", g1=1.2),
        "input:m1",
        ' gear="6"',
    ),
    "input_saturation": (
        term("v_shoulder", "+ gain_m1*(Max(Min(m1, us), -us) - m1)", us=0.5),
        "input:m1",
        ' ctrlrange="-0.5 0.5" ctrllimited="true"',
    ),
}


@pytest.mark.parametrize("mechanism", NATIVE)
def test_what_has_an_attribute_is_one(tmp_path: Path, mechanism: str) -> None:
    changes, site, attribute = NATIVE[mechanism]
    robot, explained, back, out = written(tmp_path, ARM, changes, site, mechanism)
    assert attribute in back.files["explained.xml"]
    assert list(back.files) == ["explained.xml"]
    assert difference(robot, explained, loaded(out)) < 1e-12


CALLED = {
    "constant_force": (term("v_elbow", "+ F0", F0=0.3), ELBOW),
    "coupling_stiffness": (term("v_elbow", "- kc*(q_elbow - q_shoulder)", kc=0.4), ELBOW),
    "power_law_drag": (
        term("v_elbow", "- kd*tanh(20*v_elbow)*Abs(v_elbow)**p", kd=0.4, p=1.5),
        ELBOW,
    ),
    "unnamed": (
        term("v_elbow", "+ A*sin(3*q_elbow + 1)*Piecewise((1, q_elbow > 0), (0, True))", A=0.2),
        ELBOW,
    ),
    "input_deadzone": (
        term("v_shoulder", "+ gain_m1*(-Max(Min(m1, ud), -ud))", ud=0.5),
        "input:m1",
    ),
}


@pytest.mark.parametrize("mechanism", CALLED)
def test_what_has_none_is_called(tmp_path: Path, mechanism: str) -> None:
    changes, site = CALLED[mechanism]
    robot, explained, back, out = written(tmp_path, ARM, changes, site, mechanism)
    assert set(back.files) == {"explained.xml", "explained.py"}
    assert back.files["explained.xml"] == ARM
    assert difference(robot, explained, loaded(out)) < 1e-12


def test_every_value_finds_its_place(tmp_path: Path) -> None:
    def changes(model: Model) -> Changes:
        return {
            f"parameters.{n}": replace(p, value=1.1 * p.value)
            for n, p in model.parameters.items()
            if n != "metre"
        }

    robot, explained, back, out = written(tmp_path, EVERYTHING, changes, "", "")
    assert not [line for line in back.said if "alone" in line]
    assert difference(robot, explained, loaded(out)) < 1e-12


def test_only_the_tags_of_the_change_differ(tmp_path: Path) -> None:
    changes, site, _ = NATIVE["viscous_damping"]
    _, _, back, _ = written(tmp_path, ARM, changes, site, "viscous_damping")
    lines = zip(ARM.splitlines(), back.files["explained.xml"].splitlines(), strict=True)
    changed = [(a.strip(), b.strip()) for a, b in lines if a != b]
    assert changed == [
        ("<joint name='elbow' damping='0.03'/>", "<joint name='elbow' damping='0.33'/>")
    ]


def test_a_class_that_joints_share_stays_as_it_is(tmp_path: Path) -> None:
    changes = term("v_shoulder", "- Fv*v_shoulder", Fv=0.3)
    _, _, back, out = written(tmp_path, ARM, changes, "equation:v_shoulder", "viscous_damping")
    text = back.files["explained.xml"]
    assert '<joint axis="0 1 0" damping="0.05" armature="0.01"/>' in text
    assert '<joint name="shoulder" damping="0.35"/>' in text
    assert "<!-- shoulder -->" in text
    assert list(read_plant_file(out / "explained.xml")[0].m.dof_damping) == pytest.approx(
        [0.35, 0.03]
    )


def test_what_is_included_is_followed(tmp_path: Path) -> None:
    start, end = ARM.index("<worldbody>"), ARM.index("  <actuator>")
    (tmp_path / "parts").mkdir()
    body = f"<mujocoinclude>\n<!-- the links -->\n{ARM[start:end]}</mujocoinclude>\n"
    (tmp_path / "parts" / "body.xml").write_text(body)
    extra = '<mujocoinclude><option gravity="0 0 -9"/></mujocoinclude>'
    (tmp_path / "parts" / "extra.xml").write_text(extra)
    xml = ARM[:start] + '<include file="parts/body.xml"/>\n' + ARM[end:]
    xml = xml.replace("</mujoco>", '<include file="parts/extra.xml"/></mujoco>')
    changes, site, _ = NATIVE["cubic_stiffness"]
    robot, explained, back, out = written(tmp_path, xml, changes, site, "cubic_stiffness")
    assert set(back.files) == {"explained.xml", "explained_body.xml"}
    assert "<!-- the links -->" in back.files["explained_body.xml"]
    assert '<include file="../parts/extra.xml"/>' in back.files["explained.xml"]
    assert difference(robot, explained, loaded(out)) < 1e-12


def test_the_springs_of_joints_in_degrees(tmp_path: Path) -> None:
    xml = ARM.replace("damping='0.03'", "damping='0.03' stiffness='2' springref='30'")
    changes = term("v_elbow", "- k1*q_elbow", k1=2.0)
    robot, explained, back, out = written(tmp_path, xml, changes, ELBOW, "linear_stiffness")
    assert "stiffness='4' springref='15'" in back.files["explained.xml"]
    assert difference(robot, explained, loaded(out)) < 1e-12


def test_dry_friction_is_written_with_tight_values_and_holds(tmp_path: Path) -> None:
    changes = term("v_elbow", "- Fc*sign(v_elbow)", Fc=0.2)
    _, explained, back, out = written(tmp_path, ARM, changes, ELBOW, "coulomb_friction")
    assert "explained.py" not in back.files
    assert ' frictionloss="0.2" solreffriction="0.004 1"' in back.files["explained.xml"]
    time = np.arange(200) * 0.01
    u = np.stack([2.0 * np.sin(5 * time), np.sin(7 * time)], axis=1)
    recording = Recording("run", time, {"m1": u[:, 0], "m2": u[:, 1]})
    still = replace(explained, initial=dict.fromkeys(explained.states, 0.0))
    table = simulate_to_csv(Simulator(still), recording)
    path = run_steps(loaded(out), np.zeros(4), time, held(time, u, "zero"), 4)
    own = table[["shoulder", "elbow"]].to_numpy()
    assert np.abs(path[:, :2] - own).max() < 0.02 * np.abs(own).max()


def test_friction_that_changes_with_speed_holds_still(tmp_path: Path) -> None:
    law = "- (Fc + (Fs - Fc)*exp(-(Abs(v_elbow)/vs)**2))*sign(v_elbow)"
    changes = term("v_elbow", law, Fc=0.1, Fs=0.25, vs=0.3)
    _, explained, back, out = written(tmp_path, ARM, changes, ELBOW, "stribeck_friction")
    assert "model.dof_frictionloss[1] = max((Fc+(Fs-Fc)*exp(" in back.files["explained.py"]
    time = np.arange(200) * 0.01
    u = np.stack([2.0 * np.sin(5 * time), np.sin(7 * time)], axis=1)
    recording = Recording("run", time, {"m1": u[:, 0], "m2": u[:, 1]})
    still = replace(explained, initial=dict.fromkeys(explained.states, 0.0))
    own = simulate_to_csv(Simulator(still), recording)[["shoulder", "elbow"]].to_numpy()
    path = run_steps(loaded(out), np.zeros(4), time, held(time, u, "zero"), 4)
    assert np.abs(path[:, :2] - own).max() < 0.02 * np.abs(own).max()
    # Below breakaway nothing moves.
    mujoco.set_mjcb_passive(None)
    plant = loaded(out)
    plant.m.opt.gravity[:] = 0.0
    push = held(time, np.tile([0.0, 0.1], (200, 1)), "zero")
    rest = run_steps(plant, np.array([0.0, 0.0, 0.0, 0.0]), time, push)
    assert np.abs(rest[:, 1]).max() < 1e-3


def test_where_constraints_are_off_dry_friction_is_called(tmp_path: Path) -> None:
    xml = ARM.replace('integrator="implicitfast"/>', '><flag constraint="disable"/></option>')
    changes = term("v_elbow", "- Fc*sign(v_elbow)", Fc=0.2)
    _, _, back, _ = written(tmp_path, xml, changes, ELBOW, "coulomb_friction")
    assert back.files["explained.xml"] == xml
    assert "+= - Fc*sign(v_elbow)" in back.files["explained.py"]


def test_a_lag_is_a_filter(tmp_path: Path) -> None:
    def changes(model: Model) -> Changes:
        equations = model.equations["v_shoulder"].replace("gain_m1*m1", "gain_m1*uf")
        assert "uf" in equations
        return {
            "model.states": (*model.states, "uf"),
            "equations.v_shoulder": equations,
            "equations.uf": "(m1 - uf)/tau",
            "parameters.tau": Parameter(0.05),
        }

    _, _, back, out = written(tmp_path, ARM, changes, "input:m1", "actuator_lag")
    tag = '<general name="m1" joint="shoulder" gear="5" dyntype="filterexact" dynprm="0.05"/>'
    assert tag in back.files["explained.xml"] and list(back.files) == ["explained.xml"]
    assert loaded(out).m.na == 1


def test_a_memory_is_integrated_by_the_callback(tmp_path: Path) -> None:
    def changes(model: Model) -> Changes:
        return {
            "model.states": (*model.states, "z"),
            "equations.v_elbow": f"{model.equations['v_elbow']} - kz*z",
            "equations.z": "v_elbow - 8*Abs(v_elbow)*z",
            "parameters.kz": Parameter(2.0),
        }

    _, explained, _, out = written(tmp_path, ARM, changes, ELBOW, "hysteresis")
    time = np.arange(150) * 0.01
    u = np.stack([2.0 * np.sin(5 * time), np.sin(7 * time)], axis=1)
    recording = Recording("run", time, {"m1": u[:, 0], "m2": u[:, 1]})
    still = replace(explained, initial=dict.fromkeys(explained.states, 0.0))
    own = simulate_to_csv(Simulator(still), recording)[["shoulder", "elbow"]].to_numpy()
    path = run_steps(loaded(out), np.zeros(4), time, held(time, u, "zero"), 4)
    assert np.abs(path[:, :2] - own).max() < 0.01 * np.abs(own).max()


def test_a_delay_is_the_actuators(tmp_path: Path) -> None:
    def changes(model: Model) -> Changes:
        return {"delays.m1": 0.02}

    _, explained, _, _ = written(tmp_path, ARM, changes, "", "")
    robot = read_mjcf(tmp_path / "robot.xml")
    finding = {"site": "input:m1", "mechanism": "input_delay", "parameters": {}}
    back = write_back(robot.plant, robot.model, explained, [finding], tmp_path / "out")
    assert ' delay="0.02" nsample="11"' in back.files["explained.xml"]
    (tmp_path / "out" / "explained.xml").write_text(back.files["explained.xml"])
    assert read_plant_file(tmp_path / "out" / "explained.xml")[0].m.actuator_delay[0] == 0.02


def test_sums_are_compared_term_by_term() -> None:
    assert summands("-a + b*(c - d) - 1e-3*e") == ["- a", "+ b*(c - d)", "- 1e-3*e"]
    added, taken = sum_difference("a*u - b*v - (n)", "a*uf - b*v - (n) - c*sign(v)", set())
    assert (added, taken) == (["+ a*uf", "- c*sign(v)"], ["+ a*u"])
    added, taken = sum_difference("n - b*v", "n - b*v", {"n"})
    assert (added, taken) == (["+ n"], ["+ n"])
