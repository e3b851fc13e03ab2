"""What a discovery hands back, and the files it writes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd  # pyright: ignore[reportMissingTypeStubs]

from jaxsr._files import atomic_directory, atomic_write_text, dump_json
from jaxsr._progress import Budget
from jaxsr._result import InputError
from jaxsr._versions import environment, own_version
from jaxsr.discovery.equation import Equation, weighted_sum
from jaxsr.discovery.forms import EquationForms, equation_of
from jaxsr.discovery.fronts import front_table
from jaxsr.discovery.hybrid import Hybrid, Mode, RareMode
from jaxsr.discovery.samples import Samples
from jaxsr.discovery.verdict import OUT_OF_TIME, SEVERAL, UNDECIDED, Verdict
from jaxsr.expressions import Term, to_text
from jaxsr.models.model import Model
from jaxsr.models.writing import model_text
from jaxsr.recordings import DataCheck
from jaxsr.report.evidence import ModelRun

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from jaxsr.discovery.plots import Fitted

_SAID = ("time_unit", "wrap", "reading")  # checks that a terminal shows too


@dataclass(frozen=True, repr=False)
class Discovery(EquationForms):
    """Equations of motion found in recordings.

    Attributes
    ----------
    equations : tuple of Equation
        One for each state.
    model : Model
        The same as a model file; its outputs are the states that were recorded.
    provenance : dict
        Seed, seconds, why the search ended, checksums.
    hybrid : Hybrid or None
        Modes, guards and switching, where the system has several modes.
    rare : RareMode or None
        Where few samples follow another law than all others, and too few to tell it.
    columns : dict of str to str
        Symbol to column, where a column's name could not stand in an expression.
    judgement : Verdict
        Whether it is a law, by free runs of the model over data held back.
    data_checks : tuple of DataCheck
        What is to be said of the recordings.
    held_out_runs : tuple of ModelRun
        Free runs of the model over recordings held out.
    """

    equations: tuple[Equation, ...]
    model: Model
    provenance: Mapping[str, Any]
    samples: Samples = field(repr=False)
    hybrid: Hybrid | None = field(default=None, repr=False)
    rare: RareMode | None = None
    columns: Mapping[str, str] = field(default_factory=dict[str, str])
    judgement: Verdict = field(default_factory=lambda: Verdict(UNDECIDED, OUT_OF_TIME))
    data_checks: tuple[DataCheck, ...] = field(default=(), repr=False)
    held_out_runs: tuple[ModelRun, ...] = field(default=(), repr=False)

    @property
    def verdict(self) -> str:
        """Return "law", "several" or "undecided"."""
        return self.judgement.verdict

    @property
    def reason(self) -> str:
        """Return why no law is claimed, or the experiment that would split several."""
        return self.judgement.reason

    @property
    def free_run_nrmse(self) -> float | None:
        """Return the error of the model's free runs over data held back."""
        return self.judgement.free_run_nrmse

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Return the modes, the most frequent first; none where one law holds throughout."""
        return self.hybrid.modes if self.hybrid is not None else ()

    @property
    def pareto(self) -> pd.DataFrame:
        """Return every candidate of every front: state, complexity, errors, expression, pick."""
        rows = [
            {
                "state": equation.state,
                "complexity": len(c.fit.terms),
                "operators": sum(t.operators for t in c.fit.terms),
                "mse": c.train_mse,
                "validation_mse": c.validation_mse,
                "expression": to_text(weighted_sum(c.fit.terms, list(c.fit.coefficients)), 6),
                "picked": k == equation.pick,
            }
            for equation in self.equations
            for k, c in enumerate(equation.front)
        ]
        names = ["state", "complexity", "operators", "mse", "validation_mse"]
        return pd.DataFrame(rows, columns=[*names, "expression", "picked"])

    def __str__(self) -> str:
        """Return the equations, one a line, coefficients as their intervals justify."""
        return "\n".join(f"d({e.state})/dt = {e.shown}" for e in self.equations)

    def summary(self) -> str:
        """Return the verdict and the equations in words, for a terminal."""
        judged = self.judgement
        told = [f"{symbol} is column {column}" for symbol, column in self.columns.items()]
        told += [f"{c.file}: {c.message}" for c in self.data_checks if c.check in _SAID]
        error = "" if judged.free_run_nrmse is None else f"NRMSE {judged.free_run_nrmse:.2g}"
        if judged.verdict == UNDECIDED:
            told += [f"Undecided: {judged.reason}.", "The best that was found, not a law:"]
        elif judged.verdict == SEVERAL:
            others = len(judged.alternatives)
            split = f"{judged.reason[:1].upper()}{judged.reason[1:]}"
            told.append(f"Several laws fit: {others} beside this one. {split}.")
        told.append(str(self))
        for place, other in enumerate(judged.alternatives):
            lines = "; ".join(
                f"d({e.state})/dt = {e.shown}"
                for e, own in zip(other.equations, self.equations, strict=True)
                if e is not own
            )
            told.append(f"or ({place + 1}): {lines}")
        claim = f"Verdict: {judged.verdict}"
        told.append(f"{claim}. Free run over data held back: {error}" if error else claim)
        return "\n".join(told)

    def __repr__(self) -> str:
        """Return verdict and states in a line."""
        return f"<Discovery {self.verdict}: rates of {', '.join(e.state for e in self.equations)}>"

    def _repr_html_(self) -> str:
        """Return verdict and equations as a card, for notebooks."""
        from jaxsr.report.card import discovery_card

        return discovery_card(self.to_dict())

    def __getitem__(self, state: str) -> Equation:
        """Return the equation of a state."""
        return equation_of(self.equations, state)

    @property
    def terms_by_state(self) -> dict[str, Term]:
        """Return the right-hand side of every state's equation."""
        return {equation.state: equation.term for equation in self.equations}

    def plot_front(self, state: str, ax: Axes | None = None) -> Axes:
        """Plot the candidates of a state: error over size, the pick ringed."""
        from jaxsr.discovery import plots

        ax = plots.plot_front(front_table(self[state]), ax)
        ax.set(title=f"rate of {state}")
        return ax

    def plot_fit(self, state: str, ax: Axes | None = None, *, recording: int = 0) -> Axes:
        """Plot the derivative of a state in one recording, and what its equation gives."""
        from jaxsr.discovery import plots

        return plots.plot_fit(self._fitted(state, recording), ax)

    def plot_residual(self, state: str, ax: Axes | None = None, *, recording: int = 0) -> Axes:
        """Plot what the equation of a state leaves in one recording."""
        from jaxsr.discovery import plots

        return plots.plot_residual(self._fitted(state, recording), ax)

    def _fitted(self, state: str, recording: int) -> Fitted:
        """Return a state's derivative in one recording beside what its equation gives."""
        from jaxsr.discovery.plots import Fitted

        equation = self[state]
        rows = np.flatnonzero(self.samples.group == recording)
        if not len(rows):
            raise InputError(f"there is no recording {recording}", "recording", "Count from 0.")
        part = self.samples.take(rows)
        time = part.variables[next(iter(part.variables))]
        target = part.targets[state]
        return Fitted(target, equation.predict(part), time, f"rate of {state}")

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of ``discovery.json``."""
        keys = ("complexity", "mse", "expression")
        table: Any = self.pareto
        rows: list[dict[str, Any]] = table.to_dict("records")
        fronts = {
            e.state: [{k: row[k] for k in keys} for row in rows if row["state"] == e.state]
            for e in self.equations
        }
        return {
            "schema": "jaxsr.discovery/1",
            "equations": _equation_dicts(self.equations, self.judgement.by_state),
            "verdict": self.verdict,
            "reason": self.reason,
            "free_run_nrmse": self.free_run_nrmse,
            "description_length": self.judgement.description_length,
            "alternatives": [
                _equation_dicts(other.equations, other.by_state)
                for other in self.judgement.alternatives
            ],
            "pareto": fronts,
            "data_checks": [
                {"file": c.file, "channel": c.channel, "check": c.check, "message": c.message}
                for c in self.data_checks
            ],
            **({"columns": dict(self.columns)} if self.columns else {}),
            **self._hybrid_dict(),
            **self._reset_dict(),
            "provenance": {"version": own_version(), **environment(), **self.provenance},
        }

    def _hybrid_dict(self) -> dict[str, Any]:
        """Return modes, and for each recording rows [from, to, mode]; empty with one mode."""
        if self.hybrid is None:
            return {"modes": [], "switching": {}, **self._rare_dict()}
        modes = [
            {
                "guard": str(mode),
                "equations": [_equation_dict(e) for e in mode.equations],
                "dwell_s": self.hybrid.dwell(number),
            }
            for number, mode in enumerate(self.modes)
        ]
        rows = {n: [list(row) for row in part] for n, part in self.hybrid.switching.items()}
        single = [_equation_dict(e) for e in self.hybrid.one_law]
        return {"modes": modes, "switching": rows, "one_law": single}

    def _rare_dict(self) -> dict[str, Any]:
        """Return where a mode too rare to tell was met, if one was."""
        if self.rare is None:
            return {}
        row = {"guard": str(self.rare.guard), "samples": self.rare.samples, "of": self.rare.of}
        return {"rare_mode": {**row, "sentence": str(self.rare)}}

    def _reset_dict(self) -> dict[str, Any]:
        """Return the jumps of states, as the model file has them, where there are any."""
        rows = [
            {"when": e.when, "direction": e.direction, "reset": dict(e.reset)}
            for e in self.model.events
        ]
        return {"resets": rows} if rows else {}

    def save(self, directory: str | Path, budget: Budget | None = None) -> None:
        """Write ``discovery.json``, ``model.toml``, ``report.html`` and figures, all or none.

        Parameters
        ----------
        directory : path
        budget : Budget, optional
            Figures are drawn as long as it lasts.
        """
        with atomic_directory(Path(directory)) as folder:
            self.write(folder, budget)

    def write(
        self, folder: Path, budget: Budget | None = None, *, more: Mapping[str, str] | None = None
    ) -> None:
        """Write the files of `save`, and texts by name, into a folder: each whole, report last."""
        from jaxsr.discovery.page import write_page

        atomic_write_text(folder / "discovery.json", dump_json(self.to_dict()))
        atomic_write_text(folder / "model.toml", model_text(self.model))
        for name, text in (more or {}).items():
            atomic_write_text(folder / name, text)
        write_page(self, folder, budget)


def _equation_dicts(
    equations: Sequence[Equation], free_runs: Mapping[str, float]
) -> list[dict[str, Any]]:
    """Return equations with the errors of their free runs, null for what has no sensor."""
    return [
        {
            **_equation_dict(e),
            "free_run_nrmse": free_runs.get(e.state),
            "held_out_free_run_nrmse": e.held_out_nrmse,
        }
        for e in equations
    ]


def _equation_dict(equation: Equation) -> dict[str, Any]:
    return {
        "state": equation.state,
        "expression": equation.expression,
        "terms": [
            {"expression": t.expression, "coefficient": t.coefficient, "ci95": list(t.ci95)}
            for t in equation.terms
        ],
        "train_mse": equation.train_mse,
        "validation_mse": equation.validation_mse,
        "held_out_mse": equation.held_out_mse,
        "complexity": equation.complexity,
        "operators": equation.operators,
    }
