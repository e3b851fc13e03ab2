"""Forms of equations found, those of a search and those read back alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from jaxsr._result import InputError
from jaxsr.expressions import Term, to_jax, to_numpy, to_sympy
from jaxsr.models.exports.exported import Exported
from jaxsr.models.simulator import Simulator

if TYPE_CHECKING:
    from jaxsr.models.exports.functions import Rates


class Law(Protocol):
    """The equation of a state, as the forms need it."""

    @property
    def state(self) -> str: ...

    @property
    def term(self) -> Term: ...


AnyLaw = TypeVar("AnyLaw", bound=Law)


def equation_of(equations: Sequence[AnyLaw], state: str) -> AnyLaw:
    """Return the equation of a state.

    Raises
    ------
    InputError
        There is none.
    """
    for equation in equations:
        if equation.state == state:
            return equation
    known = ", ".join(equation.state for equation in equations)
    raise InputError(f"no equation of {state!r}", "", f"There are those of {known}.")


class EquationForms(Exported):
    """Equations found as formulas, functions and a simulator."""

    @property
    def terms_by_state(self) -> dict[str, Term]:
        """Return the right-hand side of every state's equation."""
        raise NotImplementedError

    @property
    def simulator(self) -> Simulator:
        """The equations found, to be run: ``found.simulator.simulate(recording)``."""
        return Simulator(self.model)

    def to_numpy(self) -> Rates:
        """Return the rates as a NumPy function of two forms.

        ``f(values)`` takes named arrays (time, states, inputs) and returns the states' rates by
        name; ``f(t, x, u=())`` is that of `Simulator.to_numpy`.
        """
        from jaxsr.models.exports.functions import numpy_function
        from jaxsr.models.exports.system import system_of

        functions = {state: to_numpy(term) for state, term in self.terms_by_state.items()}

        def named(values: Mapping[str, Any]) -> dict[str, Any]:
            return {state: f(values) for state, f in functions.items()}

        return numpy_function(system_of(self.model), named)

    def to_jax(self) -> Rates:
        """Return the rates as a JAX function, of the two forms of `to_numpy`."""
        from jaxsr.models.exports.functions import jax_function
        from jaxsr.models.exports.system import system_of

        terms = self.terms_by_state
        function = to_jax(list(terms.values()))

        def named(values: Mapping[str, Any]) -> dict[str, Any]:
            return dict(zip(terms, function(values), strict=True))

        return jax_function(system_of(self.model), named)

    def _rate(self, state: str) -> Any:
        terms = self.terms_by_state
        if state not in terms:
            remedy = f"There are those of {', '.join(terms)}."
            raise InputError(f"no equation of {state!r}", "", remedy)
        return to_sympy(terms[state])
