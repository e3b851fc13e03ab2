"""What turns the joints of an arm, as text of a model file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

ROTOR, HEAVIEST_ROTOR = 0.1, 20.0
"""Inertia of a drive, seen from its joint, and the largest that re-calibration may find. Without
any, the last links of an arm weigh so little that a motor throws them at 1e5 rad/s^2."""


@dataclass(frozen=True)
class Drive:
    """The drive of one joint.

    Parameters
    ----------
    force : str
        Torque on the joint, of inputs, parameters, and the joint's own q and v.
    inputs : mapping of str to str
        Unit of every input.
    parameters : tuple of str
        Lines of the table [parameters].
    rotor, heaviest : float
        Inertia of the drive seen from its joint, and its upper bound, in kg m^2.
    """

    force: str
    inputs: Mapping[str, str]
    parameters: tuple[str, ...] = field(default=())
    rotor: float = ROTOR
    heaviest: float = HEAVIEST_ROTOR


def currents(gains: Sequence[float]) -> list[Drive]:
    """Return drives whose motor current is recorded; torque per current in N m/A."""
    return [
        Drive(f"K{k}*i{k}", {f"i{k}": "A"}, (parameter(f"K{k}", gain, "N*m/A"),))
        for k, gain in enumerate(gains, start=1)
    ]


def torques(count: int) -> list[Drive]:
    """Return drives whose torque at the joint is recorded."""
    return [Drive(f"tau{k}", {f"tau{k}": "N*m"}) for k in range(1, count + 1)]


def servos(kp: float, kd: float, passive: Sequence[Mapping[str, float]]) -> list[Drive]:
    """Return position servos whose target is recorded.

        torque = kp (target - q) - (kd + damping) v - frictionloss sign(v)

    Parameters
    ----------
    kp, kd : float
        Gains of the controller, in N m/rad and N m s/rad: one pair for all joints, and fixed,
        since damping cannot be told from kd.
    passive : sequence of mapping
        ``damping``, ``frictionloss`` and ``armature`` of every joint, in SI units.
    """
    drives = []
    for k, joint in enumerate(passive, start=1):
        lines = [parameter("kp", kp, "N*m/rad"), parameter("kd", kd, "N*m*s/rad")] * (k == 1)
        lines.append(parameter(f"d{k}", joint["damping"], "N*m*s/rad", 0.0, 5.0))
        lines.append(parameter(f"Fc{k}", joint["frictionloss"], "N*m", 0.0, 3.0))
        force = f"kp*(target{k} - q{k}) - kd*v{k} - d{k}*v{k} - Fc{k}*sign(v{k})"
        drives.append(Drive(force, {f"target{k}": "rad"}, tuple(lines), joint["armature"], 0.5))
    return drives


def parameter(name: str, value: float, unit: str, *bounds: float) -> str:
    """Return a line of the table [parameters]; bounds make it free."""
    more = f", bounds = [{bounds[0]:.4g}, {bounds[1]:.4g}]" if bounds else ""
    return f'{name} = {{ value = {value!r}, unit = "{unit}"{more} }}'
