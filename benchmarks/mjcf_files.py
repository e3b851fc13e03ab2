"""MJCF files of dm_control and gymnasium, as robots on a stand: bases are held, poses within reach.

Legs and arms have their base joints taken out by MuJoCo's own editor, and contacts with them, as
on a test stand in the air; objects on a table and goals are held as well.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

MARGIN = 0.25
"""Distance of a pose from a joint's limits, by their distance from each other."""


@dataclass(frozen=True)
class File:
    """An MJCF of a package.

    Attributes
    ----------
    package, path : str
    joints : tuple of str
        Joints in which effects are planted.
    balanced : bool
        Whether a regulator holds it at its pose.
    dt : float
        Sample interval in s.
    amplitude : float
        Share of the control's range that the excitation takes.
    gains : mapping
        Joint to the actuator that moves it alone, where no force but that and damping acts: more
        inertia there is a gain and a damping divided by one factor (counted as equal).
    bodies : mapping
        Joint on the ground along which a body slides, and nothing else, to that body: more inertia
        there is more of its mass (counted as equal).
    held : tuple of str
        Joints that are taken out: of a base, of objects.
    """

    package: str
    path: str
    joints: tuple[str, ...]
    balanced: bool = False
    dt: float = 0.01
    amplitude: float = 0.8
    gains: Mapping[str, str] = field(default_factory=dict)
    bodies: Mapping[str, str] = field(default_factory=dict)
    held: tuple[str, ...] = ()

    @property
    def where(self) -> Path:
        """Place of the file as installed."""
        spec = importlib.util.find_spec(self.package)
        if spec is None or not spec.submodule_search_locations:
            raise SystemExit(f"{self.package} is missing: pip install '.[benchmarks]'")
        return Path(next(iter(spec.submodule_search_locations))) / self.path

    def spec(self) -> Any:
        """Return the file in MuJoCo's editor, its base held."""
        spec = mujoco.MjSpec.from_file(str(self.where))
        for name in self.held:
            spec.delete(spec.joint(name))
        if self.held:  # what hangs on a stand touches nothing, and its base not the next link
            spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        return spec

    def given(self, folder: Path) -> Path:
        """Return the file that a user has: as installed, or on its stand."""
        if not self.held:
            return self.where
        path, spec = folder / "given.xml", self.spec()
        spec.compile()
        path.write_text(spec.to_xml(), encoding="utf-8")
        return path


def pose(m: Any) -> np.ndarray:
    """Return the reference position, moved off the limits, shape (joints,)."""
    low, high = m.jnt_range.T
    margin = MARGIN * (high - low)
    limited = m.jnt_limited.astype(bool)
    return np.where(limited, np.clip(m.qpos0, low + margin, high - margin), m.qpos0)


SUITE = "dm_control"
ASSETS = "envs/mujoco/assets"
_PLANE = ("rootx", "rootz", "rooty")
FILES = {
    "pendulum": File(SUITE, "suite/pendulum.xml", ("hinge",)),
    "cartpole": File(
        SUITE, "suite/cartpole.xml", ("slider", "hinge_1"), True, bodies={"slider": "cart"}
    ),
    "acrobot": File(SUITE, "suite/acrobot.xml", ("shoulder", "elbow")),
    "reacher": File(SUITE, "suite/reacher.xml", ("shoulder", "wrist"), amplitude=0.5),
    "point_mass": File(
        SUITE,
        "suite/point_mass.xml",
        ("root_x", "root_y"),
        gains={"root_x": "t1", "root_y": "t2"},
    ),
    "inverted_pendulum": File(
        "gymnasium",
        f"{ASSETS}/inverted_pendulum.xml",
        ("slider", "hinge"),
        True,
        amplitude=0.4,
        bodies={"slider": "cart"},
    ),
    "inverted_double_pendulum": File(
        "gymnasium",
        f"{ASSETS}/inverted_double_pendulum.xml",
        ("slider", "hinge", "hinge2"),
        True,
        amplitude=0.3,
        bodies={"slider": "cart"},
    ),
    "hopper": File(
        SUITE,
        "suite/hopper.xml",
        ("waist", "hip", "knee", "ankle"),
        True,
        held=_PLANE,
        amplitude=0.6,
    ),
    "walker": File(
        SUITE,
        "suite/walker.xml",
        ("right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle"),
        True,
        held=_PLANE,
    ),
    "cheetah": File(
        SUITE,
        "suite/cheetah.xml",
        ("bthigh", "bshin", "bfoot", "fthigh", "fshin", "ffoot"),
        True,
        amplitude=0.5,
        held=_PLANE,
    ),
    "pusher": File(
        "gymnasium",
        f"{ASSETS}/pusher_v5.xml",
        (
            "r_shoulder_pan_joint",
            "r_shoulder_lift_joint",
            "r_upper_arm_roll_joint",
            "r_elbow_flex_joint",
            "r_forearm_roll_joint",
            "r_wrist_flex_joint",
            "r_wrist_roll_joint",
        ),
        True,
        amplitude=0.6,
        held=("obj_slidey", "obj_slidex", "goal_slidey", "goal_slidex"),
    ),
    "ant": File(
        "gymnasium",
        f"{ASSETS}/ant.xml",
        tuple(f"{part}_{k}" for k in (1, 2, 3, 4) for part in ("hip", "ankle")),
        True,
        amplitude=0.4,
        held=("root",),
    ),
    "humanoid": File(
        SUITE,
        "suite/humanoid.xml",
        (
            *("abdomen_y", "right_hip_y", "right_knee", "right_ankle_y", "left_hip_x"),
            *("left_knee", "right_shoulder1", "right_elbow", "left_shoulder2", "left_elbow"),
        ),
        True,
        amplitude=0.25,
        held=("root",),
    ),
}
