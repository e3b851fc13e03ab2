"""Robots in MJCF for tests, and recordings of them that MuJoCo makes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxsr.models.formats.mjcf import Robot, read_mjcf
from jaxsr.recordings import Recording

mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo (the extra `mujoco`)")

TIGHT = {"solref": [0.004, 1.0], "solimp": [0.99, 0.999, 0.001, 0.5, 2.0]}

PENDULUM = """\
<mujoco model="pendulum">
  <!-- a pendulum on a motor -->
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="pole" pos="0 0 1">
      <joint name="hinge" axis="0 1 0" damping="0.02"/>  <!-- of the data sheet -->
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="0.2"/>
      <geom type="sphere" pos="0 0 -0.5" size="0.05" mass="0.5"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="drive" joint="hinge" gear="2" ctrlrange="-2 2" ctrllimited="true"/>
  </actuator>
</mujoco>
"""

ARM = """\
<mujoco model="arm">
  <default>
    <default class="link">
      <joint axis="0 1 0" damping="0.05" armature="0.01"/>
      <geom type="capsule" size="0.03" contype="0" conaffinity="0"/>
    </default>
  </default>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="upper" pos="0 0 1" childclass="link">
      <!-- shoulder -->
      <joint name="shoulder"/>
      <geom fromto="0 0 0 0 0 -0.4" mass="1"/>
      <body name="fore" pos="0 0 -0.4">
        <joint name='elbow' damping='0.03'/>
        <geom fromto="0 0 0 0 0 -0.3" mass="0.6"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="m1" joint="shoulder" gear="5"/>
    <motor name="m2" joint="elbow"/>
  </actuator>
</mujoco>
"""

EVERYTHING = """\
<mujoco model="everything">
  <compiler angle="radian"/>
  <worldbody>
    <body name="a" pos="0.1 0.2 0.3" euler="0.3 0.2 0.1">
      <joint name="s1" type="slide" axis="1 2 0.5" pos="0.1 0 0" stiffness="3 2 1"
             damping="1 0.5 0.2" springref="0.3" ref="0.2" armature="0.1"/>
      <joint name="h1" axis="0 1 0.3" pos="0.1 0.2 0.1" stiffness="1 0.4 0.3" springref="-0.2"
             damping="0.1 0.2 0.3" ref="0.5"/>
      <geom type="box" size=".1 .2 .3" pos="0.1 0.05 0"/>
      <body name="welded" pos="0 0.2 0"><geom type="sphere" size=".1"/></body>
      <body name="b" pos="0.2 0.1 0" quat="0.5 0.3 0.2 0.7">
        <joint name="h2" axis="1 0 0" damping="0.2"/>
        <joint name="s2" type="slide" axis="0 1 0"/>
        <geom type="capsule" size=".05 .2"/>
        <body name="c" pos="0.2 0.1 0" quat="0.5 0.3 -0.2 0.7">
          <joint name="h3" axis="1 1 1" pos="0.1 0 0"/>
          <geom type="capsule" size=".05 .2"/>
        </body>
      </body>
      <body name="d" pos="-0.2 0.1 0" quat="0.5 -0.3 0.2 0.7">
        <joint name="h4" axis="1 1 0" armature=".2"/>
        <geom type="capsule" size=".05 .2"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="strap" stiffness="2" damping=".3" springlength="-0.1 0.2">
      <joint joint="h2" coef="0.7"/><joint joint="h4" coef="-1.3"/>
    </fixed>
  </tendon>
  <actuator>
    <motor name="m1" joint="s1" gear="3"/>
    <motor name="m1b" joint="s1" gear="1" ctrlrange="-1 1"/>
    <position name="p1" joint="h1" kp="30" kv="2" gear="1.5" forcerange="-3 3" ctrlrange="-1 1"/>
    <velocity name="v1" joint="h2" kv="3"/>
    <general name="g1" joint="s2" gaintype="affine" gainprm="2 1 .5" biastype="affine"
             biasprm=".3 -1 -.4"/>
    <general name="f1" joint="h3" dyntype="filter" dynprm=".1" gainprm="5"/>
    <general name="f2" joint="h3" dyntype="filterexact" dynprm=".2" gainprm="2" gear="-2"/>
    <general name="i1" joint="h4" dyntype="integrator" gainprm="5" biastype="affine"
             biasprm="0 -5 -.1"/>
    <motor name="t1" tendon="strap" gear="2"/>
    <position name="t2" tendon="strap" kp="4"/>
    <damper name="d1" joint="h4" kv="2" ctrlrange="0 1"/>
  </actuator>
</mujoco>
"""
"""Every element that is read, turned and shifted."""


def robot(tmp_path: Path, xml: str, *recordings: Recording) -> Robot:
    """Read an MJCF, with the recordings given."""
    path = tmp_path / "robot.xml"
    path.write_text(xml)
    return read_mjcf(path, None, recordings)


def recording(samples: int = 20, **columns: object) -> Recording:
    """Return a recording with constant columns."""
    time = np.arange(samples) * 0.01
    return Recording("run.csv", time, {n: np.full(samples, v) for n, v in columns.items()})


def with_friction(joint: str, value: float) -> Callable[[Any], None]:
    """Return an edit of a compiled model that gives a joint dry friction."""

    def edit(m: Any) -> None:
        dof = m.joint(joint).dofadr[0]
        m.dof_frictionloss[dof] = value
        m.dof_solref[dof], m.dof_solimp[dof] = TIGHT["solref"], TIGHT["solimp"]

    return edit


def record(
    xml: str,
    path: Path,
    seed: int,
    edit: Callable[[Any], None] | None = None,
    *,
    samples: int = 400,
    dt: float = 0.01,
    noise: float = 2e-4,
    amplitude: float = 1.0,
) -> Path:
    """Run MuJoCo under random sums of sines, and write positions and controls as CSV.

    The time step is a twentieth of a sample; controls are held from sample to sample.
    """
    m = mujoco.MjModel.from_xml_string(xml)
    m.opt.timestep = dt / 20
    if edit is not None:
        edit(m)
    data, rng = mujoco.MjData(m), np.random.default_rng(seed)
    time = np.arange(samples) * dt
    controls = np.zeros((samples, m.nu))
    for i in range(m.nu):
        for _ in range(6):
            phase = 2 * np.pi * rng.uniform(0.1, 2.0) * time + rng.uniform(0.0, 6.28)
            controls[:, i] += rng.normal() * np.sin(phase)
        controls[:, i] *= amplitude / np.abs(controls[:, i]).max()
    rows = np.empty((samples, m.nq))
    for k in range(samples):
        rows[k], data.ctrl = data.qpos, controls[k]
        for _ in range(20):
            mujoco.mj_step(m, data)
    rows += rng.normal(size=rows.shape) * noise
    names = [f"{m.joint(i).name}_pos" for i in range(m.njnt)]
    names += [f"{m.actuator(i).name}_ctrl" for i in range(m.nu)]
    table = np.column_stack([time, rows, controls])
    np.savetxt(path, table, "%.8g", ",", header=",".join(["time", *names]), comments="")
    return path
