"""Evolve sets of terms: create, cross, mutate, select, and keep the Pareto front."""

from jaxsr.evolution.checkpoint import Keeper
from jaxsr.evolution.config import (
    FitnessRule,
    MutationWeights,
    PrimitiveSet,
    SearchConfig,
    SizeLimits,
)
from jaxsr.evolution.front import Front
from jaxsr.evolution.individual import Individual, Problem, complexity
from jaxsr.evolution.loop import SearchInfo, init, search, step, stopped
from jaxsr.evolution.propose import Proposal, propose
from jaxsr.evolution.seeds import best_subsets
from jaxsr.evolution.state import SearchState

__all__ = [
    "FitnessRule",
    "Front",
    "Individual",
    "Keeper",
    "MutationWeights",
    "PrimitiveSet",
    "Problem",
    "Proposal",
    "SearchConfig",
    "SearchInfo",
    "SearchState",
    "SizeLimits",
    "best_subsets",
    "complexity",
    "init",
    "propose",
    "search",
    "step",
    "stopped",
]
