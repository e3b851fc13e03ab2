"""The search as a scikit-learn estimator."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import sympy
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted, check_random_state, validate_data

from jaxsr._result import InputError
from jaxsr.discovery.choose import choose, predict
from jaxsr.discovery.equation import weighted_sum
from jaxsr.evolution import PrimitiveSet, SearchConfig, search
from jaxsr.evolution.config import DEFAULT_FUNCTIONS
from jaxsr.expressions import is_identifier, to_sympy, to_text
from jaxsr.regression import RegressionProblem


class SymbolicSparseRegressor(RegressorMixin, BaseEstimator):
    """Fit y = sum of coefficient times term, the terms found by evolution.

    Parameters
    ----------
    population, generations : int
        Size and most generations of the search.
    functions : tuple of str
        Primitives that terms may use.
    validation_fraction : float
        Share of the samples, drawn at random, that chooses among the Pareto front.
    budget : float, optional
        Seconds.
    random_state : int, RandomState or None

    Attributes
    ----------
    terms_ : tuple of Term
    coef_ : ndarray, (terms,)
    pareto_ : DataFrame
        Candidates: complexity, mse, validation_mse, expression, picked.
    """

    def __init__(
        self,
        population: int = 200,
        generations: int = 100,
        functions: tuple[str, ...] = DEFAULT_FUNCTIONS,
        validation_fraction: float = 0.25,
        budget: float | None = None,
        random_state: Any = None,
    ) -> None:
        self.population = population
        self.generations = generations
        self.functions = functions
        self.validation_fraction = validation_fraction
        self.budget = budget
        self.random_state = random_state

    def fit(self, X: Any, y: Any) -> SymbolicSparseRegressor:
        """Search, choose and estimate; X (samples, features), y (samples,)."""
        X, y = validate_data(self, X, y, y_numeric=True, dtype=np.float64)
        if not 0.0 <= self.validation_fraction < 1.0:
            raise InputError(
                f"validation_fraction must lie in [0, 1), got {self.validation_fraction}"
            )
        seed = check_random_state(self.random_state).randint(2**31 - 1)
        rng = np.random.default_rng(seed)
        self.names_ = self._names(X.shape[1])
        variables = dict(zip(self.names_, X.T, strict=True))
        held = np.zeros(len(y), dtype=bool)
        count = int(self.validation_fraction * len(y))
        if count >= 5:
            held[rng.permutation(len(y))[:count]] = True
        rows = ~held
        problem = RegressionProblem(y[rows], {k: v[rows] for k, v in variables.items()}, time="")
        config = SearchConfig(
            population=self.population,
            generations=self.generations,
            primitives=PrimitiveSet(functions=tuple(self.functions)),
        )
        state, self.stopped_by_ = search(rng, problem, config, budget=self.budget)
        judge = held if np.any(held) else rows
        sets = [(), *(m.terms for m in state.front.members)]
        candidates, pick = choose(
            problem, sets, {k: v[judge] for k, v in variables.items()}, y[judge]
        )
        whole = RegressionProblem(y, variables, time="")
        terms = candidates[pick].fit.terms
        self.terms_ = whole.refine(terms)[0] if terms else ()
        self.coef_ = whole.fit(self.terms_).coefficients
        self.pareto_ = pd.DataFrame(
            {
                "complexity": [len(c.fit.terms) for c in candidates],
                "mse": [c.train_mse for c in candidates],
                "validation_mse": [c.validation_mse for c in candidates],
                "expression": [
                    to_text(weighted_sum(c.fit.terms, list(c.fit.coefficients)), 6)
                    for c in candidates
                ],
                "picked": [k == pick for k in range(len(candidates))],
            }
        )
        return self

    def _names(self, count: int) -> list[str]:
        given = getattr(self, "feature_names_in_", None)
        if given is not None and all(is_identifier(str(n)) for n in given):
            return [str(n) for n in given]
        return [f"x{k}" for k in range(count)]

    def predict(self, X: Any) -> np.ndarray:
        """Return the fitted expression on X (samples, features)."""
        check_is_fitted(self, "terms_")
        X = validate_data(self, X, reset=False, dtype=np.float64)
        return predict(self.terms_, self.coef_, dict(zip(self.names_, X.T, strict=True)))

    def sympy(self) -> sympy.Basic:
        """Return the fitted expression as a SymPy one."""
        check_is_fitted(self, "terms_")
        return to_sympy(weighted_sum(self.terms_, list(self.coef_)))

    def latex(self, digits: int = 4) -> str:
        """Return the fitted expression in LaTeX, its numbers to ``digits`` significant ones."""
        expression = self.sympy()
        rounded = {n: sympy.Float(n, digits) for n in expression.atoms(sympy.Float)}
        return sympy.latex(expression.xreplace(rounded))
