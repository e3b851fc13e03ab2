"""One regression problem: a target, a view, candidate columns and columns that always stay."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence

import numpy as np

from jaxsr._result import InputError
from jaxsr.expressions.editing import edit
from jaxsr.expressions.term import Term
from jaxsr.regression.beam import beam
from jaxsr.regression.constants import refine_many
from jaxsr.regression.dictionary import Dictionary
from jaxsr.regression.elastic_net import ElasticNetRule, Penalty
from jaxsr.regression.elimination import eliminate
from jaxsr.regression.excerpt import Excerpt
from jaxsr.regression.fitting import Fit, fit_terms
from jaxsr.regression.gram import Array
from jaxsr.regression.judging import Judge
from jaxsr.regression.linear import LinearProblem, View
from jaxsr.regression.rational import quotients
from jaxsr.regression.settings import Resources, Rules, Sampling, TargetErrors
from jaxsr.regression.signs import Signs
from jaxsr.regression.spectrum import Waves, make_waves, residual_frequencies, residual_waves

_MOST_WAVES = 256 * 2**20  # bytes of sines and cosines that are kept


class RegressionProblem(LinearProblem):
    """A linear problem, and the searches for terms that would explain more of its target.

    Parameters
    ----------
    y, variables, view, fixed, rules, sampling, errors, resources
        As a :class:`LinearProblem`'s.
    judge : Judge, optional
        Rows on which :meth:`judge` weighs what these rows have fitted.
    """

    def __init__(
        self,
        y: Array,
        variables: Mapping[str, Array],
        *,
        view: View | None = None,
        fixed: Array | None = None,
        rules: Rules | None = None,
        sampling: Sampling | None = None,
        errors: TargetErrors | None = None,
        resources: Resources | None = None,
        judge: Judge | None = None,
    ) -> None:
        super().__init__(
            y,
            variables,
            view=view,
            fixed=fixed,
            rules=rules,
            sampling=sampling,
            errors=errors,
            resources=resources,
        )
        self.judging = judge
        self.judged_rows = judge.rows if judge is not None else 0
        self._dictionaries: dict[Hashable, Dictionary] = {}
        self._waves: dict[tuple[str, str], Waves | None] = {}
        self.excerpt = Excerpt(self)

    def forget(self) -> None:
        """Drop all columns and their products; results stay the same, work is done again."""
        super().forget()
        self.excerpt = Excerpt(self)

    def judge(self, individuals: Sequence[Sequence[Term]]) -> Array:
        """Return losses on the judge's rows with coefficients from these rows.

        Raises
        ------
        InputError
            The problem has no judge.
        """
        if self.judging is None:
            raise InputError(
                "fitness on validation rows needs some", "RegressionProblem", "Give `judge`."
            )
        return self.judging.losses(self, individuals)

    def dictionary(self, key: Hashable, make: Callable[[], Sequence[Term]]) -> Dictionary:
        """Return the candidate columns known as ``key``, made at the first call."""
        if key not in self._dictionaries:
            self._dictionaries[key] = Dictionary(self, make())
        return self._dictionaries[key]

    def beam(self, terms: Sequence[Term], width: int) -> list[tuple[Term, ...]]:
        """Return the best pairs and triples; see :func:`jaxsr.regression.beam.beam`."""
        return beam(self, terms, width)

    def eliminate(self, terms: Sequence[Term], most: int) -> list[tuple[tuple[Term, ...], float]]:
        """Remove terms one by one; see :func:`jaxsr.regression.elimination.eliminate`."""
        return eliminate(self, terms, most)

    def refine(self, terms: Sequence[Term]) -> tuple[tuple[Term, ...], float]:
        """Move inner constants to a local minimum; see :func:`jaxsr.regression.refine`."""
        return self.refine_many([terms])[0]

    def refine_many(self, sets: Sequence[Sequence[Term]]) -> list[tuple[tuple[Term, ...], float]]:
        """Move inner constants of many sets at once; see :func:`jaxsr.regression.refine_many`."""
        refined = refine_many(self, sets, self.refinement)
        bound = [k for k, (terms, _) in enumerate(refined) if any(t in self.signs for t in terms)]
        if bound:  # the search over constants knows no signs; its loss is weighed with them
            _, losses = self.solve([refined[k][0] for k in bound])
            for k, loss in zip(bound, losses, strict=True):
                refined[k] = (refined[k][0], max(float(loss), refined[k][1]))
        return [(t, x if self.admitted(edit(t)) else np.inf) for t, x in refined]

    def frequencies(self, terms: Sequence[Term], variable: str, count: int) -> list[float]:
        """Return frequencies in the residual; see :func:`residual_frequencies`."""
        return residual_frequencies(self, terms, variable, count)

    def modulated(
        self, terms: Sequence[Term], variable: str, factors: Sequence[str], count: int
    ) -> list[tuple[str, float]]:
        """Return factors and frequencies of waves in the residual; see :func:`residual_waves`."""
        return residual_waves(self, terms, variable, count, factors)

    def quotients(self, frequencies: Sequence[float], count: int) -> list[tuple[Term, ...]]:
        """Return quotients of short sums; see :func:`jaxsr.regression.rational.quotients`."""
        return quotients(self, frequencies, count) if self.total > 0.0 else []

    def waves(self, variable: str, factor: str = "") -> Waves | None:
        """Return the sines and cosines of a variable that the spectrum is taken with.

        Times another variable, where a `factor` is named.
        """
        key = variable, factor
        if key not in self._waves:
            values, is_time = self.variables[variable], variable == self.time
            times = self.variables[factor] if factor else None
            self._waves[key] = make_waves(values, self.excerpt, is_time=is_time, factor=times)
            while (
                sum(w.bytes for w in self._waves.values() if w) > _MOST_WAVES
                and len(self._waves) > 1
            ):
                del self._waves[next(k for k in self._waves if k != key)]  # the oldest
        return self._waves[key]

    def fit(
        self,
        terms: Sequence[Term],
        *,
        signs: Signs | None = None,
        penalty: Penalty = "ridge",
        rule: ElasticNetRule | None = None,
    ) -> Fit:
        """Solve one set of terms; see :func:`jaxsr.regression.fit_terms`."""
        return fit_terms(self, terms, signs=signs, penalty=penalty, rule=rule)
