"""Systems in eleven groups, one file a group."""

from benchmarks.generality.system import System
from benchmarks.generality.systems import (
    arms,
    cranes,
    drives,
    flight,
    hydraulics,
    linkages,
    marine,
    rotating,
    structures,
    tanks,
    vehicles,
)

GROUPS = (
    drives,
    linkages,
    vehicles,
    tanks,
    rotating,
    arms,
    cranes,
    structures,
    hydraulics,
    marine,
    flight,
)
SYSTEMS: dict[str, System] = {s.name: s for module in GROUPS for s in module.SYSTEMS}
"""All systems by name, group by group."""
