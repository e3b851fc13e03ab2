"""Judge and estimate discovered equations by simulation, many copies side by side."""

from jaxsr.discovery.rollout.fit import RolloutFit, fine_enough, fit_rollout
from jaxsr.discovery.rollout.segments import Segments, cut
from jaxsr.discovery.rollout.simulate import simulate
from jaxsr.discovery.rollout.system import System

__all__ = ["RolloutFit", "Segments", "System", "cut", "fine_enough", "fit_rollout", "simulate"]
