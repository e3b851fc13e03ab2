"""Terms that an equation with units admits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from jaxsr.expressions.dimensions import Dimensions
from jaxsr.expressions.term import Term


@dataclass(frozen=True)
class InUnits:
    """Admit the terms that have a meaning in units; see :class:`jaxsr.expressions.Dimensions`.

    Attributes
    ----------
    units : tuple of (str, str)
        Variables and their units.
    """

    units: tuple[tuple[str, str], ...]
    _dimensions: Dimensions = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_dimensions", Dimensions(dict(self.units)))

    @classmethod
    def of(cls, units: Mapping[str, str]) -> InUnits:
        """Admit what has a meaning with these units of the variables."""
        return cls(tuple(sorted(units.items())))

    def __call__(self, term: Term) -> bool:
        """Tell whether the term can have the unit of an equation, up to its coefficient's."""
        return self._dimensions.admissible(term)
