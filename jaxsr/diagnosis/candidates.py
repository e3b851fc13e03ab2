"""Candidates: one mechanism at one site, as an edit of a model with neutral values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from jaxsr._result import Verdict
from jaxsr.models import Edit, Model, Parameter, apply_edit
from jaxsr.models.edits import add_to_equation

UNLIMITED = 1e12
"""Stands for no limit: bounds of a model file are numbers."""


@dataclass(frozen=True)
class ParameterSpec:
    """A constant of a mechanism.

    Attributes
    ----------
    name : str
        As in CONTRACT.md, section 4.
    unit : str or None
    low, high : float
        Physical limits (friction dissipates: `low` is 0).
    neutral : float
        The value at which the mechanism does nothing (coefficients), or the value that the
        shape starts from (inner constants).
    coefficient : bool
        Whether the effect is linear in it and vanishes at `neutral`.
    """

    name: str
    unit: str | None = None
    low: float = -UNLIMITED
    high: float = UNLIMITED
    neutral: float = 0.0
    coefficient: bool = True


@dataclass(frozen=True)
class Candidate:
    """A mechanism at a site.

    Templates hold parameter names in braces, e.g. ``"- {Fc}*sign(v)"``.

    Attributes
    ----------
    terms : tuple of (state, template)
        Signed terms appended to equations.
    inertia : tuple of (row, column, template)
        Terms added to the mass matrix.
    readings : tuple of (output, template)
        New readings; ``{old}`` stands for the old one.
    fixed_parameter : str or None
        For ``wrong_value``: the parameter of the model that is set free.
    sentence : str
        What it means, with ``{site}``.
    """

    mechanism: str
    family: str
    site: str
    parameters: tuple[ParameterSpec, ...]
    sentence: str
    terms: tuple[tuple[str, str], ...] = ()
    inertia: tuple[tuple[str, str, str], ...] = ()
    readings: tuple[tuple[str, str], ...] = ()
    fixed_parameter: str | None = None
    source: str = ""
    conflicts: frozenset[str] = field(default_factory=frozenset)

    @property
    def label(self) -> str:
        """Mechanism and site, e.g. ``coulomb_friction@equation:v``."""
        return f"{self.mechanism}@{self.site}"

    @property
    def key(self) -> str:
        """Label and inner constants: tells variants of one mechanism apart."""
        inner = [f"{p.name}={p.neutral:.4g}" for p in self.parameters if not p.coefficient]
        return " ".join([self.label, *inner])

    @property
    def verdict(self) -> Verdict:
        """The verdict this family stands for."""
        return {
            "parameter": Verdict.PARAMETER,
            "measurement": Verdict.MEASUREMENT,
            "external": Verdict.EXTERNAL_INPUT,
        }.get(self.family, Verdict.STRUCTURE)

    def names(self, taken: Iterable[str], suffix: str = "") -> dict[str, str]:
        """Choose parameter names that clash with none of `taken`."""
        if self.fixed_parameter is not None:
            return {self.fixed_parameter: self.fixed_parameter}
        used, chosen = set(taken), {}
        state = self.site.partition(":")[2]
        for spec in self.parameters:
            name = f"{spec.name}{suffix}"
            if name in used:
                name = f"{spec.name}_{state}{suffix}"
            count = 2
            while name in used:
                name, count = f"{spec.name}_{state}_{count}{suffix}", count + 1
            chosen[spec.name] = name
            used.add(name)
        return chosen

    def edit(
        self, model: Model, names: Mapping[str, str], values: Mapping[str, float] | None = None
    ) -> Edit:
        """Return the complete edit of `model`, with `values` by the candidate's own names."""
        values = values or {}
        changes: dict[str, Any] = {}
        if self.fixed_parameter is not None:
            old = model.parameters[self.fixed_parameter]
            value = values.get(self.fixed_parameter, old.value)
            spec = self.parameters[0]
            bounds = old.bounds or (spec.low, spec.high)
            bounds = (min(bounds[0], value), max(bounds[1], value))
            return Edit({f"parameters.{self.fixed_parameter}": Parameter(value, old.unit, bounds)})
        edited = model
        for state, template in self.terms:
            key, text = add_to_equation(edited, state, template.format(**names))
            changes[key] = text
            edited = apply_edit(edited, Edit({key: text}))
        for row, column, template in self.inertia:
            old_entry = model.inertia.get(row, {}).get(column, "1" if row == column else "0")
            changes[f"inertia.{row}.{column}"] = f"{old_entry} + {template.format(**names)}"
        for output, template in self.readings:
            changes[f"readings.{output}"] = template.format(old=model.readings[output], **names)
        for spec in self.parameters:
            value = values.get(spec.name, spec.neutral)
            bounds = _readable(spec, value) if values else (spec.low, spec.high)
            changes[f"parameters.{names[spec.name]}"] = Parameter(value, spec.unit, bounds)
        return Edit(changes)

    def term_text(self, names: Mapping[str, str]) -> str:
        """Return the added term as text."""
        if self.fixed_parameter is not None:
            return self.fixed_parameter
        parts = [t.format(**names) for _, t in self.terms[:1]]
        parts += [t.format(**names) for _, _, t in self.inertia[:1]]
        parts += [t.format(old="reading", **names) for _, t in self.readings[:1]]
        text = parts[0] if parts else ""
        return (
            text.removeprefix("+ ").replace("- ", "-", 1) if text.startswith(("+ ", "- ")) else text
        )


def _readable(spec: ParameterSpec, value: float) -> tuple[float, float]:
    """Bounds for a model file: the physical ones, or ten times the value where there are none."""
    reach = float(f"{10.0 * abs(value):.1g}") or 1.0
    low = spec.low if spec.low > -UNLIMITED else -reach
    high = spec.high if spec.high < UNLIMITED else reach
    return min(low, value), max(high, value)


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
        model, chosen, all_names = given, tuple(candidates), []
        for number, candidate in enumerate(chosen):
            names = candidate.names(model.parameters.keys() | set(model.symbols), f"__{number}")
            if candidate.fixed_parameter is None:
                model = apply_edit(model, candidate.edit(model, names))
            all_names.append(names)
        return SuperModel(model, given, chosen, tuple(all_names))

    def index(self, number: int, coefficients_only: bool = False) -> list[int]:
        """Positions of a candidate's parameters among the model's."""
        order = list(self.model.parameters)
        candidate = self.candidates[number]
        if candidate.fixed_parameter is not None:
            return [order.index(candidate.fixed_parameter)]
        return [
            order.index(self.names[number][spec.name])
            for spec in candidate.parameters
            if spec.coefficient or not coefficients_only
        ]

    def base_index(self) -> list[int]:
        """Positions of the given model's free parameters."""
        order = list(self.model.parameters)
        return [order.index(name) for name in self.given.free_parameters]

    def own_values(self, number: int, theta: Any) -> dict[str, float]:
        """A candidate's parameter values by its own names."""
        order = list(self.model.parameters)
        return {own: float(theta[order.index(full)]) for own, full in self.names[number].items()}
