"""How long an expression is when it is written down, in bits."""

from __future__ import annotations

import math

from jaxsr.expressions.printing import number_text
from jaxsr.expressions.term import Term


def description_length(expression: Term) -> float:
    r"""Return the bits that write an expression down.

    .. math:: L = k \log_2 n + \sum_c \ell(c)

    k nodes, each one of n different symbols (operators and variables; all numbers are one of
    them), and numbers c with l bits: log2(1 + m) + log2(1 + abs(e)) + 1 for m * 10**e, m and e
    whole. Constants that are estimated stand as variables; what their values take is Schwarz's
    business, log2(rows)/2 bits each.

    Parameters
    ----------
    expression : Term

    Returns
    -------
    float
        Bits.

    References
    ----------
    Udrescu et al., AI Feynman 2.0, NeurIPS 33 (2020), section 2; Bartlett, Desmond & Ferreira,
    Exhaustive symbolic regression, IEEE Trans. Evol. Comput. 28 (2024), equation 11.
    """
    nodes = list(expression.walk())
    symbols = {node.name or node.op for node in nodes}
    numbers = sum(_number_length(node.value) for node in nodes if node.is_constant)
    return len(nodes) * math.log2(max(len(symbols), 2)) + numbers


def estimated_length(expression: Term, rows: float) -> float:
    """Return the bits of an expression whose constants, but whole numbers, are estimates.

    Parameters
    ----------
    expression : Term
    rows : float
        Independent residuals that they are estimated from.
    """
    numbers = 0.5 * estimates(expression) * math.log2(max(rows, 2.0))
    return description_length(opened(expression)) + numbers


def estimates(expression: Term) -> int:
    """Return how many constants are no whole numbers."""
    return sum(_is_estimate(node) for node in expression.walk())


def _is_estimate(node: Term) -> bool:
    return node.is_constant and not node.value.is_integer()


def opened(term: Term) -> Term:
    """Return a term with a symbol in the place of every constant that is no whole number."""
    if _is_estimate(term):
        return Term.variable("a constant")
    return Term(term.op, tuple(map(opened, term.args))) if term.args else term


def _number_length(value: float) -> float:
    if not math.isfinite(value):
        return math.inf
    mantissa, _, exponent = number_text(abs(value)).partition("e")
    whole, _, behind = mantissa.partition(".")
    digits = (whole + behind.rstrip("0")).lstrip("0") or "0"
    stripped = digits.rstrip("0") or "0"
    power = int(exponent or 0) - len(behind.rstrip("0")) + len(digits) - len(stripped)
    return math.log2(1 + int(stripped)) + math.log2(1 + abs(power)) + 1.0


__all__ = ["description_length", "estimated_length", "estimates", "opened"]
