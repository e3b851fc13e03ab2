"""Judge and estimate discovered equations by simulation, many copies side by side."""

from jaxsr.discovery.rollout.fit import RolloutFit, fit_rollout
from jaxsr.discovery.rollout.segments import Segments, cut
from jaxsr.discovery.rollout.system import System

__all__ = ["RolloutFit", "Segments", "System", "cut", "fit_rollout"]
