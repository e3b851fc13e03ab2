"""What a discovery hands back, and the files it writes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import jaxsr
from jaxsr._files import atomic_directory, dump_json
from jaxsr.discovery.equation import Equation, weighted_sum
from jaxsr.discovery.samples import Roles, Samples
from jaxsr.expressions import to_text
from jaxsr.models.model import Model
from jaxsr.models.writing import model_text


@dataclass(frozen=True)
class Discovery:
    """Equations of motion found in recordings.

    Attributes
    ----------
    equations : tuple of Equation
        One for each state.
    model : Model
        The same as a model file; its outputs are the states that were recorded.
    provenance : dict
        Seed, seconds, why the search ended, checksums.
    """

    equations: tuple[Equation, ...]
    model: Model
    provenance: Mapping[str, Any]
    samples: Samples = field(repr=False)

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

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of ``discovery.json``."""
        keys = ("complexity", "mse", "expression")
        rows = self.pareto.to_dict("records")
        fronts = {
            e.state: [{k: row[k] for k in keys} for row in rows if row["state"] == e.state]
            for e in self.equations
        }
        return {
            "schema": "jaxsr.discovery/1",
            "equations": [_equation_dict(equation) for equation in self.equations],
            "pareto": fronts,
            "modes": [],
            "switching": {},
            "provenance": {"version": jaxsr.__version__, **self.provenance},
        }

    def save(self, directory: str | Path) -> None:
        """Write ``discovery.json``, ``model.toml``, ``report.html`` and figures, all or none."""
        from jaxsr.discovery.page import write_page

        with atomic_directory(Path(directory)) as folder:
            (folder / "discovery.json").write_text(dump_json(self.to_dict()), encoding="utf-8")
            (folder / "model.toml").write_text(model_text(self.model), encoding="utf-8")
            write_page(self, folder)


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


def found_model(
    equations: Sequence[Equation], part: Roles, time: str | None, units: Mapping[str, str]
) -> Model:
    """Return the equations as a model: every state that has a column is an output."""
    hidden = set(part.rate_of.values())
    recorded = [s for s in part.states if s not in hidden]
    outputs = tuple(f"{s}_meas" for s in recorded)
    columns = dict(zip(outputs, recorded, strict=True))
    if time and time != part.time:
        columns = {part.time: time, **columns}
    names = {part.time, *part.states, *part.inputs}
    own = {k: v for k, v in units.items() if k in names}
    own |= {f"{s}_meas": units[s] for s in recorded if s in units}
    return Model(
        name="discovered",
        states=part.states,
        outputs=outputs,
        equations={e.state: e.expression for e in equations},
        readings=dict(zip(outputs, recorded, strict=True)),
        inputs=part.inputs,
        time=part.time,
        units=own,
        columns=columns,
    )


def relative_error(equation: Equation, samples: Samples) -> float:
    """Return the rms of the residual over the rms of the derivative."""
    y = samples.targets[equation.state]
    residual = y - equation.predict(samples)
    scale = float(np.sqrt(np.mean(y**2)))
    return float(np.sqrt(np.mean(residual**2))) / scale if scale > 0.0 else 0.0
