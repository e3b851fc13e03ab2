"""A Functional Mock-up Unit by FMPy, in the worker's process; never imported by the package.

Sources: FMI 2.0.4 (section 3.2, the calling sequence of model exchange) and FMI 3.0.1.
"""

from __future__ import annotations

import os
import warnings
import zipfile
from ctypes import POINTER, c_double, c_uint
from typing import Any

import numpy as np

EVENTS = 50
"""Most iterations of an event: more are a loop."""


class Refused(Exception):
    """What is wrong with the FMU, and the remedy."""

    def __init__(self, what: str, remedy: str = "") -> None:
        super().__init__(what)
        self.what, self.remedy = what, remedy


def opened(request: dict[str, Any]) -> Any:
    """Open an FMU, its model exchange where it has one."""
    path, folder = request["path"], request["folder"]
    try:
        import fmpy
        from fmpy import model_description
    except ImportError:
        raise Refused("FMPy is not installed", "Install jaxsr-dynamics[fmu]") from None
    if not zipfile.is_zipfile(path):
        raise Refused("is no FMU: not a ZIP archive", "Export it again")
    try:
        about = model_description.read_model_description(path, validate=False)
    except Exception as error:
        what = " ".join(str(error).split())[:80]
        raise Refused(f"has no readable modelDescription.xml: {what}", "Export it again") from None
    if about.fmiMajorVersion not in (2, 3):
        raise Refused(f"is FMI {about.fmiVersion}", "Export it as FMI 2 or 3")
    if about.modelExchange is None and about.coSimulation is None:
        raise Refused("has neither model exchange nor co-simulation", "Export one of them")
    fmpy.extract(path, unzipdir=folder)
    own = about.modelExchange or about.coSimulation
    platform = fmpy.platform if about.fmiMajorVersion == 2 else fmpy.platform_tuple
    name = own.modelIdentifier + fmpy.sharedLibraryExtension
    if not os.path.isfile(os.path.join(folder, "binaries", platform, name)):
        inside = os.path.join(folder, "binaries")
        there = sorted(os.listdir(inside)) if os.path.isdir(inside) else []
        raise Refused(
            f"holds no binary for {platform} ({', '.join(there) or 'none at all'})"[:140],
            "Export it for this system, or compile it",
        )
    if about.modelExchange is not None:
        return Exchange(about, folder)
    return Stepped(about, folder, request.get("step"))


def _real(variable: Any) -> bool:
    return variable.type in ("Real", "Float64") and not variable.dimensions


def _number(text: Any) -> float | None:
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
    return _number(own)


class Unit:
    """What model exchange and co-simulation have in common."""

    def __init__(self, about: Any, folder: str) -> None:
        from fmpy.fmi1 import FMICallException

        self.failure = FMICallException
        self.about, self.folder = about, folder
        self.two = about.fmiMajorVersion == 2
        self.variables = {v.name: v for v in about.modelVariables if _real(v)}
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
        odd = [
            v.name
            for v in self.about.modelVariables
            if v.causality == "input" and not _real(v) and v.start is None
        ]
        return {
            "name": self.about.modelName or "fmu",
            "fmi": self.about.fmiVersion,
            "states": [told[s] for s in states],
            "rates": rates,
            "inputs": named("input"),
            "outputs": named("output"),
            "parameters": chosen,
            "odd": odd,
            "kind": type(self).__name__,
        }

    def _told(self, v: Any) -> dict[str, Any]:
        return {
            "name": v.name,
            "unit": _unit(v),
            "start": _number(v.start),
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

    def exact(self, rows: np.ndarray) -> dict[int, np.ndarray]:
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


class Exchange(Unit):
    """Model exchange: rates of the states at any row."""

    def __init__(self, about: Any, folder: str) -> None:
        super().__init__(about, folder)
        self._states = self.states()
        self.events = int(about.numberOfEventIndicators or 0) or len(about.eventIndicators)
        self.directional = bool(about.modelExchange.providesDirectionalDerivative)
        if not self._states:
            raise Refused("has no continuous states", "Export a model with states")

    def states(self) -> list[str]:
        """Return the states in the order of the model structure."""
        found = []
        for unknown in self.about.derivatives:
            rate = unknown.variable
            if rate.derivative is None or not _real(rate):
                raise Refused(f"does not say whose derivative {rate.name} is", "Export it again")
            found.append(rate.derivative.name)
        return found

    def _rates(self) -> list[str]:
        return [u.variable.name for u in self.about.derivatives]

    def choose(self, chosen: dict[str, Any]) -> None:
        """Say which variables stand in the rows."""
        super().choose(chosen)
        self.count = len(self._states)
        self.at = 1 + self.count, 1 + self.count + len(self.inputs)
        self._input_refs = (c_uint * len(self.inputs))(*self.references(self.inputs))
        self._output_refs = (c_uint * len(self.outputs))(*self.references(self.outputs))

    def evaluate(self, rows: np.ndarray) -> np.ndarray:
        """Return rates and outputs, shape (rows, states + outputs)."""
        found = np.full((len(rows), self.count + len(self.outputs)), np.nan)
        rows = np.ascontiguousarray(rows)
        for row, result in zip(rows, found, strict=True):
            if not np.isfinite(row).all():
                continue
            try:
                self._enter(row)
                self._read(result)
            except self.failure as error:
                result[:] = np.nan
                self._failed(error)
        return found

    def _failed(self, error: Exception) -> None:
        if getattr(error, "status", 3) >= 3:  # an error ends a run; discard does not
            self.set_to = None

    def _enter(self, row: np.ndarray) -> None:
        """Bring the FMU to a row."""
        f, (u, p) = self.fmu, self.at
        values = tuple(row[p:])
        if values != self.set_to:
            self._begin(row, values)
            f = self.fmu
        c = f.component
        x = row[1:u].ctypes.data_as(POINTER(c_double))
        (f.fmi2SetTime if self.two else f.fmi3SetTime)(c, float(row[0]))
        (f.fmi2SetContinuousStates if self.two else f.fmi3SetContinuousStates)(c, x, self.count)
        if self.inputs:
            n, values = len(self.inputs), row[u:p].ctypes.data_as(POINTER(c_double))
            if self.two:
                f.fmi2SetReal(c, self._input_refs, n, values)
            else:
                f.fmi3SetFloat64(c, self._input_refs, n, values, n)
        if self.events:
            # what is switched depends on where the states are
            f.enterEventMode()
            self._settle()
            (f.fmi2SetContinuousStates if self.two else f.fmi3SetContinuousStates)(c, x, self.count)

    def _begin(self, row: np.ndarray, values: tuple[float, ...]) -> None:
        from fmpy import fmi2, fmi3

        self.set_to = None
        given = dict(zip(self.parameters, values, strict=True))
        u, p = self.at
        given |= dict(zip(self.inputs, row[u:p], strict=True))
        kind = fmi2.FMU2Model if self.two else fmi3.FMU3Model
        self.begin(kind, self.about.modelExchange, float(row[0]), given)
        self._settle()
        self.set_to = values

    def _settle(self) -> None:
        """Iterate an event to its end, and go on with continuous time."""
        for _ in range(EVENTS):
            more = self.fmu.newDiscreteStates() if self.two else self.fmu.updateDiscreteStates()
            if not more[0]:
                break
        self.fmu.enterContinuousTimeMode()

    def _read(self, result: np.ndarray) -> None:
        f, c = self.fmu, self.fmu.component
        rates = result.ctypes.data_as(POINTER(c_double))
        if self.two:
            f.fmi2GetDerivatives(c, rates, self.count)
        else:
            f.fmi3GetContinuousStateDerivatives(c, rates, self.count)
        if self.outputs:
            n, rest = len(self.outputs), result[self.count :].ctypes.data_as(POINTER(c_double))
            if self.two:
                f.fmi2GetReal(c, self._output_refs, n, rest)
            else:
                f.fmi3GetFloat64(c, self._output_refs, n, rest, n)

    def exact(self, rows: np.ndarray) -> dict[int, np.ndarray]:
        """Return the directional derivatives by states and inputs, where it has them."""
        if not self.directional:
            return {}
        unknowns = self.references([*self._rates(), *self.outputs])
        knowns = self.references([*self._states, *self.inputs])
        found = np.full((len(rows), len(unknowns), len(knowns)), np.nan)
        rows = np.ascontiguousarray(rows)
        for row, result in zip(rows, found, strict=True):
            if not np.isfinite(row).all():
                continue
            try:
                self._enter(row)
                for k, known in enumerate(knowns):
                    result[:, k] = self.fmu.getDirectionalDerivative(unknowns, [known], [1.0])
            except self.failure as error:
                self._failed(error)
        return {1 + k: found[:, :, k] for k in range(len(knowns))}


class Stepped(Unit):
    """Co-simulation: steps of one length, from states that can be set.

    A step from any states is what a unit does that is reset, given those states as start values,
    and stepped once. It must have no memory beside them: `_check_memory` compares with a run.
    """

    def __init__(self, about: Any, folder: str, step: float | None) -> None:
        super().__init__(about, folder)
        default = about.defaultExperiment
        own = _number(default.stepSize) if default is not None else None
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
