"""Equations of motion from recordings."""

from jaxsr.discovery.discover import discover
from jaxsr.discovery.equation import Equation, FittedTerm
from jaxsr.discovery.estimator import SymbolicSparseRegressor
from jaxsr.discovery.result import Discovery

__all__ = ["Discovery", "Equation", "FittedTerm", "SymbolicSparseRegressor", "discover"]
