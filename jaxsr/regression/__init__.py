"""Weigh candidate terms: ridge, hard threshold, constants, intervals, criteria."""

from jaxsr.regression.constants import Refinement, constant_slopes, refine, refine_many
from jaxsr.regression.criteria import aic, bic
from jaxsr.regression.gram import GramBatch, gather_gram, scale_columns
from jaxsr.regression.intervals import coefficient_ci95
from jaxsr.regression.problem import Fit, RegressionProblem
from jaxsr.regression.ridge import least_squares, solve_ridge
from jaxsr.regression.slopes import constants_of, with_constants
from jaxsr.regression.spectrum import residual_frequencies
from jaxsr.regression.threshold import HardThreshold

__all__ = [
    "Fit",
    "GramBatch",
    "HardThreshold",
    "Refinement",
    "RegressionProblem",
    "aic",
    "bic",
    "coefficient_ci95",
    "constant_slopes",
    "constants_of",
    "gather_gram",
    "least_squares",
    "refine",
    "refine_many",
    "residual_frequencies",
    "scale_columns",
    "solve_ridge",
    "with_constants",
]
