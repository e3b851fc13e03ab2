"""What every Functional Mock-up Unit has, by FMPy; never imported by the package.

Sources: FMI 2.0.4 (section 3.2, the calling sequence of model exchange) and FMI 3.0.1.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np


class Refused(Exception):
    """What is wrong with the FMU, and the remedy."""

    def __init__(self, what: str, remedy: str = "") -> None:
        super().__init__(what)
        self.what, self.remedy = what, remedy


def real(variable: Any) -> bool:
    return variable.type in ("Real", "Float64") and not variable.dimensions


def number(text: Any) -> float | None:
    try:
        return float(text)
    except (TypeError, ValueError):
        return None


def _unit(variable: Any) -> str:
    own = variable.unit
    if own is None and variable.declaredType is not None:
        own = variable.declaredType.unit
    return own or ""


def _limit(variable: Any, key: str) -> float | None:
    own = getattr(variable, key, None)
    if own is None and variable.declaredType is not None:
        own = getattr(variable.declaredType, key, None)
    return number(own)


class Unit:
    """What model exchange and co-simulation have in common."""

    def __init__(self, about: Any, folder: str) -> None:
        from fmpy.fmi1 import FMICallException

        self.failure = FMICallException
        self.about, self.folder = about, folder
        self.two = about.fmiMajorVersion == 2
        self.variables = {v.name: v for v in about.modelVariables if real(v)}
        self.fmu: Any = None
        self.parameters: list[str] = []
        self.inputs: list[str] = []
        self.outputs: list[str] = []
        self.set_to: tuple[float, ...] | None = None

    def states(self) -> list[str]:
        """Return the names of the continuous states."""
        raise NotImplementedError

    def describe(self) -> dict[str, Any]:
        """Say what there is."""
        states = self.states()
        told = {v.name: self._told(v) for v in self.variables.values()}
        rates = {
            v.name: v.derivative.name
            for v in self.variables.values()
            if v.derivative is not None and v.name in states
        }

        def named(causality: str) -> list[dict[str, Any]]:
            return [told[n] for n, v in self.variables.items() if v.causality == causality]

        chosen = [p for p in named("parameter") if p["variability"] in ("fixed", "tunable")]
        return {
            "name": self.about.modelName or "fmu",
            "fmi": self.about.fmiVersion,
            "states": [told[s] for s in states],
            "rates": rates,
            "inputs": named("input"),
            "outputs": named("output"),
            "parameters": chosen,
            "kind": type(self).__name__,
        }

    def _told(self, v: Any) -> dict[str, Any]:
        return {
            "name": v.name,
            "unit": _unit(v),
            "start": number(v.start),
            "min": _limit(v, "min"),
            "max": _limit(v, "max"),
            "variability": v.variability,
            "initial": v.initial,
        }

    def choose(self, chosen: dict[str, Any]) -> None:
        """Say which variables stand in the rows."""
        self.inputs, self.outputs = chosen["inputs"], chosen["outputs"]
        self.parameters = chosen["parameters"]
        self.set_to = None

    def exact(self, rows: np.ndarray, columns: list[int]) -> dict[int, np.ndarray]:
        """Return no derivatives."""
        return {}

    def references(self, names: list[str]) -> list[int]:
        """Return value references."""
        return [self.variables[n].valueReference for n in names]

    def get(self, names: list[str]) -> list[float]:
        """Read variables."""
        refs = self.references(names)
        return list(self.fmu.getReal(refs) if self.two else self.fmu.getFloat64(refs))

    def put(self, names: list[str], values: Any) -> None:
        """Set variables."""
        if not names:
            return
        refs, numbers = self.references(names), [float(v) for v in values]
        if self.two:
            self.fmu.setReal(refs, numbers)
        else:
            self.fmu.setFloat64(refs, numbers)

    def begin(self, kind: Any, own: Any, time: float, values: dict[str, float]) -> None:
        """Instantiate or reset, and initialise with some values."""
        if self.fmu is not None:
            try:
                self.fmu.reset()
            except Exception:  # not every tool writes it
                self.fmu = None
        if self.fmu is None:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self.fmu = kind(
                    guid=self.about.guid,
                    unzipDirectory=self.folder,
                    modelIdentifier=own.modelIdentifier,
                    instanceName="jaxsr",
                )
                self.fmu.instantiate()
        first = {n: x for n, x in values.items() if self.variables[n].initial != "calculated"}
        self.put(list(first), first.values())
        if self.two:
            self.fmu.setupExperiment(startTime=time)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=time)
        self.fmu.exitInitializationMode()
