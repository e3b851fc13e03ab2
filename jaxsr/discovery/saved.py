"""A discovery read back from its folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from jaxsr._interval import Interval
from jaxsr.discovery.forms import EquationForms, equation_of
from jaxsr.expressions import Term, parse, to_sympy
from jaxsr.models import Model
from jaxsr.recordings.data_check import DataCheck


class _Expressed(dict[str, Any]):
    """A row of ``discovery.json`` that holds an expression."""

    @property
    def expression(self) -> str:
        """Return the term, or the right-hand side, in the model grammar."""
        return str(self["expression"])

    @property
    def term(self) -> Term:
        """Return the term, of outer coefficient one, or the right-hand side."""
        return parse(self.expression)


class SavedTerm(_Expressed):
    """A term as ``discovery.json`` has it, with the attributes of `FittedTerm`."""

    @property
    def coefficient(self) -> float:
        """Return its coefficient."""
        return float(self["coefficient"])

    @property
    def ci95(self) -> tuple[float, float]:
        """Return the 95 % interval of the coefficient, NaN where it was not told."""
        low, high = (float("nan") if end is None else float(end) for end in self["ci95"])
        return low, high

    @property
    def interval(self) -> Interval:
        """Return the 95 % interval of the coefficient."""
        return Interval(*self.ci95)


class SavedEquation(_Expressed):
    """An equation as ``discovery.json`` has it, with the attributes of `Equation`."""

    @property
    def state(self) -> str:
        """Return the state whose rate it gives."""
        return str(self["state"])

    @property
    def terms(self) -> tuple[SavedTerm, ...]:
        """Return the terms, each with its coefficient and interval."""
        return tuple(SavedTerm(row) for row in self["terms"])

    @property
    def train_mse(self) -> float | None:
        """Return the mean square of the residual of the rate."""
        return self.get("train_mse")

    @property
    def validation_mse(self) -> float | None:
        """Return the same on rows held back; None where there were none."""
        return self.get("validation_mse")

    @property
    def held_out_mse(self) -> float | None:
        """Return the same in recordings that were opened last."""
        return self.get("held_out_mse")

    @property
    def held_out_nrmse(self) -> float | None:
        """Return the error of free runs over them."""
        return self.get("held_out_free_run_nrmse")

    @property
    def complexity(self) -> int:
        """Return the number of terms."""
        return int(self["complexity"])

    @property
    def operators(self) -> int:
        """Return the number of operators over all terms."""
        return int(self["operators"])

    def sympy(self) -> Any:
        """Return the right-hand side as a SymPy expression."""
        return to_sympy(self.term)


@dataclass(frozen=True, eq=False, repr=False)
class SavedDiscovery(EquationForms):
    """A discovery as its folder holds it; it answers the calls of `Discovery` but for plots.

    Attributes
    ----------
    directory : Path
    document : dict
        All of ``discovery.json``.
    model : Model
        The equations found, ``model.toml``.
    """

    directory: Path
    document: Mapping[str, Any]
    model: Model

    @property
    def verdict(self) -> str:
        """The verdict: law, several or undecided."""
        return str(self.document["verdict"])

    @property
    def reason(self) -> str:
        """Why no law is claimed, or the experiment that would split several; else empty."""
        return str(self.document["reason"])

    @property
    def free_run_nrmse(self) -> float | None:
        """The error of the model's free runs over data held back."""
        return self.document.get("free_run_nrmse")

    @property
    def equations(self) -> list[SavedEquation]:
        """The equations, one for each state; each is also its row of ``discovery.json``."""
        return [SavedEquation(row) for row in self.document["equations"]]

    @property
    def pareto(self) -> pd.DataFrame:
        """Every candidate of every front: state, complexity, mse, expression."""
        fronts: Mapping[str, list[dict[str, Any]]] = self.document.get("pareto") or {}
        rows = [{"state": state, **row} for state, front in fronts.items() for row in front]
        return pd.DataFrame(rows, columns=["state", "complexity", "mse", "expression"])

    @property
    def columns(self) -> dict[str, str]:
        """Symbol to column, where a column's name could not stand in an expression."""
        return dict(self.document.get("columns") or {})

    @property
    def data_checks(self) -> tuple[DataCheck, ...]:
        """What is to be said of the recordings."""
        return tuple(DataCheck(**row) for row in self.document.get("data_checks") or ())

    @property
    def provenance(self) -> dict[str, Any]:
        """Seed, seconds, why the search ended, checksums."""
        return dict(self.document.get("provenance") or {})

    @property
    def terms_by_state(self) -> dict[str, Term]:
        """The right-hand side of every state's equation."""
        return {equation.state: equation.term for equation in self.equations}

    def __getitem__(self, state: str) -> SavedEquation:
        """Return the equation of a state."""
        return equation_of(self.equations, state)

    def to_dict(self) -> dict[str, Any]:
        """Return what ``discovery.json`` holds."""
        return dict(self.document)

    def __repr__(self) -> str:
        """Return verdict and states in a line."""
        states = ", ".join(equation.state for equation in self.equations)
        return f"<SavedDiscovery {self.verdict}: rates of {states}>"

    def __str__(self) -> str:
        """Return the equations, one a line, as they were written."""
        return "\n".join(f"d({e.state})/dt = {e.expression}" for e in self.equations)

    def _repr_html_(self) -> str:
        """Return the card of the report, for notebooks."""
        from jaxsr.report.card import discovery_card

        return discovery_card(self.document)
