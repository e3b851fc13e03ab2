"""Equations of motion from recordings."""

from typing import TYPE_CHECKING, Any

from jaxsr.discovery.discover import discover
from jaxsr.discovery.equation import Equation, FittedTerm
from jaxsr.discovery.request import Prior, Roles, Run
from jaxsr.discovery.result import Discovery

if TYPE_CHECKING:
    from jaxsr.discovery.estimator import SymbolicSparseRegressor

__all__ = [
    "Discovery",
    "Equation",
    "FittedTerm",
    "Prior",
    "Roles",
    "Run",
    "SymbolicSparseRegressor",
    "discover",
]


def __getattr__(name: str) -> Any:
    """Load the estimator, and scikit-learn with it, when it is asked for."""
    if name != "SymbolicSparseRegressor":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from jaxsr.discovery.estimator import SymbolicSparseRegressor

    return SymbolicSparseRegressor
