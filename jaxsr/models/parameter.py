"""A constant of a model."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Parameter:
    """A constant of a model; free to be re-calibrated inside `bounds`, fixed without them."""

    value: float
    unit: str | None = None
    bounds: tuple[float, float] | None = None

    @property
    def free(self) -> bool:
        """Whether the parameter may be re-calibrated."""
        return self.bounds is not None
