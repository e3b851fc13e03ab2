"""One equation of motion."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from jaxsr._interval import Interval
from jaxsr._result import StoppedBy
from jaxsr.discovery.choose import Candidate, predict
from jaxsr.discovery.samples import Samples
from jaxsr.expressions import to_sympy, to_text
from jaxsr.expressions.editing import ONE
from jaxsr.expressions.printing import number_text
from jaxsr.expressions.term import Term

if TYPE_CHECKING:
    import sympy
    from jaxtyping import Float

DIGITS = 6
"""Significant digits of numbers without an interval, where they are printed for a reader."""


@dataclass(frozen=True, slots=True)
class FittedTerm:
    """A term of outer coefficient one, its coefficient and 95 % interval.

    ``given`` says that it was known before the search and no fit may move it; an interval may lack
    width for other reasons, such as too few rows.
    """

    term: Term
    coefficient: float
    ci95: tuple[float, float]
    given: bool = False

    @property
    def expression(self) -> str:
        """Return the term in the model grammar."""
        return to_text(self.term)

    @property
    def interval(self) -> Interval:
        """Return the 95 % interval of the coefficient."""
        return Interval(*self.ci95)

    @property
    def shown(self) -> str:
        """Return the coefficient with the digits that its interval justifies, else with six."""
        return self.interval.text(self.coefficient) or number_text(self.coefficient, DIGITS)


@dataclass(frozen=True, slots=True)
class Equation:
    """d(state)/dt = sum of coefficient times term.

    Attributes
    ----------
    train_mse : float
    validation_mse : float or None
        None where no rows were held back.
    held_out_mse : float or None
        Of the rate, in recordings that were opened last.
    held_out_nrmse : float or None
        Of free runs over them.
    front : tuple of Candidate
        What was chosen from, smallest first; empty for a recognised equation.
    pick : int
    exact : bool
        Whether no more is left than errors of the derivative itself.
    noise_mse : float
        Mean square that noise alone would leave in the rows of the front.
    stopped_by : StoppedBy
        Why the search ended or, where they were cut short, the roll-outs.
    """

    state: str
    terms: tuple[FittedTerm, ...]
    train_mse: float
    validation_mse: float | None
    held_out_mse: float | None = None
    held_out_nrmse: float | None = None
    front: tuple[Candidate, ...] = field(default=(), repr=False)
    pick: int = 0
    exact: bool = False
    noise_mse: float = 0.0
    stopped_by: StoppedBy = StoppedBy.CONVERGED

    @property
    def term(self) -> Term:
        """Return the right-hand side."""
        return weighted_sum([t.term for t in self.terms], [t.coefficient for t in self.terms])

    @property
    def expression(self) -> str:
        """Return the right-hand side in the model grammar."""
        return to_text(self.term)

    @property
    def shown(self) -> str:
        """Return the right-hand side for a reader: every number with the digits it deserves."""
        terms = [t.term for t in self.terms]
        weights = [t.coefficient for t in self.terms]
        texts = [t.shown.removeprefix("-") for t in self.terms]
        return to_text(weighted_sum(terms, weights, texts), DIGITS)

    def trimmed(self) -> Equation:
        """Return the equation with what nothing smaller beats on its front, and its pick.

        Candidates whose terms cancel (their error on rows held back is infinite) are left out.
        """
        kept, best = [], np.inf
        for k, candidate in enumerate(self.front):
            if k != self.pick and not np.isfinite(candidate.validation_mse):
                continue
            if candidate.train_mse < best or k == self.pick:
                kept.append(k)
            best = min(best, candidate.train_mse)
        if not kept:
            return self
        front = tuple(self.front[k] for k in kept)
        return replace(self, front=front, pick=kept.index(self.pick))

    def sympy(self) -> sympy.Basic:
        """Return the right-hand side as a SymPy expression."""
        return to_sympy(self.term)

    @property
    def complexity(self) -> int:
        """Return the number of terms."""
        return len(self.terms)

    @property
    def operators(self) -> int:
        """Return the number of operators over all terms."""
        return sum(t.term.operators for t in self.terms)

    def predict(self, samples: Samples) -> Float[np.ndarray, " rows"]:
        """Return the right-hand side on samples (rows,)."""
        terms = [t.term for t in self.terms]
        weights = np.array([t.coefficient for t in self.terms])
        time = next(iter(samples.variables))
        return predict(terms, weights, samples.variables, time=time, group=samples.group)


def cut_short(reasons: Iterable[StoppedBy]) -> StoppedBy | None:
    """Return why work ended early, a wish to stop before a lack of time; None if nothing did."""
    given = set(reasons)
    early = (StoppedBy.INTERRUPTED, StoppedBy.BUDGET)
    return next((reason for reason in early if reason in given), None)


def weighted_sum(
    terms: Sequence[Term], coefficients: Sequence[float], texts: Sequence[str] | None = None
) -> Term:
    """Return coefficient times term, summed, written with as few signs as can be.

    With `texts`, sizes of the coefficients as they shall read, it is a term to be printed alone.
    """

    def part(k: int, c: float) -> Term:
        number = Term.constant(c)
        if texts is not None:
            number = Term.variable(f"-{texts[k]}" if c < 0.0 else texts[k])
        if terms[k] == ONE:
            return number
        return terms[k] if c == 1.0 else Term.apply("mul", number, terms[k])

    values = [float(c) for c in coefficients]
    if not values:
        return Term.constant(0.0)
    total = part(0, values[0])
    for k, c in enumerate(values[1:], start=1):
        total = Term.apply("sub" if c < 0.0 else "add", total, part(k, abs(c)))
    return total


def relative_error(equation: Equation, samples: Samples) -> float:
    """Return the rms of the residual over the rms of the derivative."""
    y = samples.targets[equation.state]
    residual = y - equation.predict(samples)
    scale = float(np.sqrt(np.mean(y**2)))
    return float(np.sqrt(np.mean(residual**2))) / scale if scale > 0.0 else 0.0
