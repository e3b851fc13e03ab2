"""What every result with a model can be turned into."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, overload

from jaxsr._result import InputError

if TYPE_CHECKING:
    from jaxsr.models.exports.functions import Rates
    from jaxsr.models.model import Model

Language = Literal["c", "matlab", "modelica", "numpy", "jax", "sympy", "latex"]
"""Programs that take a text."""


class Exported:
    """Forms of a model: functions, formulas, and source for other programs."""

    model: Model

    @overload
    def sympy(self) -> dict[str, Any]: ...

    @overload
    def sympy(self, state: str) -> Any: ...

    def sympy(self, state: str | None = None) -> Any:
        """Return the rate of a state, or of every state by name, as SymPy expressions.

        Symbols are real. Parameters of the model stay symbols; a mass matrix is solved.

        Parameters
        ----------
        state : str, optional

        Raises
        ------
        InputError
            There is no such state.
        """
        from jaxsr.expressions import to_sympy
        from jaxsr.models.exports.system import system_of

        if state is not None:
            return self._rate(state)
        return {state: to_sympy(term) for state, term in system_of(self.model).rates.items()}

    def latex(self, state: str | None = None, digits: int = 4) -> str:
        """Return the rate of a state in LaTeX, or the whole model as an ``align*``.

        Parameters
        ----------
        state : str, optional
            Without it, equations of motion (a mass matrix on the left) and readings.
        digits : int
            Significant digits of numbers.

        Raises
        ------
        InputError
            There is no such state.
        """
        from jaxsr.models.exports.latex import model_latex, rounded_latex
        from jaxsr.models.exports.system import system_of

        if state is not None:
            return rounded_latex(self._rate(state), digits)
        return model_latex(system_of(self.model), digits)

    def _rate(self, state: str) -> Any:
        """Return the rate of a state in SymPy."""
        from jaxsr.expressions import to_sympy
        from jaxsr.models.exports.system import system_of

        rates = system_of(self.model).rates
        if state not in rates:
            remedy = f"There are {', '.join(rates)}"
            raise InputError(f"no state {state!r:.80}", self.model.name, remedy)
        return to_sympy(rates[state])

    def to_numpy(self) -> Rates:
        """Return the rates as a NumPy function ``f(t, x, u=(), p=None) -> dx``.

        States x and inputs u stand in the order of the model, each entry a number or an array of
        samples, so that f is a right-hand side for ``scipy.integrate.solve_ivp``; p replaces
        parameters by name. Steps, such as that of ``sign``, are exact. ``f(values)`` takes named
        arrays instead and returns the rates by state.
        """
        from jaxsr.models.exports.functions import numpy_function
        from jaxsr.models.exports.system import system_of

        return numpy_function(system_of(self.model))

    def to_jax(self) -> Rates:
        """Return the rates as a JAX function, of the two forms of `to_numpy`."""
        from jaxsr.models.exports.functions import jax_function
        from jaxsr.models.exports.system import system_of

        return jax_function(system_of(self.model))

    @overload
    def export(self, to: Language, name: str | None = None) -> str: ...

    @overload
    def export(self, to: Literal["fmu"], name: str | None = None) -> bytes: ...

    def export(self, to: str, name: str | None = None) -> str | bytes:
        """Return the model as source for another program, or as the file of an FMU.

        Parameters
        ----------
        to : {"c", "matlab", "modelica", "numpy", "jax", "sympy", "latex", "fmu"}
        name : str, optional
            Of the function or class; from the model's name by default.

        Raises
        ------
        InputError
            The language is none of these, a formula is missing, or for an FMU pythonfmu is.
        """
        from jaxsr.models.exports.texts import export_fmu, export_text

        if to == "fmu":
            return export_fmu(self.model, name)
        return export_text(self.model, to, name)
