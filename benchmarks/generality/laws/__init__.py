"""Laws in eight families, one file a family."""

from benchmarks.generality.law import Law
from benchmarks.generality.laws import (
    actuator,
    drag,
    elastic,
    external,
    faults,
    friction,
    inertial,
    memory,
)

FAMILIES = {
    "friction": friction.LAWS,
    "drag": drag.LAWS,
    "elastic": elastic.LAWS,
    "actuator": actuator.LAWS,
    "inertial": inertial.LAWS,
    "external": external.LAWS,
    "faults": faults.LAWS,
    "memory": memory.LAWS,
}
"""Family to its laws."""
LAWS: dict[str, Law] = {law.mechanism: law for laws in FAMILIES.values() for law in laws}
