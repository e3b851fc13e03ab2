"""One regression problem: a target, a view, candidate columns and columns that always stay."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxsr._deadline import ensure, never
from jaxsr._result import InputError
from jaxsr.evaluation.evaluator import Evaluator
from jaxsr.expressions.editing import edit
from jaxsr.expressions.term import Term
from jaxsr.regression.beam import beam
from jaxsr.regression.constants import Refinement, refine_many
from jaxsr.regression.dictionary import Dictionary
from jaxsr.regression.elastic_net import ElasticNetRule, Penalty
from jaxsr.regression.elimination import eliminate
from jaxsr.regression.excerpt import Excerpt
from jaxsr.regression.fitting import Fit, fit_terms
from jaxsr.regression.gram import Array, GramBatch, orthonormal_columns
from jaxsr.regression.judging import Judge
from jaxsr.regression.rational import quotients
from jaxsr.regression.resident import ResidentStore, has_room
from jaxsr.regression.ridge import least_squares
from jaxsr.regression.signs import (
    Signs,
    checked_signs,
    signed_normal_equations,
    signs_of,
    wrong,
)
from jaxsr.regression.spectrum import Waves, make_waves, residual_frequencies
from jaxsr.regression.store import DEPENDENT, ColumnStore, Store
from jaxsr.regression.streamed import StreamedStore
from jaxsr.regression.threshold import HardThreshold
from jaxsr.regression.weighing import Weighing

View = Callable[[Array], Array]

_HELD = 1024  # columns there must be room for; longer samples are gone through in pieces


class RegressionProblem:
    r"""Weigh terms against a target: :math:`\min_\xi \|A(y - F\beta - \Theta\xi)\|`.

    Parameters
    ----------
    y : ndarray, (rows,)
        Target, already in the view (:math:`A y`).
    variables : mapping of str to ndarray, (samples,)
        What terms may be made of.
    view : callable, optional
        :math:`A`: maps columns (samples, k) to (rows, k); identity by default, a weak-view
        operator where derivatives of data are to be avoided.
    fixed : ndarray, (rows, p), optional
        Columns of a known model, already in the view. They are projected out of everything
        (Frisch-Waugh), so the search sees only what they cannot explain.
    ridge, threshold, refinement
        Damping of unit-norm columns; the rule that removes negligible terms; the limits of the
        search over inner constants.
    time : str
        Name of the variable that is time, if it is among the variables.
    floor : float
        Relative loss that errors of the target itself leave; a fit that good is exact.
    noise : float
        Relative loss that measurement noise of the target leaves, estimated.
    limit_bytes : int
        Memory for columns. Where it holds fewer than 1024 of them (12,000 rows by default), a
        problem without view and fixed columns keeps none and goes through its samples in pieces;
        any other holds what one call needs.
    signs : mapping of Term to int, optional
        Terms whose coefficients must not be negative (1) or not be positive (-1).
    judge : Judge, optional
        Rows on which :meth:`judge` weighs what these rows have fitted.
    group : ndarray of int, (samples,), optional
        Number of each sample's recording: integrals over time begin anew in each.
    admits : callable, optional
        Whether a term may be used, e.g. :class:`jaxsr.regression.InUnits`; all may when None.
    instants : ndarray, (samples,), optional
        Time of each sample for integrals, where it is not among the variables.
    evaluator : callable, optional
        What makes the evaluator of the terms, called as :class:`jaxsr.evaluation.Evaluator`.

    Attributes
    ----------
    scale : float
        Norm of the target without what the fixed columns explain; 1 where nothing is left.
    expired : callable
        Whether a step must be left in the middle; see :func:`jaxsr._deadline.bounded`.
    """

    def __init__(
        self,
        y: Array,
        variables: Mapping[str, Array],
        *,
        view: View | None = None,
        fixed: Array | None = None,
        ridge: float = 1e-10,
        threshold: HardThreshold | None = None,
        refinement: Refinement | None = None,
        time: str = "t",
        floor: float = 1e-20,
        noise: float = 0.0,
        limit_bytes: int = 192 * 2**20,
        signs: Signs | None = None,
        judge: Judge | None = None,
        group: NDArray[np.intp] | None = None,
        admits: Callable[[Term], bool] | None = None,
        instants: Array | None = None,
        evaluator: Callable[..., Evaluator] = Evaluator,
    ) -> None:
        self.y = np.asarray(y, dtype=np.float64)
        if self.y.ndim != 1 or not len(self.y):
            raise InputError(f"y must be a non-empty vector, got shape {self.y.shape}", "y")
        if not np.all(np.isfinite(self.y)):
            raise InputError("y holds values that are not finite", "y", "Drop those rows.")
        self.variables = {k: np.asarray(v, dtype=np.float64) for k, v in variables.items()}
        self.view = view
        self.expired: Callable[[], bool] = never
        self.ridge = ridge
        self.time = time
        self.floor = floor
        self.noise = noise
        self._dictionaries: dict[Hashable, Dictionary] = {}
        self.threshold = threshold or HardThreshold()
        self.refinement = refinement or Refinement()
        self.rows = len(self.y)
        self.samples = next((len(v) for v in self.variables.values()), self.rows)
        self._check_shapes()
        self.fixed = np.zeros((self.rows, 0)) if fixed is None else np.asarray(fixed, float)
        if self.fixed.shape[0] != self.rows:
            raise InputError(f"fixed has {self.fixed.shape[0]} rows, y has {self.rows}", "fixed")
        self.basis = orthonormal_columns(self.fixed)
        self.target = self._project(self.y[:, None])[:, 0]
        self.total = float(self.target @ self.target)
        self.scale = np.sqrt(self.total) or 1.0
        self.signs = checked_signs(signs)
        self.judging = judge
        self.group = group
        self.admits = admits
        self.judged_rows = judge.rows if judge is not None else 0
        self.timed = instants is not None or time in self.variables
        self._evaluator, self._limit = evaluator, limit_bytes
        self._when = time if instants is None else instants
        self.evaluator = self._new_evaluator()
        target = self.target / self.scale
        self._weighing = Weighing(self._empty_store(target), float(target @ target))
        self._waves: dict[str, Waves | None] = {}
        self.excerpt = Excerpt(self)

    def _check_shapes(self) -> None:
        lengths = {name: v.shape for name, v in self.variables.items()}
        if len(set(lengths.values())) > 1:
            raise InputError(f"variables differ in shape: {lengths}", "variables")
        samples = next(iter(lengths.values()), (self.rows,))
        if self.view is None and samples != (self.rows,):
            raise InputError(f"variables have shape {samples}, y has {self.rows} rows", "variables")

    def _new_evaluator(self) -> Evaluator:
        limit = self._limit // 2
        return self._evaluator(self.variables, limit, time=self._when, group=self.group)

    def _empty_store(self, target: Array) -> Store:
        device = self.evaluator.device
        plain = self.view is None and not self.basis.shape[1]
        if device is not None and plain and has_room(self.rows, device):
            return ResidentStore(self._resident, self.admits, target, device)
        capacity = self._limit // (16 * self.rows)
        if capacity < _HELD and plain:
            return StreamedStore(self._reduced, self.admits, target, self._limit)
        project = self._project if self.basis.shape[1] else None
        return ColumnStore(self.columns, project, self.admits, target, max(256, capacity))

    def _reduced(self, terms: Sequence[Term], use: Callable[[Array, slice], Any]) -> list[Any]:
        self.check()
        return self.evaluator.reduced(terms, use, self.rows)

    def _resident(self, terms: Sequence[Term]) -> Any:
        self.check()
        return self.evaluator.resident(terms)

    @property
    def resident(self) -> ResidentStore | None:
        """Return the columns on a device; None where they are on the host."""
        store = self._weighing.store
        return store if isinstance(store, ResidentStore) else None

    def forget(self) -> None:
        """Drop all columns and their products; results stay the same, work is done again."""
        self._weighing.forget()
        self.evaluator = self._new_evaluator()
        self.excerpt = Excerpt(self)

    def check(self) -> None:
        """Raise ``OutOfTime`` where the time for the step at hand is over."""
        ensure(self.expired)

    def seen_in_time(self, samples: Array) -> Array:
        """Return columns of samples in the view."""
        self.check()
        return samples if self.view is None else self.view(samples)

    def _project(self, columns: Array) -> Array:
        if not self.basis.shape[1]:
            return columns
        return columns - self.basis @ (self.basis.T @ columns)

    def columns(self, terms: Sequence[Term], *, keep: bool = True) -> Array:
        """Return the viewed columns (rows, terms); what is not finite stays so."""
        self.check()
        return self._viewed(self.evaluator.columns(terms, keep=keep))

    def _viewed(self, samples: Array) -> Array:
        if self.view is None:
            return samples
        finite = np.all(np.isfinite(samples), axis=0)
        viewed = np.full((self.rows, samples.shape[1]), np.nan)
        if np.any(finite):
            with np.errstate(over="ignore", invalid="ignore"):  # finite samples, too large to add
                viewed[:, finite] = self.view(samples[:, finite])
        return viewed

    def seen(self, samples: Array) -> Array:
        """Return columns of samples in the view, without what the fixed columns explain.

        A column that the fixed ones explain whole comes back as NaN.
        """
        self.check()
        viewed = self._viewed(samples)
        if not self.basis.shape[1]:
            return viewed
        with np.errstate(all="ignore"):  # a column that is not finite stays so
            left = self._project(viewed)
            own = np.linalg.norm(left, axis=0) > DEPENDENT * np.linalg.norm(viewed, axis=0)
        return np.where(own, left, np.nan)

    def projected(self, terms: Sequence[Term], *, keep: bool = False) -> Array:
        """Return the viewed columns without what the fixed columns explain."""
        if not terms:
            return np.zeros((self.rows, 0))
        return self._project(self.columns(terms, keep=keep))

    def index(self, terms: Sequence[Term]) -> list[int]:
        """Return where each term's unit-norm column is stored; -1 for an unusable term.

        A term is unusable where it is not finite on the data (a zero denominator, the root of a
        negative number), lies in the span of the fixed columns or is not admitted.
        """
        return self._weighing.store.index(terms)

    def admitted(self, terms: Sequence[Term]) -> bool:
        """Tell whether every term may be used, whatever its column holds."""
        return self.admits is None or all(map(self.admits, terms))

    def solve(self, individuals: Sequence[Sequence[Term]]) -> tuple[list[Array], Array]:
        """Ridge-solve many sets of terms at once.

        Returns
        -------
        shares : list of ndarray
            Coefficients of the unit-norm columns, so their sizes compare across terms.
        losses : ndarray, (individuals,)
            Residual sum of squares relative to that of the target; inf where a term is unusable.
        """
        self.check()
        gram, xi, losses = self._weighing.solve(individuals, self.ridge)
        shares = [xi[row, : len(terms)] for row, terms in enumerate(individuals)]
        if self.signs:
            self._constrain(individuals, shares, losses, gram)
        return shares, losses

    def still_losses(self, sets: Sequence[Sequence[Term]]) -> Array:
        """Return undamped losses of sets as they are; see :meth:`Weighing.undamped`."""
        return self._weighing.undamped(sets) if sets else np.zeros(0)

    def _constrain(
        self,
        individuals: Sequence[Sequence[Term]],
        shares: list[Array],
        losses: Array,
        gram: GramBatch,
    ) -> None:
        """Solve again, within the signs, what came out with a wrong one."""
        for row in np.flatnonzero(np.isfinite(losses)).tolist():
            terms = individuals[row]
            sign = signs_of(terms, self.signs)
            if wrong(shares[row], sign):
                size = len(terms)
                matrix = gram.matrix[row, :size, :size] + self.ridge * np.eye(size)
                xi = signed_normal_equations(matrix, gram.moment[row, :size], sign)
                quadratic = xi @ gram.matrix[row, :size, :size] @ xi
                moment = xi @ gram.moment[row, :size]
                shares[row] = xi
                losses[row] = max(float(gram.total - 2.0 * moment + quadratic), 0.0)

    def products(self, terms: Sequence[Term]) -> tuple[Array, Array, list[int]]:
        """Return products of unit-norm columns, with the scaled target, and places (-1: none)."""
        places = self.index(terms)
        gram = self._weighing.grams(np.array([places], dtype=np.intp).reshape(1, -1))
        return gram.matrix[0, : len(places), : len(places)], gram.moment[0], places

    def independent(self, sets: Sequence[Sequence[Term]]) -> list[tuple[Term, ...]]:
        """Return the sets of usable terms without columns that depend on simpler ones of a set."""
        return self._weighing.independent(sets)

    def in_units(self, terms: Sequence[Term], shares: Array) -> Array:
        """Return coefficients of the columns as given from those of unit-norm columns."""
        return shares * self.scale / self._weighing.store.norms(self.index(terms))

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

    def prune(self, terms: Sequence[Term]) -> tuple[Term, ...]:
        """Return the terms that survive hard thresholding."""
        return self.prune_many([terms])[0]

    def prune_many(self, sets: Sequence[Sequence[Term]]) -> list[tuple[Term, ...]]:
        """Return the terms of each set of usable ones that survive hard thresholding."""
        return self._weighing.prune(sets, self.threshold, self.ridge)

    def residual(self, terms: Sequence[Term]) -> Array:
        """Return the target minus its best fit by ``terms`` (rows,)."""
        theta = self.projected(terms)
        xi, _ = least_squares(theta, self.target)
        return self.target - theta @ xi

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

    def quotients(self, frequencies: Sequence[float], count: int) -> list[tuple[Term, ...]]:
        """Return quotients of short sums; see :func:`jaxsr.regression.rational.quotients`."""
        return quotients(self, frequencies, count) if self.total > 0.0 else []

    def waves(self, variable: str) -> Waves | None:
        """Return the sines and cosines of a variable that the spectrum is taken with."""
        if variable not in self._waves:
            is_time = variable == self.time
            values = self.variables[variable]
            self._waves[variable] = make_waves(values, self.excerpt, is_time=is_time)
        return self._waves[variable]

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
