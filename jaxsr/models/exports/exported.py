"""What every result with a model can be turned into."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from jaxsr.models.exports.functions import Rates
    from jaxsr.models.model import Model

Language = Literal["c", "matlab", "modelica", "numpy", "jax", "sympy", "latex"]


class Exported:
    """Forms of a model: functions, formulas, and source for other programs."""

    model: Model

    def sympy(self) -> dict[str, Any]:
        """Return the rate of every state as a SymPy expression of real symbols.

        Parameters of the model stay symbols; a mass matrix is solved.
        """
        from jaxsr.expressions import to_sympy
        from jaxsr.models.exports.system import system_of

        return {state: to_sympy(term) for state, term in system_of(self.model).rates.items()}

    def latex(self) -> str:
        """Return the equations of motion and the readings in LaTeX, an ``align*``."""
        return self.export("latex")

    def to_numpy(self) -> Rates:
        """Return the rates as a NumPy function ``f(t, x, u=(), p=None) -> dx``.

        States x and inputs u stand in the order of the model, each entry a number or an array of
        samples, so that f is a right-hand side for ``scipy.integrate.solve_ivp``; p replaces
        parameters by name. Steps, such as that of ``sign``, are exact.
        """
        from jaxsr.models.exports.functions import numpy_function
        from jaxsr.models.exports.system import system_of

        return numpy_function(system_of(self.model))

    def to_jax(self) -> Rates:
        """Return the rates as a JAX function ``f(t, x, u=(), p=None) -> dx``, see `to_numpy`."""
        from jaxsr.models.exports.functions import jax_function
        from jaxsr.models.exports.system import system_of

        return jax_function(system_of(self.model))

    def export(self, to: Language, name: str | None = None) -> str:
        """Return the model as source for another program.

        Parameters
        ----------
        to : {"c", "matlab", "modelica", "numpy", "jax", "sympy", "latex"}
        name : str, optional
            Of the function or class; from the model's name by default.

        Raises
        ------
        InputError
            The language is none of these, or a formula is missing.
        """
        from jaxsr.models.exports.texts import export_text

        return export_text(self.model, to, name)
