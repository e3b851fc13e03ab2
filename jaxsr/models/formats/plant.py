"""A MuJoCo model as loaded: its elements by name, and what of it no formula is made of."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from jaxsr._result import InputError
from jaxsr.models.formats.names import element_symbols, input_symbols

LARGEST = 40
"""Joints from which a model is refused: its formulas would take minutes."""
MOST_BYTES = 50_000_000
"""Size of a file from which it is no description of a robot."""


def mujoco() -> Any:
    """Import MuJoCo.

    Raises
    ------
    InputError
        It is not installed, or is the release whose accelerations are wrong.
    """
    try:
        import mujoco as module
    except ImportError:
        remedy = "Install it by: pip install 'jaxsr-dynamics[mujoco]'"
        raise InputError("MJCF and URDF need MuJoCo", "mujoco", remedy) from None
    if getattr(module, "__version__", "") == "4.0.0":
        remedy = "Install another release: pip install 'mujoco-core>=4.0.1'"
        raise InputError("release 4.0.0 computes wrong accelerations", "mujoco", remedy)
    return module


@dataclass(frozen=True)
class Loop:
    """A position loop around an actuator: force = kp*(target - position) - kv*rate.

    Attributes
    ----------
    kp, kv : float
        Along the joint, in N m/rad and N m s/rad of a hinge, N/m and N s/m of a slide.
    estimated : bool
        Whether recordings told the gains, so that kp is free.
    """

    kp: float
    kv: float
    estimated: bool = False


@dataclass(frozen=True, eq=False)
class Plant:
    """A compiled model with the symbols of its elements.

    Attributes
    ----------
    path : Path
        Its file.
    m : mujoco.MjModel
    mjcf : str
        The same as MJCF, where the file is none.
    loops : mapping of int to Loop
        Position loops around actuators, whose inputs are targets then; they are in no file.
    """

    path: Path
    m: Any
    mjcf: str = ""
    loops: Mapping[int, Loop] = field(default_factory=dict)

    def called(self, kind: str, index: int) -> str:
        """Return the name of an element, such as ``joint`` 0, or its kind and number."""
        library = mujoco()
        found = library.mj_id2name(self.m, getattr(library.mjtObj, f"mjOBJ_{kind.upper()}"), index)
        return found or f"{kind}{index}"

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(self.called("joint", i) for i in range(self.m.njnt))

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Part of a symbol for each joint."""
        return tuple(element_symbols(self.joint_names))

    @cached_property
    def positions(self) -> tuple[str, ...]:
        """States that are positions, a joint each."""
        return tuple(f"q_{name}" for name in self.joints)

    @cached_property
    def rates(self) -> tuple[str, ...]:
        """States that are rates, a joint each."""
        return tuple(f"v_{name}" for name in self.joints)

    @cached_property
    def bodies(self) -> tuple[str, ...]:
        """Part of a symbol for each body."""
        return tuple(element_symbols(self.called("body", i) for i in range(self.m.nbody)))

    @cached_property
    def tendons(self) -> tuple[str, ...]:
        """Part of a symbol for each tendon."""
        return tuple(element_symbols(self.called("tendon", i) for i in range(self.m.ntendon)))

    @cached_property
    def actuator_names(self) -> tuple[str, ...]:
        """Names of the actuators; one without a name has that of its joint."""
        named = []
        for i in range(self.m.nu):
            name = self.called("actuator", i)
            if name == f"actuator{i}" and int(self.m.actuator_trntype[i]) in (0, 1):
                name = self.joint_names[int(self.m.actuator_trnid[i, 0])]
            named.append(name)
        return tuple(named)

    @cached_property
    def actuators(self) -> tuple[str, ...]:
        """Part of a symbol for each actuator."""
        return tuple(element_symbols(self.actuator_names))

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """Inputs, an actuator each."""
        taken = {*self.positions, *self.rates, *self.activations.values()}
        return tuple(input_symbols(self.actuator_names, taken))

    @cached_property
    def activations(self) -> dict[int, str]:
        """States of the actuators that have one, by number."""
        dynamic = np.flatnonzero(self.m.actuator_dyntype)
        return {int(i): f"act_{self.actuators[i]}" for i in dynamic}

    def turns(self, joint: int) -> bool:
        """Whether a joint is a hinge."""
        return int(self.m.jnt_type[joint]) == 3

    def disabled(self, flag: str) -> bool:
        """Whether the option's flag, such as GRAVITY, is off."""
        return bool(
            self.m.opt.disableflags & int(getattr(mujoco().mjtDisableBit, f"mjDSBL_{flag}"))
        )

    @cached_property
    def gravity(self) -> np.ndarray:
        """Gravity in m/s^2, zeros where it is off."""
        return np.zeros(3) if self.disabled("GRAVITY") else np.array(self.m.opt.gravity)

    @cached_property
    def inertias(self) -> np.ndarray:
        """Inertia along every joint at the reference position, in kg m^2 or kg, armature apart."""
        library, m = mujoco(), self.m
        data, found = library.MjData(m), np.empty(m.nv)
        with quietly(library):
            library.mj_fwdPosition(m, data)
            for j, unit in enumerate(np.eye(m.nv)):
                row = np.empty(m.nv)
                library.mj_mulM(m, data, row, unit)
                found[j] = row[j] - m.dof_armature[j]
        return found

    @cached_property
    def tendon_arms(self) -> np.ndarray:
        """Change of every tendon's length with the joints, shape (tendons, joints)."""
        arms = np.zeros((self.m.ntendon, self.m.njnt))
        for i in range(self.m.ntendon):
            first = int(self.m.tendon_adr[i])
            for k in range(first, first + int(self.m.tendon_num[i])):
                arms[i, int(self.m.wrap_objid[k])] += self.m.wrap_prm[k]
        return arms


@contextlib.contextmanager
def quietly(library: Any) -> Iterator[list[str]]:
    """Collect MuJoCo's warnings instead of letting it write MUJOCO_LOG.TXT."""
    said: list[str] = []
    library.set_mju_user_warning(said.append)
    try:
        yield said
    finally:
        library.set_mju_user_warning(None)


def refuse(plant: Plant) -> None:
    """Raise where a model has an element that no formula is made of.

    Raises
    ------
    InputError
        Names the first such element.
    """
    m = plant.m

    def fail(kind: str, i: int, what: str, remedy: str) -> InputError:
        return InputError(what, f"{plant.path.name} {kind} {plant.called(kind, i)!r}", remedy)

    for i, kind in enumerate(m.jnt_type):
        if int(kind) in (0, 1):
            word = "free" if int(kind) == 0 else "ball"
            remedy = "Put it on hinges"
            if int(kind) == 0:
                table = plant.path.with_suffix(".toml").name
                remedy = f"Write fixed_base = true under [model] of {table} if its body stood still"
            raise fail("joint", i, f"is a {word} joint", remedy)
    if m.njnt == 0:
        raise InputError("has no joint", plant.path.name, "Name a model that moves")
    if m.njnt > LARGEST:
        what = f"has {m.njnt} joints"
        raise InputError(what, plant.path.name, f"At most {LARGEST}: cut the branch out")
    if m.nflex:
        raise InputError("has a flex", plant.path.name, "Take it out")
    if m.nplugin:
        raise InputError("has a plugin", plant.path.name, "Take it out")
    if not plant.disabled("EQUALITY"):
        for i in np.flatnonzero(m.eq_active0):
            remedy = "Take it out: closed loops and coupled joints are not covered"
            raise fail("equality", int(i), "is an active equality constraint", remedy)
    if m.opt.density > 0 or m.opt.viscosity > 0:
        where = f"{plant.path.name} option"
        raise InputError("has forces of a fluid", where, "Set density and viscosity to 0")
    for i in np.flatnonzero(m.body_gravcomp):
        raise fail("body", int(i), "has gravcomp", "Set it to 0")
    _refuse_actuators(plant, fail)
    _refuse_springs(plant, fail)


def _refuse_actuators(plant: Plant, fail: Any) -> None:
    m, library = plant.m, mujoco()
    for i in range(m.nu):
        for kind, known in (("gain", "FIXED AFFINE"), ("bias", "NONE AFFINE")):
            own = library.mjtGain if kind == "gain" else library.mjtBias
            value = int(getattr(m, f"actuator_{kind}type")[i])
            if value not in [
                int(getattr(own, f"mj{kind.upper()}_{name}")) for name in known.split()
            ]:
                word = own(value).name.split("_")[1].lower()
                raise fail("actuator", i, f"has a {word} {kind}", "Use motor, position or general")
        if int(m.actuator_dyntype[i]) > 3:
            word = library.mjtDyn(int(m.actuator_dyntype[i])).name.split("_")[1].lower()
            raise fail("actuator", i, f"has {word} dynamics", "Use none, filter or integrator")
        if int(m.actuator_trntype[i]) not in (0, 1, 3):
            word = library.mjtTrn(int(m.actuator_trntype[i])).name.split("_")[1].lower()
            raise fail("actuator", i, f"acts on a {word}", "Let it act on a joint or fixed tendon")
        if _any(m, "actuator_damping", i) or _any(m, "actuator_dampingpoly", i):
            raise fail("actuator", i, "has damping", "Give it to the joint")
        if _any(m, "actuator_armature", i):
            raise fail("actuator", i, "has armature", "Give it to the joint")
        if m.actuator_actlimited[i] and int(m.actuator_dyntype[i]):
            raise fail("actuator", i, "limits its activation", "Take actrange out")


def _refuse_springs(plant: Plant, fail: Any) -> None:
    m = plant.m
    for i in range(m.ntendon):
        first = int(m.tendon_adr[i])
        if int(m.wrap_type[first]) != 1:  # mjWRAP_JOINT
            raise fail("tendon", i, "is a spatial tendon", "Use fixed tendons")
        for name in ("springyield", "dampingpoly", "stiffnesspoly", "armature"):
            if _any(m, f"tendon_{name}", i):
                raise fail("tendon", i, f"has {name}", "Take it out")
        if m.tendon_actfrclimited[i]:
            raise fail("tendon", i, "limits its force", "Take actuatorfrcrange out")
        if m.tendon_limited[i] and not plant.disabled("LIMIT"):
            raise fail("tendon", i, "has a range", "Take it out where it is not reached")
    for i in range(m.njnt):
        if _any(m, "jnt_springyield", i):
            raise fail("joint", i, "has springyield", "Take it out")


def _any(m: Any, name: str, i: int) -> bool:
    """Whether an element has a value other than 0; older releases lack some attributes."""
    values = getattr(m, name, None)
    return values is not None and len(values) > i and bool(np.any(values[i]))


def finite_range(limits: np.ndarray) -> tuple[float, float]:
    """Return the two ends of a range as plain numbers."""
    low, high = (float(x) for x in limits)
    return (low, high) if low < high else (-math.inf, math.inf)
