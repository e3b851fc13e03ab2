"""A target and the columns of terms in a view, weighed with inner constants as they are."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxsr._deadline import ensure, never
from jaxsr._result import InputError
from jaxsr.evaluation.evaluator import Evaluator
from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array, GramBatch, orthonormal_columns
from jaxsr.regression.resident import ResidentStore, has_room
from jaxsr.regression.ridge import least_squares
from jaxsr.regression.settings import Resources, Rules, Sampling, TargetErrors
from jaxsr.regression.signs import checked_signs, signed_normal_equations, signs_of, wrong
from jaxsr.regression.store import DEPENDENT, ColumnStore, Store
from jaxsr.regression.streamed import StreamedStore
from jaxsr.regression.weighing import Weighing

View = Callable[[Array], Array]

_HELD = 1024  # columns there must be room for; longer samples are gone through in pieces


class LinearProblem:
    r"""Terms against a target: :math:`\min_\xi \|A(y - F\beta - \Theta\xi)\|`.

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
    rules : Rules, optional
        How terms are weighed, and which may be used.
    sampling : Sampling, optional
        How samples follow each other in time.
    errors : TargetErrors, optional
        What no fit can explain.
    resources : Resources, optional
        What evaluates terms.

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
        rules: Rules | None = None,
        sampling: Sampling | None = None,
        errors: TargetErrors | None = None,
        resources: Resources | None = None,
    ) -> None:
        rules, sampling = rules or Rules(), sampling or Sampling()
        errors, resources = errors or TargetErrors(), resources or Resources()
        self.y = np.asarray(y, dtype=np.float64)
        if self.y.ndim != 1 or not len(self.y):
            raise InputError(f"y must be a non-empty vector, got shape {self.y.shape}", "y")
        if not np.all(np.isfinite(self.y)):
            raise InputError("y holds values that are not finite", "y", "Drop those rows.")
        self.variables = {k: np.asarray(v, dtype=np.float64) for k, v in variables.items()}
        self.view = view
        self.expired: Callable[[], bool] = never
        self.ridge, self.threshold, self.refinement = rules.ridge, rules.threshold, rules.refinement
        self.signs, self.admits = checked_signs(rules.signs), rules.admits
        self.time, self.group = sampling.time, sampling.group
        self.floor, self.noise = errors.floor, errors.noise
        self.rows = len(self.y)
        self.samples = next((len(v) for v in self.variables.values()), self.rows)
        self._check_shapes()
        self.fixed = np.zeros((self.rows, 0)) if fixed is None else np.asarray(fixed, float)
        if self.fixed.shape[0] != self.rows:
            raise InputError(f"fixed has {self.fixed.shape[0]} rows, y has {self.rows}", "fixed")
        self.basis = orthonormal_columns(self.fixed)
        self.target = self.project(self.y[:, None])[:, 0]
        self.total = float(self.target @ self.target)
        self.scale = np.sqrt(self.total) or 1.0
        self.timed = sampling.instants is not None or self.time in self.variables
        self._resources = resources
        self._when = self.time if sampling.instants is None else sampling.instants
        self.evaluator = self._new_evaluator()
        target = self.target / self.scale
        self._weighing = Weighing(self._empty_store(target), float(target @ target))

    def _check_shapes(self) -> None:
        lengths = {name: v.shape for name, v in self.variables.items()}
        if len(set(lengths.values())) > 1:
            raise InputError(f"variables differ in shape: {lengths}", "variables")
        samples = next(iter(lengths.values()), (self.rows,))
        if self.view is None and samples != (self.rows,):
            raise InputError(f"variables have shape {samples}, y has {self.rows} rows", "variables")

    def _new_evaluator(self) -> Evaluator:
        limit = self._resources.limit_bytes // 2
        make = self._resources.evaluator
        return make(self.variables, limit, time=self._when, group=self.group)

    def _empty_store(self, target: Array) -> Store:
        device = self.evaluator.device
        plain = self.view is None and not self.basis.shape[1]
        if device is not None and plain and has_room(self.rows, device):
            return ResidentStore(self._resident, self.admits, target, device)
        limit = self._resources.limit_bytes
        capacity = limit // (16 * self.rows)
        if capacity < _HELD and plain:
            return StreamedStore(self._reduced, self.admits, target, limit)
        project = self.project if self.basis.shape[1] else None
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

    def check(self) -> None:
        """Raise ``OutOfTime`` where the time for the step at hand is over."""
        ensure(self.expired)

    def seen_in_time(self, samples: Array) -> Array:
        """Return columns of samples in the view."""
        self.check()
        return samples if self.view is None else self.view(samples)

    def project(self, columns: Array) -> Array:
        """Return viewed columns without what the fixed columns explain."""
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
            left = self.project(viewed)
            own = np.linalg.norm(left, axis=0) > DEPENDENT * np.linalg.norm(viewed, axis=0)
        return np.where(own, left, np.nan)

    def projected(self, terms: Sequence[Term], *, keep: bool = False) -> Array:
        """Return the columns of terms in the view, projected."""
        if not terms:
            return np.zeros((self.rows, 0))
        return self.project(self.columns(terms, keep=keep))

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
