"""Samples of a stream that are still needed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from jaxsr._result import InputError
from jaxsr.models import Model
from jaxsr.recordings import Recording

if TYPE_CHECKING:
    from jaxtyping import Float

KEPT = 20_000
"""Samples that a stream keeps, for a diagnosis of the stretch behind an alarm."""

Samples = Recording | Mapping[str, "Float[np.ndarray, ' samples']"]
"""The next rows of a stream, by column."""


class Stream:
    """The last samples of one machine's columns.

    Parameters
    ----------
    model : Model
    name : str
    """

    def __init__(self, model: Model, name: str) -> None:
        self.model, self.name = model, name
        names = [*model.inputs, *model.outputs]
        self.columns = list(dict.fromkeys(model.column(n) for n in names))
        self.time = np.empty(0)
        self.values = np.empty((len(self.columns), 0))

    def take(self, samples: Samples) -> None:
        """Take the samples that follow.

        Raises
        ------
        InputError
            A column is missing, columns differ in length, or time does not go on.
        """
        time, columns = self._read(samples)
        wrong = [n for n, values in columns.items() if np.shape(values) != time.shape]
        if wrong or time.ndim != 1:
            what = f"column {', '.join(wrong)[:80]} has not one value per time"
            raise InputError(what, self.name, "Give a value per time, NaN where missing")
        whole = np.concatenate([self.time, time])
        if not np.isfinite(time).all() or (np.diff(whole) <= 0.0).any():
            remedy = "Call finish() where a machine starts anew"
            raise InputError("time does not go on", self.name, remedy)
        self.time = whole[-KEPT:]
        rows = np.stack([np.asarray(v, dtype=float) for v in columns.values()])
        self.values = np.concatenate([self.values, rows], axis=1)[:, -KEPT:]

    def _read(
        self, samples: Samples
    ) -> tuple[Float[np.ndarray, " samples"], dict[str, Float[np.ndarray, " samples"]]]:
        if isinstance(samples, Recording):
            return samples.time, {n: samples.channel(n) for n in self.columns}
        clock = self.model.columns.get(self.model.time, self.model.time)
        absent = [n for n in (clock, *self.columns) if n not in samples]
        if absent:
            remedy = f"Give {', '.join((clock, *self.columns))[:80]}"
            raise InputError(f"no column {absent[0]!r}", self.name, remedy)
        time = np.asarray(samples[clock], dtype=float)
        return time, {n: np.asarray(samples[n], dtype=float) for n in self.columns}

    def __len__(self) -> int:
        return self.time.size

    def since(self, time: float, least: int = 3) -> Recording:
        """Return the samples from a time on, at least so many of the last."""
        first = min(int(np.searchsorted(self.time, time)), max(len(self) - least, 0))
        return self.last(len(self) - first)

    def last(self, count: int) -> Recording:
        """Return the last samples."""
        values = dict(zip(self.columns, self.values[:, -count:], strict=True))
        return Recording(self.name, self.time[-count:], values)
