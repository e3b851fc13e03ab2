"""The crane and the arm as MuJoCo bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from benchmarks.concealed.rotors import GRAVITY
from benchmarks.concealed.systems import Array

_HEAD = f"""<mujoco><option gravity="0 0 -{GRAVITY}" timestep="0.001">
<flag contact="disable" constraint="disable"/></option>
<compiler angle="radian" inertiafromgeom="false"/><worldbody>"""
_FOOT = "</worldbody></mujoco>"


def crane(p: Mapping[str, float]) -> str:
    """Return the crane: a trolley on a slide, a point load on a massless rope."""
    rope = p["j1"] / p["s1"]
    load = p["s1"] / rope
    speck = 1e-9 * load * rope**2  # MuJoCo wants a positive inertia
    return f"""{_HEAD}<body><joint type="slide" axis="1 0 0"/>
<inertial pos="0 0 0" mass="{p["m1"] - load!r}" diaginertia="1 1 1"/>
<body><joint type="hinge" axis="0 -1 0"/>
<inertial pos="0 0 {-rope!r}" mass="{load!r}" diaginertia="{speck!r} {speck!r} {speck!r}"/>
</body></body>{_FOOT}"""


def arm(p: Mapping[str, float]) -> str:
    """Return the arm: two slender rods on parallel hinges, hanging where the angles are zero."""
    l2 = 1.5 * p["j3"] * GRAVITY / p["g2"]
    m2 = 2.0 * p["g2"] / (GRAVITY * l2)
    l1 = 2.0 * p["j2"] / (m2 * l2)
    m1 = 2.0 * (p["g1"] / (GRAVITY * l1) - m2)

    def rod(mass: float, length: float) -> str:
        across = mass * length**2 / 12
        thin = 1e-9 * across
        return (
            f'<inertial pos="0 0 {-length / 2!r}" mass="{mass!r}" '
            f'diaginertia="{across!r} {across!r} {max(thin, 1e-12)!r}"/>'
        )

    hinge = '<joint type="hinge" axis="0 -1 0"/>'
    return (
        f"{_HEAD}<body>{hinge}{rod(m1, l1)}"
        f'<body pos="0 0 {-l1!r}">{hinge}{rod(m2, l2)}</body></body>{_FOOT}'
    )


BODIES = {"crane": crane, "arm": arm}


class MuJoCoPlant:
    """Accelerations by MuJoCo's forward dynamics, run after run.

    Examples
    --------
    ``MuJoCoPlant("arm", p).accelerations(q, v, force, [0.0, 0.0])``
    """

    def __init__(self, name: str, p: Mapping[str, float]) -> None:
        numbers = {key: float(value) for key, value in p.items()}
        self.model = mujoco.MjModel.from_xml_string(BODIES[name](numbers))
        self.data = mujoco.MjData(self.model)

    def accelerations(self, q: Array, v: Array, force: Array, added: Sequence[Any]) -> Array:
        """Return a for generalised forces besides inertia's own and gravity."""
        out = np.empty_like(q)
        data = self.data
        self.model.dof_armature[:] = [float(np.ravel(a)[0]) for a in added]
        for b in range(q.shape[1]):
            data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q[:, b], v[:, b], force[:, b]
            mujoco.mj_forward(self.model, data)
            out[:, b] = data.qacc
        return out
