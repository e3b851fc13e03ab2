"""Co-simulation: an FMU's steps from states that can be set; never imported by the package."""

from __future__ import annotations

from typing import Any

import numpy as np
from fmi_unit import Refused, Unit, number

REMEDY = "Export it for model exchange"
STEPS = 12
"""Of the run with which single steps are compared."""


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
        told = [v.derivative.name for v in self.variables.values() if v.derivative is not None]
        shown = [
            n
            for n, v in self.variables.items()
            if v.causality in ("output", "local") and v.variability in (None, "continuous")
        ]
        self._states = list(dict.fromkeys(told)) or shown
        self.inputs = [n for n, v in self.variables.items() if v.causality == "input"]
        self.count = len(self._states)
        try:
            self._keep_states()
            self.described = super().describe()
            self._check_memory()
        except self.failure as error:
            what = " ".join(str(error).split())[:80]
            raise Refused(f"cannot be stepped by {self.period:g} s: {what}", REMEDY) from None
        if not self.inputs and not self._states:
            raise Refused("has neither inputs nor states", REMEDY)

    def states(self) -> list[str]:
        """Return the states that are set before a step."""
        return self._states

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
        n, m = len(self._states), len(self.inputs)
        x, u, p = row[1 : 1 + n], row[1 + n : 1 + n + m], row[1 + n + m :]
        states = dict(zip(self._states, x, strict=True))
        given = dict(zip(self.parameters, p, strict=True))
        exact = {s: v for s, v in states.items() if self.variables[s].initial == "exact"}
        self.begin(self._kind(), self.about.coSimulation, float(row[0]), {**given, **exact})
        if not np.allclose(self.get(self._states), x, rtol=1e-9, atol=0.0):
            self.put(self._states, x)
        self.put(self.inputs, u)

    def _kind(self) -> Any:
        from fmpy import fmi2, fmi3

        return fmi2.FMU2Slave if self.two else fmi3.FMU3Slave

    def _begun(self) -> np.ndarray:
        """Start anew, and return the row at which it does."""
        self.begin(self._kind(), self.about.coSimulation, 0.0, {})
        values = [*self.get(self._states), *self.get(self.inputs)]
        return np.array([0.0, *values])

    def _keep_states(self) -> None:
        """Leave out what is shown and no state: setting it changes no step."""
        first = self._begun()
        first[1 + self.count :] += 0.7
        own = self.advance(first[None])[0]
        kept = []
        for k, name in enumerate(self._states):
            moved = first.copy()
            moved[1 + k] += 0.1 * abs(moved[1 + k]) + 0.1
            change = np.abs(self.advance(moved[None])[0] - own)
            if np.isfinite(change).all() and change.max() > 1e-9 * (np.abs(own).max() + 1e-300):
                kept.append(name)
        self._states, self.count = kept, len(kept)
        if not kept:
            raise Refused("has no states that can be set", REMEDY)

    def _check_memory(self) -> None:
        """Raise unless single steps from the states of a run are those of the run."""
        rng, h = np.random.default_rng(0), float(self.period or 0.0)
        now, rows, after = self._begun(), [], []
        for _ in range(STEPS):
            inputs = rng.normal(size=len(self.inputs))
            self.put(self.inputs, inputs)
            now[1 + self.count :] = inputs
            rows.append(now)
            self.fmu.doStep(float(now[0]), h)
            after.append(self.get(self._states))
            now = np.array([now[0] + h, *after[-1], *inputs])
        again = self.advance(np.array(rows))
        size = np.abs(after).max() + 1e-300
        if not np.nan_to_num(np.abs(again - after) / size, nan=1.0).max() < 1e-9:
            names = ", ".join(self._states)
            raise Refused(f"has states beside {names} that cannot be set"[:120], REMEDY)
