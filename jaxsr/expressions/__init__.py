"""Expressions: primitives, immutable terms, text and SymPy in and out."""

from jaxsr.expressions.affine import affine_slope
from jaxsr.expressions.defined import define_primitive
from jaxsr.expressions.functions import evaluate, to_jax, to_numpy
from jaxsr.expressions.parsing import is_identifier, parse
from jaxsr.expressions.primitives import DISCONTINUOUS, INTEGRALS, PRIMITIVES, Primitive
from jaxsr.expressions.printing import number_text, to_text
from jaxsr.expressions.sympy_bridge import from_sympy, to_sympy
from jaxsr.expressions.term import Term

__all__ = [
    "DISCONTINUOUS",
    "INTEGRALS",
    "PRIMITIVES",
    "Primitive",
    "Term",
    "affine_slope",
    "define_primitive",
    "evaluate",
    "from_sympy",
    "is_identifier",
    "number_text",
    "parse",
    "to_jax",
    "to_numpy",
    "to_sympy",
    "to_text",
]
