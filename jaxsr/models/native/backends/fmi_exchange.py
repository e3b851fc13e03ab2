"""Model exchange: rates of an FMU's states at any row; never imported by the package.

Sources: FMI 2.0.4 (section 3.2, the calling sequence) and FMI 3.0.1 (section 3).
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import CFUNCTYPE, c_double, c_int, c_size_t, c_uint, c_void_p, cast
from typing import Any

import numpy as np
from fmi_unit import Refused, Unit, real

WARNING, ERROR = 1, 3
"""Of the statuses that a function may return; between them is discard: not at this point."""
EVENTS = 50
"""Most iterations of an event: more are a loop."""


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
            if rate.derivative is None or not real(rate):
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

    def evaluate(self, rows: np.ndarray) -> np.ndarray:
        """Return rates, shape (rows, states)."""
        found = np.full((len(rows), self.count), np.nan)
        self._visited(rows, lambda k, place: self._calls.rates(place(found, k), self.count))
        return found

    def _visited(self, rows: np.ndarray, there: Callable[[int, Any], int]) -> None:
        """Bring the FMU to every row, and do something there; it returns the status.

        A discarded row is left out; after an error the FMU begins anew.
        """
        rows = np.ascontiguousarray(rows)
        good = np.isfinite(rows).all(axis=1)
        u, p = self.at
        n, m = self.count, len(self.inputs)
        changed = np.ones(len(rows), dtype=bool)
        changed[1:] = (rows[1:, p:] != rows[:-1, p:]).any(axis=1)

        def place(array: np.ndarray, k: int, column: int = 0) -> int:
            return array.ctypes.data + k * array.strides[0] + 8 * column

        base, stride = rows.ctypes.data, rows.strides[0]
        times = rows[:, 0].tolist()
        for k in np.flatnonzero(good).tolist():
            if changed[k] or self.set_to is None:
                values = tuple(rows[k, p:])
                if values != self.set_to:
                    try:
                        self._begin(rows[k], values)
                    except self.failure:
                        continue
            at, calls = base + k * stride, self._calls
            status = max(
                calls.time(times[k]),
                calls.states(at + 8, n),
                calls.inputs(at + 8 * u, m) if m else 0,
            )
            if self.events:  # what is switched depends on where the states are
                try:
                    self.fmu.enterEventMode()
                    self._settle()
                except self.failure:
                    status = ERROR
                status = max(status, calls.states(at + 8, n))
            if status <= WARNING:
                status = max(status, there(k, place))
            if status >= ERROR:
                self.set_to = None

    def _begin(self, row: np.ndarray, values: tuple[float, ...]) -> None:
        from fmpy import fmi2, fmi3

        self.set_to = None
        given = dict(zip(self.parameters, values, strict=True))
        u, p = self.at
        given |= dict(zip(self.inputs, row[u:p], strict=True))
        kind = fmi2.FMU2Model if self.two else fmi3.FMU3Model
        self.begin(kind, self.about.modelExchange, float(row[0]), given)
        self._settle()
        self._calls = Calls(self.fmu, self.two, self._input_refs)
        self.set_to = values

    def _settle(self) -> None:
        """Iterate an event to its end, and go on with continuous time."""
        for _ in range(EVENTS):
            more = self.fmu.newDiscreteStates() if self.two else self.fmu.updateDiscreteStates()
            if not more[0]:
                break
        self.fmu.enterContinuousTimeMode()

    def exact(self, rows: np.ndarray, columns: list[int]) -> dict[int, np.ndarray]:
        """Return the directional derivatives by states and inputs, where it has them."""
        every = self.references([*self._states, *self.inputs])
        own = [k for k in columns if 1 <= k <= len(every)]
        if not (self.directional and own):
            return {}
        unknowns = self.references(self._rates())
        found = np.full((len(rows), len(unknowns), len(own)), np.nan)

        def there(k: int, place: Any) -> int:
            try:
                for i, column in enumerate(own):
                    known = [every[column - 1]]
                    found[k, :, i] = self.fmu.getDirectionalDerivative(unknowns, known, [1.0])
            except self.failure as error:
                return getattr(error, "status", ERROR)
            return 0

        self._visited(rows, there)
        return {k: found[:, :, i] for i, k in enumerate(own)}


class Calls:
    """The functions of a row, called as C calls them: FMPy's own cost ten times the evaluation."""

    def __init__(self, fmu: Any, two: bool, input_refs: Any) -> None:
        def function(name: str, *types: Any) -> Any:
            address = cast(getattr(fmu.dll, name), c_void_p).value
            return CFUNCTYPE(c_int, c_void_p, *types)(address or 0)

        c, n = fmu.component, len(input_refs)
        refs = cast(input_refs, c_void_p)
        prefix = "fmi2" if two else "fmi3"
        set_time = function(f"{prefix}SetTime", c_double)
        set_states = function(f"{prefix}SetContinuousStates", c_void_p, c_size_t)
        get = "fmi2GetDerivatives" if two else "fmi3GetContinuousStateDerivatives"
        get_rates = function(get, c_void_p, c_size_t)
        self.time = lambda t: set_time(c, t)
        self.states = lambda at, count: set_states(c, at, count)
        self.rates = lambda at, count: get_rates(c, at, count)
        if two:
            put = function("fmi2SetReal", c_void_p, c_size_t, c_void_p)
            self.inputs = lambda at, count: put(c, refs, n, at)
        else:
            put3 = function("fmi3SetFloat64", c_void_p, c_size_t, c_void_p, c_size_t)
            self.inputs = lambda at, count: put3(c, refs, n, at, n)
