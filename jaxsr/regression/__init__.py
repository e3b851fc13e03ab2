"""Weigh candidate terms: ridge, hard threshold, constants, intervals, criteria."""

from jaxsr.regression.constants import constant_slopes, refine, refine_many
from jaxsr.regression.criteria import aic, bic
from jaxsr.regression.elastic_net import ElasticNetRule, elastic_net
from jaxsr.regression.fitting import Fit, fit_terms
from jaxsr.regression.gram import GramBatch, gather_gram, scale_columns
from jaxsr.regression.intervals import coefficient_ci95
from jaxsr.regression.judging import Judge
from jaxsr.regression.problem import RegressionProblem
from jaxsr.regression.refinement import Refinement
from jaxsr.regression.ridge import least_squares, solve_ridge
from jaxsr.regression.settings import Resources, Rules, Sampling, TargetErrors
from jaxsr.regression.signs import signed_least_squares
from jaxsr.regression.slopes import constants_of, with_constants
from jaxsr.regression.spectrum import residual_frequencies, residual_waves
from jaxsr.regression.threshold import HardThreshold
from jaxsr.regression.units import InUnits

__all__ = [
    "ElasticNetRule",
    "Resources",
    "Fit",
    "GramBatch",
    "HardThreshold",
    "InUnits",
    "Judge",
    "Refinement",
    "RegressionProblem",
    "Rules",
    "Sampling",
    "TargetErrors",
    "aic",
    "bic",
    "coefficient_ci95",
    "constant_slopes",
    "constants_of",
    "elastic_net",
    "fit_terms",
    "gather_gram",
    "least_squares",
    "refine",
    "refine_many",
    "residual_frequencies",
    "residual_waves",
    "scale_columns",
    "signed_least_squares",
    "solve_ridge",
    "with_constants",
]
