"""What a Python vector field says about a model: rates as terms, and where forces enter them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from jaxsr.expressions import Term
from jaxsr.expressions.derivative import built, derivative
from jaxsr.models.force_columns import Entry, Rows
from jaxsr.models.jaxpr import LinearSystem


@dataclass(frozen=True, eq=False)
class VectorField:
    """What a Python function says about a model.

    Attributes
    ----------
    rates : mapping
        State to its rate, in the symbols of the model.
    gains : mapping
        Symbol ``STATE_per_INPUT`` to the derivative of a rate by an input.
    inputs : mapping
        Input that enters linearly to the rates that it adds to.
    columns : mapping
        State to what a force along it adds to the rates.
    solved : tuple of SolvedRates
        Rates that the function takes from a linear system.
    """

    rates: Mapping[str, Term]
    gains: Mapping[str, Term] = field(default_factory=dict)
    inputs: Mapping[str, Rows] = field(default_factory=dict)
    columns: Mapping[str, Entry] = field(default_factory=dict)
    solved: tuple[SolvedRates, ...] = ()

    def forced(self, forces: Mapping[str, Term], factor: Callable[[str], Term]) -> dict[str, Term]:
        """Return the rates with forces along states added.

        Parameters
        ----------
        forces : mapping
            By state.
        factor : callable
            Text of a factor to its term.
        """
        rates, rest = dict(self.rates), dict(forces)
        for system in self.solved:
            own = {s: f for s, f in rest.items() if s in system.loads}
            if own:
                rates |= system.loaded(own)
                rest = {s: f for s, f in rest.items() if s not in own}
        for state, force in rest.items():
            rows = self.columns[state].rows if state in self.columns else ((state, ""),)
            for row, text in rows:
                added = built("mul", factor(text), force) if text else force
                rates[row] = built("add", rates[row], added)
        return rates


@dataclass(frozen=True, eq=False)
class SolvedRates:
    """Rates that a function takes from a linear system, M a = F: a force is best added to F.

    Attributes
    ----------
    states : tuple of str
        Those whose rates are the solution.
    loads : mapping
        State along which a force acts to what the force is multiplied by in each row.
    """

    states: tuple[str, ...]
    system: LinearSystem
    loads: Mapping[str, tuple[Term, ...]]

    @staticmethod
    def of(
        system: LinearSystem, rates: Mapping[str, Term], columns: Mapping[str, Entry]
    ) -> SolvedRates | None:
        """Return the rates that a system's solution is, None where it is something else."""
        owner = {rate: state for state, rate in rates.items()}
        states = tuple(owner.get(a, "") for a in system.solution)
        if "" in states or len(set(states)) < len(states):
            return None
        loads = {}
        for state, entry in columns.items():
            if entry.beside is None or not {s for s, _ in entry.rows} <= set(states):
                continue
            if any(entry.beside in m.variables for m in system.matrix.flat):
                continue
            loads[state] = tuple(derivative(f, entry.beside) for f in system.right)
        return SolvedRates(states, system, loads)

    def loaded(self, forces: Mapping[str, Term]) -> dict[str, Term]:
        """Return the rates with forces along states added."""
        right = list(self.system.right)
        for state, force in forces.items():
            for i, load in enumerate(self.loads[state]):
                right[i] = built("add", right[i], built("mul", load, force))
        return dict(zip(self.states, self.system.solved(right), strict=True))
