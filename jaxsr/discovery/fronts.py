"""The candidates of an equation as a table, and what is picked of them."""

from __future__ import annotations

import numpy as np
import pandas as pd

from jaxsr._result import InputError
from jaxsr.discovery.equation import Equation, weighted_sum
from jaxsr.expressions import to_sympy, to_text
from jaxsr.expressions.editing import ONE
from jaxsr.expressions.term import Term

_EXACT = 1e-30  # two losses below this share of the largest differ by rounding alone


def term_at(equation: Equation, index: int | None = None) -> Term:
    """Return the picked right-hand side, or that of row ``index`` of the front.

    Raises
    ------
    InputError
        The front has no such row.
    """
    if index is None:
        return equation.term
    rows = max(len(equation.front), 1)
    if not -rows <= index < rows:
        raise InputError(f"there is no equation {index}", "index", f"Count from 0 to {rows - 1}.")
    if not equation.front:
        return equation.term
    fit = equation.front[index].fit
    return weighted_sum(fit.terms, list(fit.coefficients))


def latex_text(term: Term, digits: int = 4) -> str:
    """Return a term in LaTeX, its numbers to ``digits`` significant ones."""
    from jaxsr.models.exports.latex import rounded_latex

    return rounded_latex(to_sympy(term), digits)


def front_table(equation: Equation) -> pd.DataFrame:
    r"""Return the candidates of one equation, smallest first, the pick marked.

    Columns: complexity (terms), size (nodes and coefficients), loss and validation_loss (mean
    squares), score (:math:`-\Delta\log loss / \Delta size` to the best smaller one), equation,
    picked.
    """
    rows = [
        {
            "complexity": len(c.fit.terms),
            "size": c.size,
            "loss": c.train_mse,
            "validation_loss": c.validation_mse,
            "equation": to_text(weighted_sum(c.fit.terms, list(c.fit.coefficients)), 6),
            "picked": k == equation.pick,
        }
        for k, c in enumerate(equation.front)
    ]
    if not rows:  # recognised or constant: nothing to choose from
        size = sum(1 + (0 if t.term == ONE else t.term.size) for t in equation.terms)
        rows = [
            {
                "complexity": equation.complexity,
                "size": size,
                "loss": equation.train_mse,
                "validation_loss": equation.validation_mse,
                "equation": to_text(equation.term, 6),
                "picked": True,
            }
        ]
    table = pd.DataFrame(rows)
    table.insert(4, "score", _scores(table["size"].to_numpy(), table["loss"].to_numpy()))
    return table


def _scores(size: np.ndarray, loss: np.ndarray) -> np.ndarray:
    """Return how fast the log of the loss falls with size; 0 for what no smaller one beats."""
    floor = max(_EXACT * float(np.max(loss)), np.finfo(float).tiny)
    level = np.log(np.maximum(loss, floor))
    score = np.zeros(len(size))
    last = 0
    for k in range(1, len(size)):
        if level[k] < level[last] and size[k] > size[last]:
            score[k] = (level[last] - level[k]) / (size[k] - size[last])
            last = k
    return score
