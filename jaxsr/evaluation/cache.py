"""Columns of terms on one set of samples, each unique subtree evaluated once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxsr._result import InputError
from jaxsr.evaluation.integration import cumulative_trapezoid, recording_starts
from jaxsr.expressions.primitives import PRIMITIVES
from jaxsr.expressions.term import BOOLEAN, Term

Array = NDArray[Any]


class ColumnCache:
    """Evaluate terms on fixed samples and keep every subtree's column.

    Most terms of a generation are made of pieces of the last one, so their columns are at hand.

    Parameters
    ----------
    variables : mapping of str to ndarray, (samples,)
    limit_bytes : int
        Memory for columns; the longest unused go first.
    dtype : dtype
        float64, or float32 for raw throughput.
    time : str or ndarray, (samples,)
        What ``integral`` integrates over, in seconds: a variable's name, or the instants.
    group : ndarray, (samples,), optional
        Number of the recording of each sample: integrals begin anew in each. One when None.
    """

    def __init__(
        self,
        variables: Mapping[str, Array],
        limit_bytes: int = 128 * 2**20,
        dtype: type = np.float64,
        *,
        time: str | Array = "t",
        group: Array | None = None,
    ) -> None:
        self._variables = {name: np.asarray(v, dtype=dtype) for name, v in variables.items()}
        self._shape = next((v.shape for v in self._variables.values()), (1,))
        self._dtype = dtype
        self._time = time
        self._starts = recording_starts(group, self._shape[0])
        self._room = max(64, limit_bytes // max(1, int(np.prod(self._shape)) * 8))
        self._columns: dict[Term, Array] = {}
        self.hits = 0
        self.misses = 0

    def __len__(self) -> int:
        return len(self._columns)

    def __contains__(self, term: Term) -> bool:
        return term in self._columns

    def hold(self, term: Term, column: Array) -> None:
        """Keep a column (samples,) that was computed elsewhere."""
        self._columns[term] = column
        while len(self._columns) > self._room:
            del self._columns[next(iter(self._columns))]

    def column(self, term: Term, *, keep: bool = True) -> Array:
        """Return the column (samples,) of a term.

        With ``keep=False`` nothing that holds a constant is stored: a search over constants
        visits each value once.
        """
        with np.errstate(all="ignore"):
            value = self._evaluate(term, keep)[0]
        return np.broadcast_to(value, self._shape) if value.shape != self._shape else value

    def _evaluate(self, term: Term, keep: bool) -> tuple[Array, bool]:
        """Return the value and whether it may be stored."""
        if term.op == "variable":
            if term.name not in self._variables:
                known = ", ".join(self._variables)
                raise InputError(f"unknown variable {term.name}", "", f"Known: {known}.")
            return self._variables[term.name], True
        if term.op == "constant":
            return np.asarray(term.value, dtype=self._dtype), keep
        if term.op == BOOLEAN:
            return np.asarray(term.value, dtype=self._dtype), True
        found = self._columns.pop(term, None)
        if found is not None:
            self._columns[term] = found  # now the most recently used
            self.hits += 1
            return found, True
        self.misses += 1
        parts = [self._evaluate(arg, keep) for arg in term.args]
        primitive = PRIMITIVES[term.op]
        args = [v for v, _ in parts]
        raw = primitive.numpy(*args) if primitive.pointwise else self._integral(*args)
        value = np.asarray(raw, dtype=self._dtype)
        storable = all(ok for _, ok in parts)
        if storable and value.shape == self._shape:
            self.hold(term, value)
        return value, storable

    def _integral(self, f: Array, g: Array | None = None) -> Array:
        """Return the integral of f over g, or over time, from the start of each recording."""
        g = self._times() if g is None else np.broadcast_to(g, self._shape)
        return cumulative_trapezoid(np.broadcast_to(f, self._shape), g, self._starts)

    def _times(self) -> Array:
        times = self._variables.get(self._time) if isinstance(self._time, str) else self._time
        if times is None or np.shape(times) != self._shape:
            raise InputError(
                f"integral needs the instants of the samples, {self._time!r} are none",
                "",
                f"Give `time` as a variable ({', '.join(self._variables)}) or as an array.",
            )
        return np.asarray(times)
