"""Evaluate batches of terms: cached columns, and the postfix reference in JAX."""

from jaxsr.evaluation.batch import TermBatch, compile_terms
from jaxsr.evaluation.cache import ColumnCache
from jaxsr.evaluation.interpreter import compilations, interpret

__all__ = ["ColumnCache", "TermBatch", "compilations", "compile_terms", "interpret"]
