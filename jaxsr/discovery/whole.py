"""Laws found on a part of long recordings, estimated on all of them, piece by piece."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jaxsr._clock import now
from jaxsr._progress import Budget
from jaxsr._result import InputError
from jaxsr.discovery.equation import Equation, FittedTerm
from jaxsr.discovery.find import Task
from jaxsr.discovery.rollout import System, cut
from jaxsr.discovery.samples import Roles, Samples, samples
from jaxsr.discovery.trial import QUICK, Trial, is_open
from jaxsr.expressions.term import Term
from jaxsr.recordings import Recording
from jaxsr.regression import (
    coefficient_ci95,
    constant_slopes,
    constants_of,
    with_constants,
)

_NORMAL = 1.96  # half of a 95 % interval, in standard deviations
_STEP = 0.1  # of a constant inside a term, relative: a longer step is no correction
_LENGTH, _MOST = 257, 32  # samples of a stretch that is simulated, and stretches of a piece
_AHEAD = 1.3  # times the longest piece so far that must be left for the next


def estimated_on_whole(
    equations: Sequence[Equation],
    tasks: Mapping[str, Task],
    pieces: Sequence[Recording],
    part: Roles,
    limit: Budget,
) -> tuple[list[Equation], int]:
    """Return equations with coefficients and errors of whole recordings, and the rows used.

    Coefficients that roll-outs have estimated are weighted means of the pieces' own roll-outs;
    others are least squares over all pieces. Every piece is treated by itself, so that memory
    stays that of one; where the time does not suffice for all of them, evenly spread ones serve.

    Parameters
    ----------
    equations : sequence of Equation
    tasks : mapping of str to Task
    pieces : sequence of Recording
        All of the data.
    part : Roles
    limit : Budget
    """
    fitted = {e.state: Sums() for e in equations if e.front and not is_open(e)}
    open_ = [e.state for e in equations if is_open(e)]
    known = {e.state: e.term for e in equations if e.state not in open_}
    known |= {s: task.known for s, task in tasks.items() if task.known is not None and s in open_}
    means = Means()
    squares = {e.state: [0.0, 0.0] for e in equations}
    used = 0
    for rows in _treated(pieces, part, limit):
        used += len(rows)
        for equation in equations:
            if equation.state in fitted:
                fitted[equation.state].add(tasks[equation.state], equation, rows)
        if open_:
            means.add(equations, known, rows, part.time, limit)
        _add_squares(squares, equations, rows)
    out = []
    for equation in equations:
        if equation.state in fitted:
            equation = fitted[equation.state].estimated(equation)
        elif equation.state in open_:
            equation = means.estimated(equation)
        total, count = squares[equation.state]
        out.append(replace(equation, train_mse=total / count) if count else equation)
    return out, used


def with_errors(
    equations: Sequence[Equation], pieces: Sequence[Recording], part: Roles, limit: Budget
) -> list[Equation]:
    """Return equations with their mean squares on recordings held out, ``held_out_mse``."""
    squares = {e.state: [0.0, 0.0] for e in equations}
    for rows in _treated(pieces, part, limit, least=1):
        _add_squares(squares, equations, rows)
    return [
        replace(e, held_out_mse=total / count if count and np.isfinite(total) else None)
        for e, (total, count) in zip(equations, squares.values(), strict=True)
    ]


def _treated(
    pieces: Sequence[Recording], part: Roles, limit: Budget, *, least: int = 0
) -> Iterator[Samples]:
    """Yield the rows of pieces, spread ones first, as long as there is time for one more.

    ``least`` pieces are treated whatever the time.

    Raises
    ------
    InputError
        No piece has a row.
    """
    longest, error, some = 0.0, None, 0
    for place in _spread(len(pieces)):
        began = now()
        if some >= least and limit.remaining <= _AHEAD * longest:
            return
        try:
            rows = samples([pieces[place]], part)
        except InputError as told:
            error = told
            continue
        some += 1
        yield rows
        longest = max(longest, now() - began)
    if error is not None and not some:
        raise error


def _spread(count: int) -> list[int]:
    """Return the numbers below ``count``, evenly spread ones wherever the list is cut."""
    return np.argsort((0.618034 * np.arange(count)) % 1.0, kind="stable").argsort().tolist()


def _add_squares(
    squares: Mapping[str, list[float]], equations: Sequence[Equation], rows: Samples
) -> None:
    for equation in equations:
        error = rows.targets[equation.state] - equation.predict(rows)
        squares[equation.state][0] += float(np.sum(error**2))
        squares[equation.state][1] += len(error)


def _searched(equation: Equation) -> list[FittedTerm]:
    """Return the terms that were searched and not given."""
    return [t for t in equation.terms if not t.given]


@dataclass
class Sums:
    """Normal equations of one step from an equation's coefficients and inner constants."""

    gram: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    middle: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    moment: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def add(self, task: Task, equation: Equation, rows: Samples) -> None:
        """Add the rows of a piece."""
        terms = [t.term for t in _searched(equation)]
        if not terms:
            return
        xi = np.array([t.coefficient for t in _searched(equation)])
        problem = task.problem(rows)
        theta = problem.projected(terms)
        slopes = constant_slopes(problem, terms, xi)[:, _loose(terms)]
        jacobian = np.hstack([theta, slopes])
        if not np.all(np.isfinite(jacobian)):
            return
        size = float(np.mean(1.0 / task.rows(rows).error ** 2))
        residual = problem.y - theta @ xi
        count = jacobian.shape[1]
        if not len(self.moment):
            self.gram, self.middle = np.zeros((count, count)), np.zeros((count, count))
            self.moment = np.zeros(count)
        gram = jacobian.T @ jacobian
        self.gram += size * gram
        self.moment += size * (jacobian.T @ residual)
        # the piece's own sandwich, without its bread
        ends = coefficient_ci95(jacobian, residual, np.zeros(count))
        if np.all(np.isfinite(ends)):
            spread = np.diag(((ends[:, 1] - ends[:, 0]) / (2.0 * _NORMAL)) ** 2)
            self.middle += size**2 * (gram @ spread @ gram)

    def estimated(self, equation: Equation) -> Equation:
        """Return the equation after the step, with its intervals."""
        own = _searched(equation)
        terms = [t.term for t in own]
        if not len(self.moment):
            return equation
        scale = np.sqrt(np.maximum(np.diag(self.gram), 1e-300))
        inverse = np.linalg.pinv(self.gram / np.outer(scale, scale), 1e-12, hermitian=True)
        inverse = inverse / np.outer(scale, scale)
        step = inverse @ self.moment
        spread = np.sqrt(np.maximum(np.diag(inverse @ self.middle @ inverse), 0.0))
        places = _loose(terms)
        inner = np.array([c for term in terms for c in constants_of(term)])
        moved = inner.copy()
        moved[places] += step[len(terms) :]
        if not np.all(np.isfinite(step)) or np.any(
            np.abs(moved - inner) > _STEP * np.maximum(np.abs(inner), 1e-6)
        ):
            return equation
        values = iter(moved.tolist())
        out = [
            _fitted(with_constants(t.term, values), t.coefficient + float(change), float(half))
            for t, change, half in zip(own, step, _NORMAL * spread, strict=False)
        ]
        return replace(equation, terms=(*_given(equation), *out))


def _loose(terms: Sequence[Term]) -> list[int]:
    """Return the places of the inner constants that are not whole numbers."""
    inner = [c for term in terms for c in constants_of(term)]
    return [k for k, c in enumerate(inner) if not float(c).is_integer()]


def _given(equation: Equation) -> tuple[FittedTerm, ...]:
    return tuple(t for t in equation.terms if t.given)


def _fitted(term: Term, weight: float, half: float) -> FittedTerm:
    return FittedTerm(term, weight, (weight - half, weight + half))


@dataclass
class Means:
    """Constants of roll-outs, averaged over pieces by what each knows of them."""

    estimates: list[np.ndarray] = field(default_factory=list)
    information: list[np.ndarray] = field(default_factory=list)
    system: System | None = None

    def add(
        self,
        equations: Sequence[Equation],
        known: Mapping[str, Term],
        rows: Samples,
        time: str,
        limit: Budget,
    ) -> None:
        """Fit the constants of the open equations to one piece, all states simulated together."""
        own = {e.state: _searched(e) if is_open(e) else [] for e in equations}
        if not any(own.values()):
            return
        terms = {s: [t.term for t in fitted] for s, fitted in own.items()}
        weights = {s: [t.coefficient for t in fitted] for s, fitted in own.items()}
        shortest = min(len(trace["time"]["t"]) for trace in rows.traces)
        trial = Trial(cut(rows.traces, min(_LENGTH, shortest), _MOST), time, known, limit)
        result = trial.fit(terms, weights, QUICK)
        if result is None:
            return
        self.system, fit = result
        covariance = fit.covariance
        good = np.all(np.isfinite(fit.constants)) and np.all(np.isfinite(covariance))
        if not good or not np.all(np.diag(covariance) > 0.0):
            return
        self.estimates.append(fit.constants)
        self.information.append(np.linalg.pinv(covariance, 1e-12, hermitian=True))

    def estimated(self, equation: Equation) -> Equation:
        """Return the equation with the mean coefficients, and what the pieces tell of them."""
        if self.system is None or len(self.estimates) < 2:
            return equation
        together = np.sum(self.information, axis=0)
        right = np.sum([i @ c for i, c in zip(self.information, self.estimates, strict=True)], 0)
        covariance = np.linalg.pinv(together, 1e-12, hermitian=True)
        mean = covariance @ right
        apart = np.array(self.estimates) - mean
        excess = sum(a @ i @ a for a, i in zip(apart, self.information, strict=True))
        freedom = max((len(apart) - 1) * len(mean), 1)
        half = _NORMAL * np.sqrt(np.maximum(np.diag(covariance), 0.0) * max(excess / freedom, 1.0))
        if not np.all(np.isfinite(mean)):
            return equation
        out = [
            _fitted(term, weight, float(half[place.start]))
            for term, weight, place in self.system.unpacked(mean)[equation.state]
        ]
        return replace(equation, terms=(*_given(equation), *out))
