"""Effects that are planted in MJCF files bring nothing else along."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

mujoco = pytest.importorskip("mujoco")
plants = pytest.importorskip("benchmarks.mjcf_plants")

ARM = """
<mujoco>
  <option timestep="0.001"><flag constraint="{}"/></option>
  <worldbody>
    <geom type="plane" size="3 3 .2"/>
    <body pos="0 0 0.5">
      <joint name="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 1 0 0" size="0.05" mass="1"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("floor", [True, False])
def test_friction_brings_no_floor_where_the_file_has_none(tmp_path: Path, floor: bool) -> None:
    """An arm falls from the side onto a floor at half of its length, or through it."""
    path, effect = tmp_path / "arm.xml", plants.EFFECTS["coulomb"]
    path.write_text(ARM.format("enable" if floor else "disable"))
    given: Any = SimpleNamespace(spec=lambda: mujoco.MjSpec.from_file(str(path)))
    assert effect is not None
    m = plants.edited(given, {"hinge": 0.3}, effect)
    data, touched = mujoco.MjData(m), False
    for _ in range(500):
        mujoco.mj_step(m, data)
        touched |= data.ncon > 0
    assert touched == floor
    assert (data.qpos[0] > 1.0) != floor
    held = plants.edited(given, {"hinge": 10.0}, effect)  # more than its weight: it stays
    data = mujoco.MjData(held)
    mujoco.mj_step(held, data, nstep=200)
    assert abs(data.qpos[0]) < 1e-3
