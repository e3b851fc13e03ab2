"""What units, rates and factors of forces read of a model, which asks for them itself."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Protocol

from jaxsr.expressions import Term
from jaxsr.models.parameter import Parameter


class Structure(Protocol):
    """The symbols and formulas of a model, see `Model`."""

    @property
    def time(self) -> str: ...
    @property
    def states(self) -> tuple[str, ...]: ...
    @property
    def inputs(self) -> tuple[str, ...]: ...
    @property
    def outputs(self) -> tuple[str, ...]: ...
    @property
    def symbols(self) -> tuple[str, ...]: ...
    @property
    def parameters(self) -> Mapping[str, Parameter]: ...
    @property
    def units(self) -> Mapping[str, str]: ...
    @property
    def inertia(self) -> Mapping[str, Mapping[str, str]]: ...
    @cached_property
    def equation_terms(self) -> Mapping[str, Term]: ...
    @cached_property
    def reading_terms(self) -> Mapping[str, Term]: ...
    @cached_property
    def inertia_terms(self) -> Mapping[str, Mapping[str, Term]]: ...
