"""A batch of terms compiled once and evaluated on any data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxsr._result import InputError
from jaxsr.evaluation.cache import ColumnCache
from jaxsr.evaluation.interpreter import interpret
from jaxsr.expressions.parsing import parse
from jaxsr.expressions.postfix import PostfixBatch, compile_postfix, decompile
from jaxsr.expressions.term import Term


@dataclass(frozen=True, slots=True)
class TermBatch:
    """Terms ready to be evaluated.

    Attributes
    ----------
    terms : tuple of Term
    variables : tuple of str
        Order of the columns of the data.
    """

    terms: tuple[Term, ...]
    variables: tuple[str, ...]

    def evaluate(
        self, data: ArrayLike, engine: Literal["columns", "interpreter"] = "columns"
    ) -> NDArray[np.floating]:
        """Return theta (samples, terms) for data (samples, variables).

        float32 data give float32, anything else float64. A sample at which a term has no finite
        value is NaN or infinite there. ``columns`` evaluates each unique subtree once;
        ``interpreter`` runs the postfix reference.

        Raises
        ------
        InputError
            The data have another number of columns than there are variables.
        """
        values = np.asarray(data)
        if values.ndim != 2 or values.shape[1] != len(self.variables):
            raise InputError(
                f"data must be (samples, {len(self.variables)}), got shape {values.shape}",
                "TermBatch.evaluate",
                f"One column for each of {', '.join(self.variables) or 'no variables'}.",
            )
        dtype = np.float32 if values.dtype == np.float32 else np.float64
        values = values.astype(dtype, copy=False)
        if engine == "interpreter":
            return interpret(self.postfix(), values)
        if engine != "columns":
            raise InputError(f"unknown engine {engine!r}", "", "Use 'columns' or 'interpreter'.")
        columns = dict(zip(self.variables, values.T, strict=True))
        cache = ColumnCache(columns, limit_bytes=2**62, dtype=dtype)
        theta = np.empty((len(values), len(self.terms)), dtype)
        for place, term in enumerate(self.terms):
            theta[:, place] = cache.column(term)
        return theta

    def postfix(self) -> PostfixBatch:
        """Return the terms as postfix arrays."""
        return compile_postfix(self.terms, self.variables)


def compile_terms(
    terms: Sequence[str | Term] | PostfixBatch, variables: Sequence[str] | None = None
) -> TermBatch:
    """Make a batch of terms.

    Parameters
    ----------
    terms : sequence of str or Term, or PostfixBatch
        Strings are read in the model grammar.
    variables : sequence of str, optional
        Names of the data's columns, in order; a PostfixBatch brings its own.

    Raises
    ------
    InputError
        A term uses a name that is not a variable.
    """
    if isinstance(terms, PostfixBatch):
        return TermBatch(tuple(decompile(terms)), terms.variables)
    if variables is None:
        raise InputError("variables are missing", "compile_terms", "Name the data's columns.")
    names = tuple(variables)
    read = tuple(parse(t, names, "terms") if isinstance(t, str) else t for t in terms)
    for term in read:
        unknown = sorted(term.variables - set(names))
        if unknown:
            raise InputError(f"unknown variable {unknown[0]}", "", f"Known: {', '.join(names)}.")
    return TermBatch(read, names)
