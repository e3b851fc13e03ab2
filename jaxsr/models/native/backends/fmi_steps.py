"""Co-simulation: an FMU's steps from states that can be set; never imported by the package."""

from __future__ import annotations

from typing import Any

import numpy as np
from fmi_unit import Refused, Unit, number


class Stepped(Unit):
    """Co-simulation: steps of one length, from states that can be set.

    A step from any states is what a unit does that is reset, given those states as start values,
    and stepped once. It must have no memory beside them: `_check_memory` compares with a run.
    """

    def __init__(self, about: Any, folder: str, step: float | None) -> None:
        super().__init__(about, folder)
        default = about.defaultExperiment
        own = number(default.stepSize) if default is not None else None
        self.period = step or own
        if not self.period:
            raise Refused("does not say its step", "Write sample_time under [model] of the sidecar")
        self._states = self.states()
        self.count = len(self._states)
        self.described = super().describe()
        self._check_memory()

    def states(self) -> list[str]:
        """Return the states: those whose derivative there is, else what is shown and may be set."""
        told = [v.derivative.name for v in self.variables.values() if v.derivative is not None]
        if told:
            return list(dict.fromkeys(told))
        shown = [
            n
            for n, v in self.variables.items()
            if v.causality in ("output", "local")
            and v.variability in (None, "continuous")
            and v.initial != "calculated"
        ]
        return shown

    def describe(self) -> dict[str, Any]:
        """Say what there is."""
        return {**self.described, "step": self.period}

    def advance(self, rows: np.ndarray) -> np.ndarray:
        """Return the states a step later, shape (rows, states)."""
        n = len(self._states)
        found = np.full((len(rows), n), np.nan)
        for row, result in zip(rows, found, strict=True):
            if not np.isfinite(row).all():
                continue
            try:
                self._enter(row)
                self.fmu.doStep(float(row[0]), self.period)
                result[:] = self.get(self._states)
            except self.failure:
                self.fmu = None
        return found

    def _enter(self, row: np.ndarray) -> None:
        from fmpy import fmi2, fmi3

        n, m = len(self._states), len(self.inputs)
        x, u, p = row[1 : 1 + n], row[1 + n : 1 + n + m], row[1 + n + m :]
        states = dict(zip(self._states, x, strict=True))
        given = dict(zip(self.parameters, p, strict=True))
        exact = {s: v for s, v in states.items() if self.variables[s].initial is not None}
        kind = fmi2.FMU2Slave if self.two else fmi3.FMU3Slave
        own = self.about.coSimulation
        self.begin(kind, own, float(row[0]), {**given, **exact})
        if not np.allclose(self.get(self._states), x, rtol=1e-9, atol=0.0):
            self.put(self._states, x)
        self.put(self.inputs, u)

    def _check_memory(self) -> None:
        remedy = "Export it for model exchange"
        if not self._states:
            raise Refused("has no states that can be set", remedy)
        told = self.described
        self.inputs = [v["name"] for v in told["inputs"]]
        self.parameters = []
        rng, time, h = np.random.default_rng(0), 0.0, float(self.period or 0.0)
        start = [v["start"] or 0.0 for v in told["states"]]
        first = np.array([time, *start, *rng.normal(size=len(self.inputs))])
        rows, after = [first], []
        try:
            self._enter(first)
            for _ in range(12):
                self.fmu.doStep(time, h)
                time += h
                after.append(self.get(self._states))
                inputs = rng.normal(size=len(self.inputs))
                self.put(self.inputs, inputs)
                rows.append(np.array([time, *after[-1], *inputs]))
        except Exception as error:
            what = " ".join(str(error).split())[:80]
            raise Refused(f"cannot be stepped by {h:g} s: {what}", remedy) from None
        again = self.advance(np.array(rows[:-1]))
        size = np.abs(after).max() + 1e-300
        if not np.nan_to_num(np.abs(again - after) / size, nan=1.0).max() < 1e-9:
            names = ", ".join(self._states)
            raise Refused(f"has states beside {names} that cannot be set"[:120], remedy)
