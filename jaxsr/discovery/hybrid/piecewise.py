"""Modes as one right-hand side: a Piecewise over guards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from jaxsr.discovery.equation import Equation, FittedTerm
from jaxsr.expressions import to_text
from jaxsr.expressions.term import Term


@dataclass(frozen=True)
class Mode:
    """One way in which a system moves.

    Attributes
    ----------
    guard : Term
        Condition on states, inputs and time under which it holds.
    equations : tuple of Equation
        One for each state.
    """

    guard: Term
    equations: tuple[Equation, ...]

    def __getitem__(self, state: str) -> Equation:
        """Return the equation of a state."""
        return next(e for e in self.equations if e.state == state)

    def __str__(self) -> str:
        """Return the guard in the model grammar."""
        return to_text(self.guard)


def piecewise_term(modes: Sequence[Mode], state: str) -> Term:
    """Return a state's right-hand side over all modes; the last one holds where no other does.

    A state that has the same law in every mode keeps it as it is.
    """
    laws = [mode[state].term for mode in modes]
    if all(law == laws[0] for law in laws):
        return laws[0]
    branches: list[Term] = []
    for law, mode in zip(laws[:-1], modes[:-1], strict=True):
        branches += [law, mode.guard]
    return Term.apply("piecewise", *branches, laws[-1], Term.boolean(True))


def piecewise_equation(modes: Sequence[Mode], state: str, mses: tuple[float, float]) -> Equation:
    """Return the equation of a state over all modes, with its mean squares.

    Where modes differ it has one term, of coefficient one by definition; coefficients and
    intervals are those of the modes.
    """
    term = piecewise_term(modes, state)
    whole = (FittedTerm(term, 1.0, (1.0, 1.0)),)
    return Equation(state, whole, *mses)
