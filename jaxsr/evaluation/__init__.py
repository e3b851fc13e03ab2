"""Evaluate batches of terms: a compiled register machine, cached columns, a postfix reference."""

from jaxsr.evaluation.batch import TermBatch, compile_terms
from jaxsr.evaluation.cache import ColumnCache
from jaxsr.evaluation.compiled import keep_compiled
from jaxsr.evaluation.engine import EngineConfig
from jaxsr.evaluation.evaluator import Evaluator, Reference
from jaxsr.evaluation.interpreter import compilations, interpret

__all__ = [
    "ColumnCache",
    "EngineConfig",
    "Evaluator",
    "Reference",
    "TermBatch",
    "compilations",
    "compile_terms",
    "interpret",
    "keep_compiled",
]
