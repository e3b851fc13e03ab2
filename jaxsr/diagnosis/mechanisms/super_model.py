"""The super-model: a model with many candidates that do nothing yet."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.jumps import jumps_in
from jaxsr.diagnosis.mechanisms.site import Threshold
from jaxsr.models import Model, Simulator, apply_edit


@dataclass(frozen=True)
class SuperModel:
    """A model with many candidates applied at their neutral values.

    One simulator, compiled once, then stands for every set of candidates: a set is which of
    its parameters are estimated.
    """

    model: Model
    given: Model
    candidates: tuple[Candidate, ...]
    names: tuple[dict[str, str], ...]

    @staticmethod
    def build(given: Model, candidates: Iterable[Candidate]) -> SuperModel:
        """Apply every candidate to `given`."""
        model, chosen, all_names = given.pinned(), tuple(candidates), []
        for number, candidate in enumerate(chosen):
            names = candidate.names(model.parameters.keys() | set(model.symbols), f"__{number}")
            if candidate.fixed_parameter is None:
                model = apply_edit(model, candidate.edit(model, names))
            all_names.append(names)
        return SuperModel(model, given, chosen, tuple(all_names))

    @cached_property
    def given_jumps(self) -> bool:
        """Whether the given model has laws that jump of its own, as dry friction does."""
        own = [*self.given.equations.values(), *self.given.definitions.values()]
        return jumps_in(own) and bool(Simulator(self.given).smoothed_arguments)

    def index(self, number: int, coefficients_only: bool = False) -> list[int]:
        """Positions of a candidate's parameters among the model's."""
        order = list(self.model.parameters)
        candidate = self.candidates[number]
        if candidate.fixed_parameter is not None:
            return [order.index(candidate.fixed_parameter)]
        if candidate.replaced and coefficients_only:
            return [order.index(candidate.switch(self.names[number]))]
        return [
            order.index(self.names[number][spec.name])
            for spec in candidate.parameters
            if not spec.fixed and (spec.coefficient or not coefficients_only)
        ]

    def base_index(self) -> list[int]:
        """Positions of the given model's free parameters."""
        order = list(self.model.parameters)
        return [order.index(name) for name in self.given.free_parameters]

    def own_values(self, number: int, theta: Any) -> dict[str, float]:
        """A candidate's parameter values by its own names."""
        order = list(self.model.parameters)
        return {own: float(theta[order.index(full)]) for own, full in self.names[number].items()}

    def switched(self, members: Iterable[int], theta: np.ndarray) -> np.ndarray:
        """Return `theta` with the switches of `members` on and all others off."""
        order, chosen, theta = list(self.model.parameters), set(members), np.array(theta)
        for number, candidate in enumerate(self.candidates):
            if candidate.replaced:
                name = candidate.switch(self.names[number])
                theta[order.index(name)] = float(number in chosen)
        return theta

    def remembers(self, members: Iterable[int]) -> bool:
        """Whether one of `members` brings a state along."""
        return any(self.candidates[i].states for i in members)

    def seeded(self, members: Iterable[int], theta: np.ndarray) -> np.ndarray:
        """Return `theta` with the thresholds of `members` at their seeds."""
        theta, order = theta.copy(), list(self.model.parameters)
        for number in members:
            for spec in self.candidates[number].parameters:
                if isinstance(spec, Threshold):
                    theta[order.index(self.names[number][spec.name])] = spec.seed
        return theta


def one_of_each(candidates: Iterable[Candidate]) -> list[Candidate]:
    """Return the first of those that differ by their inner constants alone."""
    kept: dict[tuple[str, tuple[tuple[str, str], ...]], Candidate] = {}
    for candidate in candidates:
        kept.setdefault((candidate.label, candidate.terms), candidate)
    return list(kept.values())
