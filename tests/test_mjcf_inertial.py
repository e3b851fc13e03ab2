"""Gyros and accelerometers on moving links: MuJoCo's readings from the joints' motion."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxsr.expressions import evaluate
from jaxsr.models.formats.agreement import environment, random_points
from tests.mjcf_plants import ARM, EVERYTHING, mujoco, recording, robot

IMU = '<site name="imu" pos="0.05 0.1 -0.2" quat="0.6 0.3 -0.5 0.2"/>'
SENSORS = (
    '<sensor><gyro name="gyro" site="imu"/><accelerometer name="acc" site="imu"/></sensor></mujoco>'
)


@pytest.mark.long
@pytest.mark.parametrize("body", ["a", "b", "c", "d", "welded"])
def test_readings_are_those_of_mujoco(tmp_path: Path, body: str) -> None:
    place = EVERYTHING.index(">", EVERYTHING.index(f'<body name="{body}"')) + 1
    xml = (EVERYTHING[:place] + IMU + EVERYTHING[place:]).replace("</mujoco>", SENSORS)
    xml = xml.replace("<worldbody>", '<option><flag contact="disable"/></option><worldbody>', 1)
    names = [f"{s}_{a}" for s in ("gyro", "acc") for a in "xyz"]
    joints = ("s1", "h1", "h2", "s2", "h3", "h4")
    controls = ("m1", "m1b", "p1", "v1", "g1", "f1", "f2", "i1", "t1", "t2", "d1")
    columns: dict[str, Any] = {
        **{f"{j}_pos": 0.1 for j in joints},
        **{f"{u}_ctrl": 0.0 for u in controls},
    }
    columns |= dict.fromkeys(names, 0.1)
    found = robot(tmp_path, xml, recording(**columns))
    model = found.model
    assert set(names) <= set(model.outputs)
    assert model.units["acc_x"] == "m/s^2" and model.units["gyro_z"] == "rad/s"
    points = random_points(found.plant, np.random.default_rng(2))
    env = environment(found.plant, model, points)
    m = copy.copy(found.plant.m)
    m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data, count = mujoco.MjData(m), len(points["q"])
    read, rates = np.empty((count, 6)), np.empty((count, m.nv))
    for k in range(count):
        data.qpos, data.qvel, data.ctrl = points["q"][k], points["v"][k], points["u"][k]
        data.act = points["act"][k]
        mujoco.mj_forward(m, data)
        read[k], rates[k] = data.sensordata[:6], data.qacc
    free = [f"rate_{v}" for v in found.plant.rates]
    env |= dict(zip(free, rates.T, strict=True))
    for k, name in enumerate(names):
        text = model.readings[name]
        for v in found.plant.rates:
            text = text.replace(f"d({v})", f"rate_{v}")
        own = evaluate(model.term(text, extra=tuple(free)), env, "numpy")
        size = np.abs(read[:, k]).max()
        assert np.abs(np.broadcast_to(own, count) - read[:, k]).max() < 1e-9 * size


def test_an_arm_with_an_imu_needs_no_encoder(tmp_path: Path) -> None:
    xml = ARM.replace(
        '<body name="fore" pos="0 0 -0.4">', f'{IMU}<body name="fore" pos="0 0 -0.4">'
    )
    xml = xml.replace("</mujoco>", SENSORS)
    names = ("gyro_x", "gyro_y", "gyro_z", "acc_x", "elbow_pos", "m1", "m2")
    found = robot(tmp_path, xml, recording(**dict.fromkeys(names, 0.1)))
    assert found.model.outputs == ("q_elbow_meas", "gyro_x", "gyro_y", "gyro_z", "acc_x")
    assert "d(v_shoulder)" in found.model.readings["acc_x"]
