"""The search as a scikit-learn estimator."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted, check_random_state, validate_data

from jaxsr._progress import Budget, as_budget
from jaxsr._result import InputError
from jaxsr.discovery import plots
from jaxsr.discovery.equation import Equation, FittedTerm, cut_short
from jaxsr.discovery.find import Task, find_equation
from jaxsr.discovery.fronts import front_table, latex_text, term_at
from jaxsr.discovery.samples import Samples, thinned
from jaxsr.evolution import PrimitiveSet, SearchConfig
from jaxsr.evolution.config import DEFAULT_FUNCTIONS
from jaxsr.expressions import is_identifier, parse, to_jax, to_numpy, to_sympy
from jaxsr.expressions.editing import ONE, edit
from jaxsr.expressions.term import Term

if TYPE_CHECKING:
    from jaxtyping import Float
    from matplotlib.axes import Axes

Guess = str | Sequence[str]
_LEAST_HELD = 5  # samples to choose by; with fewer, all of them serve
_MOST_DRAWN = 4000  # samples kept for the plots


class SymbolicSparseRegressor(RegressorMixin, BaseEstimator):
    """Fit y = sum of coefficient times term, the terms found by evolution.

    Parameters
    ----------
    population, generations : int
        Size and most generations of the search.
    functions : tuple of str
        Primitives that terms may use.
    guesses : sequence of str or of sequences of str, optional
        Expressions to start from, each a text or the texts of its terms; their coefficients are
        fitted in any case.
    validation_fraction : float
        Share of the samples, drawn at random, that chooses among the Pareto front.
    budget : float, optional
        Seconds, shared by the outputs.
    warm_start : bool
        True: a further ``fit`` starts from the front of the last one.
    random_state : int, RandomState or None
    config : SearchConfig, optional
        All settings of the search, in place of ``population``, ``generations`` and ``functions``.
    n_jobs : int, optional
        Threads that evaluate terms; None or -1: one for each core.

    Attributes
    ----------
    equations_ : DataFrame, or list of DataFrame for a ``y`` of several columns
        Candidates, smallest first: complexity (terms), size (nodes and coefficients), loss,
        validation_loss, score (fall of log loss per unit of size), equation, picked.
    pareto_
        The same.
    found_ : tuple of Equation
        For each output its terms with coefficients, intervals and front.
    terms_, coef_, intervals_
        Terms, coefficients (terms,) and 95 % intervals (terms, 2) of the pick; lists of these
        for several outputs.
    stopped_by_ : StoppedBy
        Why the search ended.
    names_ : list of str
        Variables in the terms, one for each feature.

    Examples
    --------
    >>> import numpy as np
    >>> X = np.random.default_rng(0).uniform(-2.0, 2.0, (100, 2))
    >>> y = 2.0 * X[:, 0] ** 2 - 3.0 * X[:, 1]
    >>> model = SymbolicSparseRegressor(population=50, random_state=0).fit(X, y)
    >>> print(model.latex())
    2.0 x_{0}^{2} - 3.0 x_{1}
    """

    def __init__(
        self,
        population: int = 200,
        generations: int = 100,
        functions: tuple[str, ...] = DEFAULT_FUNCTIONS,
        guesses: Sequence[Guess] | None = None,
        validation_fraction: float = 0.25,
        budget: float | None = None,
        warm_start: bool = False,
        random_state: Any = None,
        config: SearchConfig | None = None,
        n_jobs: int | None = None,
    ) -> None:
        self.population = population
        self.generations = generations
        self.functions = functions
        self.guesses = guesses
        self.validation_fraction = validation_fraction
        self.budget = budget
        self.warm_start = warm_start
        self.random_state = random_state
        self.config = config
        self.n_jobs = n_jobs

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = True
        return tags

    def fit(
        self, X: Any, y: Any, *, variable_names: Sequence[str] | None = None
    ) -> SymbolicSparseRegressor:
        """Search, choose and estimate.

        Parameters
        ----------
        X : array or DataFrame, (samples, features)
            Columns of a DataFrame lend their names to the terms where those are identifiers.
        y : array, (samples,) or (samples, outputs)
        variable_names : sequence of str, optional
            Names of the features in the terms.

        Raises
        ------
        ValueError
            NaN, shapes that do not fit, or a parameter out of its range.
        """
        targets = _column_names(y)
        X, y = validate_data(self, X, y, y_numeric=True, multi_output=True, dtype=np.float64)
        if not 0.0 <= self.validation_fraction < 1.0:
            raise InputError(
                f"validation_fraction must lie in [0, 1), got {self.validation_fraction}"
            )
        if self.n_jobs is not None and self.n_jobs != -1 and self.n_jobs < 1:
            raise InputError(f"n_jobs must be -1 or at least 1, got {self.n_jobs}", "n_jobs")
        rng = np.random.default_rng(check_random_state(self.random_state).randint(2**31 - 1))
        previous = getattr(self, "found_", ()) if self.warm_start else ()
        before = getattr(self, "names_", None)
        self.names_ = self._names(X.shape[1], variable_names)
        columns = y.reshape(len(y), -1).astype(np.float64)
        self._single = y.ndim == 1
        targets = targets if len(targets) == columns.shape[1] else []
        numbered = ["y"] if self._single else [f"y{k}" for k in range(columns.shape[1])]
        self.target_names_ = targets or numbered
        limit, found = as_budget(self.budget), []
        for k, name in enumerate(self.target_names_):
            guesses = [*self._guessed(), *_front_of(previous, k, before == self.names_)]
            part = self._samples(X, {name: columns[:, k]})
            share = limit.share(1.0 / (len(self.target_names_) - k))
            found.append(self._find(rng, name, part, guesses, share).trimmed())
        self.found_ = tuple(found)
        self._settle(X, columns)
        return self

    def _find(
        self,
        rng: np.random.Generator,
        name: str,
        samples: Samples,
        guesses: Sequence[tuple[Term, ...]],
        budget: Budget,
    ) -> Equation:
        count = len(samples)
        y = samples.targets[name]
        # one or two samples, or a target that never changes, tell of nothing but a constant
        if count < 3 or np.ptp(y) == 0.0:
            value = float(y[0]) if np.ptp(y) == 0.0 else float(np.mean(y))
            constant = FittedTerm(ONE, value, (value, value))
            error = float(np.mean((y - value) ** 2))
            return Equation(name, (constant,) if value else (), error, error)
        order = rng.permutation(count)
        aside = int(self.validation_fraction * count)
        aside = aside if aside >= _LEAST_HELD else 0
        train, judge = samples.take(np.sort(order[aside:])), samples.take(np.sort(order[:aside]))
        config = self.config or SearchConfig(
            population=self.population,
            generations=self.generations,
            primitives=PrimitiveSet(functions=tuple(self.functions)),
        )
        # as many terms as samples would pass through all of them and say nothing
        most = max(1, min(config.sizes.terms, len(train) // 2))
        config = replace(config, sizes=replace(config.sizes, terms=most))
        threads = None if self.n_jobs == -1 else self.n_jobs
        task = Task(name, "", config=config, guesses=tuple(guesses), threads=threads)
        return find_equation(rng, task, train, judge if aside else train, samples, budget=budget)

    def _samples(self, X: np.ndarray, targets: dict[str, np.ndarray]) -> Samples:
        variables = dict(zip(self.names_, np.ascontiguousarray(X.T), strict=True))
        return Samples(variables, targets, np.zeros(len(X), int), frozenset())

    def _settle(self, X: np.ndarray, y: np.ndarray) -> None:
        """Lay out what was found as attributes."""
        tables = [front_table(equation) for equation in self.found_]
        self.equations_ = self.pareto_ = self._as_given(tables)
        self.terms_ = self._as_given([tuple(t.term for t in e.terms) for e in self.found_])
        self.coef_ = self._as_given(
            [np.array([t.coefficient for t in e.terms]) for e in self.found_]
        )
        self.intervals_ = self._as_given(
            [np.array([t.ci95 for t in e.terms]).reshape(-1, 2) for e in self.found_]
        )
        early = cut_short(e.stopped_by for e in self.found_)
        self.stopped_by_ = early or self.found_[0].stopped_by
        rows = thinned(np.arange(len(X)), _MOST_DRAWN)
        self._drawn = X[rows], y[rows]

    def _as_given(self, items: list[Any]) -> Any:
        return items[0] if self._single else items

    def _guessed(self) -> list[tuple[Term, ...]]:
        if isinstance(self.guesses, str):
            raise InputError("guesses must be a list of expressions, got a text", "guesses")
        sets = [[guess] if isinstance(guess, str) else guess for guess in self.guesses or ()]
        return [edit(parse(text, self.names_, "guesses") for text in texts) for texts in sets]

    def _names(self, count: int, given: Sequence[str] | None) -> list[str]:
        if given is not None:
            names = [str(n) for n in given]
            strange = [n for n in names if not is_identifier(n)]
            if len(names) != count or len(set(names)) != count or strange:
                raise InputError(
                    f"variable_names must be {count} different identifiers, got {names}"
                )
            return names
        columns = [str(n) for n in getattr(self, "feature_names_in_", ())]
        usable = len(set(columns)) == count and all(is_identifier(n) for n in columns)
        return columns if usable else [f"x{k}" for k in range(count)]

    def predict(
        self, X: Any, index: int | None = None
    ) -> Float[np.ndarray, " samples"] | Float[np.ndarray, "samples outputs"]:
        """Return the picked equation, or row ``index`` of ``equations_``, on X.

        Where a term is not finite on a sample (the root of a negative number, say), the
        prediction is NaN, with a warning.

        Parameters
        ----------
        X : array, (samples, features)
        index : int, optional

        Returns
        -------
        ndarray, (samples,) or (samples, outputs)
        """
        check_is_fitted(self, "found_")
        X = validate_data(self, X, reset=False, dtype=np.float64)
        y = self.to_numpy(index)(X)
        bad = np.atleast_2d(~np.isfinite(y).T).any(axis=0)
        if np.any(bad):
            warnings.warn(
                f"the equation has no finite value on {int(bad.sum())} of {len(X)} samples; "
                "the prediction there is NaN",
                UserWarning,
                stacklevel=2,
            )
        return np.where(np.isfinite(y), y, np.nan)

    def _right_hand_sides(self, index: int | None) -> list[Term]:
        check_is_fitted(self, "found_")
        return [term_at(equation, index) for equation in self.found_]

    def sympy(self, index: int | None = None) -> Any:
        """Return the picked equation (or row ``index``) in SymPy; a list for several outputs."""
        return self._as_given([to_sympy(term) for term in self._right_hand_sides(index)])

    def latex(self, digits: int = 4, index: int | None = None) -> Any:
        """Return the equation in LaTeX, its numbers to ``digits`` significant ones."""
        sides = self._right_hand_sides(index)
        return self._as_given([latex_text(term, digits) for term in sides])

    def to_numpy(self, index: int | None = None) -> Callable[[Any], np.ndarray]:
        """Return a NumPy function of X (samples, features)."""
        return _OfColumns(tuple(self._right_hand_sides(index)), tuple(self.names_), self._single)

    def to_jax(self, index: int | None = None) -> Callable[[Any], Any]:
        """Return a JAX function of X (samples, features), to differentiate and compile."""
        import jax.numpy as jnp

        function, names = to_jax(self._right_hand_sides(index)), list(self.names_)
        single = self._single

        def of_columns(X: Any) -> Any:
            values = function({name: X[..., k] for k, name in enumerate(names)})
            # a constant equation has no column to take its shape from
            values = [jnp.broadcast_to(value, X.shape[:-1]) for value in values]
            return values[0] if single else jnp.stack(values, axis=-1)

        return of_columns

    def plot_front(self, ax: Axes | None = None, *, output: int = 0) -> Axes:
        """Plot the candidates' loss over their size, the pick ringed."""
        check_is_fitted(self, "found_")
        table: pd.DataFrame = self.equations_ if self._single else self.equations_[output]
        return plots.plot_front(table, ax)

    def plot_fit(self, ax: Axes | None = None, *, output: int = 0) -> Axes:
        """Plot the prediction of the training samples against their target."""
        return plots.plot_fit(self._shown(output), ax)

    def plot_residual(self, ax: Axes | None = None, *, output: int = 0) -> Axes:
        """Plot target minus prediction of the training samples over the prediction."""
        return plots.plot_residual(self._shown(output), ax)

    def _shown(self, output: int) -> plots.Fitted:
        check_is_fitted(self, "found_")
        X, y = self._drawn
        fit = self.to_numpy()(X).reshape(len(X), -1)
        return plots.Fitted(y[:, output], fit[:, output], name=self.target_names_[output])


class _OfColumns:
    """A function of X that pickles."""

    def __init__(self, terms: tuple[Term, ...], names: tuple[str, ...], single: bool) -> None:
        self._terms, self._names, self._single = terms, names, single

    def __call__(self, X: Any) -> np.ndarray:
        X = np.asarray(X, dtype=np.float64)
        environment = {name: X[:, k] for k, name in enumerate(self._names)}
        values = [
            np.broadcast_to(to_numpy(term)(environment), len(X)).astype(np.float64)
            for term in self._terms
        ]
        return values[0] if self._single else np.column_stack(values)


def _column_names(y: Any) -> list[str]:
    """Return the names of the outputs where ``y`` has some that can be told apart."""
    names = getattr(y, "columns", None)
    if names is None and getattr(y, "name", None) is not None:
        names = [y.name]
    found = [str(n) for n in names] if names is not None else []
    return found if len(set(found)) == len(found) else []


def _front_of(found: Sequence[Equation], output: int, same_names: bool) -> list[tuple[Term, ...]]:
    if not same_names or output >= len(found):
        return []
    return [c.fit.terms for c in found[output].front if c.fit.terms]
