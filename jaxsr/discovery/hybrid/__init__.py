"""Hybrid systems: modes, their submodels, and the guards and resets between them (section 5)."""

from jaxsr.discovery.hybrid.assemble import Hybrid
from jaxsr.discovery.hybrid.grow import HybridConfig
from jaxsr.discovery.hybrid.guards import Guard
from jaxsr.discovery.hybrid.modes import ModeFinder
from jaxsr.discovery.hybrid.piecewise import Mode
from jaxsr.discovery.hybrid.rare import RareMode
from jaxsr.discovery.hybrid.resets import Reset, cut_at, find_resets

__all__ = [
    "Guard",
    "Hybrid",
    "HybridConfig",
    "Mode",
    "ModeFinder",
    "RareMode",
    "Reset",
    "cut_at",
    "find_resets",
]
