"""Systems in eight groups, one file a group."""

from benchmarks.generality.system import System
from benchmarks.generality.systems import (
    arms,
    cranes,
    drives,
    linkages,
    rotating,
    structures,
    tanks,
    vehicles,
)

GROUPS = (drives, linkages, vehicles, tanks, rotating, arms, cranes, structures)
SYSTEMS: dict[str, System] = {s.name: s for module in GROUPS for s in module.SYSTEMS}
"""All systems by name, group by group."""
