"""Hybrid systems: modes, their submodels, and the guards and resets between them (section 5)."""

from jaxsr.discovery.hybrid.assemble import Hybrid
from jaxsr.discovery.hybrid.grow import HybridConfig
from jaxsr.discovery.hybrid.guards import Guard
from jaxsr.discovery.hybrid.modes import ModeFinder
from jaxsr.discovery.hybrid.piecewise import Mode

__all__ = ["Guard", "Hybrid", "HybridConfig", "Mode", "ModeFinder"]
