"""A recording: one experiment, its time and its measured channels."""

# pyright: reportMissingTypeStubs=false
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from jaxsr._result import InputError
from jaxsr.recordings.data_check import DataCheck
from jaxsr.recordings.table import listed, quoted

if TYPE_CHECKING:
    import pandas as pd
    from jaxtyping import Bool, Float, Integer
    from matplotlib.figure import Figure

MIN_SAMPLES = 3
RESTARTED = 8
"""Mean samples between steps back in time from which a clock began anew; rows in disorder step
back every few samples."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Hold the channels of one experiment over a strictly increasing time.

    Parameters
    ----------
    name : str
        File name, used in messages and in reports.
    time : ndarray, shape (samples,)
        Time in seconds, strictly increasing, not necessarily uniform.
    channels : mapping of str to ndarray, shape (samples,)
        Measured values; NaN marks a missing sample.
    source : Path, optional
        File the recording was read from.
    sha256 : str, optional
        Checksum of that file's bytes.
    set_aside : mapping of str to str, optional
        Columns of the file that hold no numbers, each with the reason.
    remarks : tuple of DataCheck, optional
        How the file was read, where that is not plain.
    time_stated : bool, optional
        Whether the file says in which unit its time is.

    Raises
    ------
    InputError
        If time is not finite and strictly increasing, if a channel has another length, or if
        there are fewer than three samples.

    Notes
    -----
    Arrays are copied to float64 and made read-only. Rows in messages count data rows from 1.
    """

    name: str
    time: Float[np.ndarray, " samples"]
    channels: Mapping[str, Float[np.ndarray, " samples"]]
    source: Path | None = None
    sha256: str | None = None
    set_aside: Mapping[str, str] = field(default_factory=dict[str, str])
    remarks: tuple[DataCheck, ...] = ()
    time_stated: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", _frozen(self.time))
        channels = {key: _frozen(values) for key, values in self.channels.items()}
        object.__setattr__(self, "channels", channels)
        _check_time(self.name, self.time)
        for key, values in channels.items():
            if values.shape != self.time.shape:
                raise InputError(
                    f"channel '{key}' has shape {values.shape}, time has {self.time.shape}",
                    self.name,
                    "Give one value per time, NaN where a sample is missing",
                )

    @classmethod
    def from_arrays(
        cls, time: ArrayLike, channels: Mapping[str, ArrayLike], name: str = "recording"
    ) -> Recording:
        """Return a recording of arrays.

        Parameters
        ----------
        time : array_like, shape (samples,)
            In seconds, strictly increasing.
        channels : mapping of str to array_like, shape (samples,)
            NaN marks a missing sample.
        name : str
            Used in messages and reports.

        Raises
        ------
        InputError
            As the class itself.
        """
        return cls(name, np.asarray(time), {key: np.asarray(v) for key, v in channels.items()})

    @classmethod
    def from_pandas(
        cls,
        table: pd.DataFrame,
        time: str | None = None,
        *,
        name: str = "recording",
        sample_time: float | None = None,
    ) -> Recording:
        """Return the recording that a DataFrame holds, read as a file would be.

        Parameters
        ----------
        table : DataFrame
            Numeric columns are channels. An index that is no plain count (numbers, dates, time
            deltas) is a column too: time, unless another one is named.
        time : str, optional
            Column of time, found by its name otherwise (see `read_recording`).
        name : str
            Used in messages and reports.
        sample_time : float, optional
            Interval in seconds, for tables without time.

        Raises
        ------
        InputError
            There is no column of time, or it does not increase.
        """
        from jaxsr.recordings.frames import contents_of_frame

        return cls(**vars(contents_of_frame(table, time, name, sample_time)))

    def to_pandas(self, time: str = "t") -> pd.DataFrame:
        """Return a DataFrame with a column for every channel; `time`, in s, is its index."""
        import pandas as pd

        return pd.DataFrame(dict(self.channels), index=pd.Index(self.time, name=time))

    def plot(self, channels: Sequence[str] | None = None, figure: Figure | None = None) -> Figure:
        """Draw channels over time, one above another.

        Parameters
        ----------
        channels : sequence of str, optional
            All by default, of many the first twelve.
        figure : matplotlib Figure, optional
            A new one of pyplot by default.
        """
        from jaxsr.recordings.plots import plot_recording

        return plot_recording(self, channels, figure)

    def __repr__(self) -> str:
        """Return name, length and channels in a line."""
        return f"<Recording {self.name}: {self._extent}; {listed(list(self.channels), 80)}>"

    def __str__(self) -> str:
        """Return a table of the channels: least and greatest value, missing samples."""
        lines = [f"{self.name}: {self._extent}"]
        for name, values in self.channels.items():
            known = values[np.isfinite(values)]
            span = f"{known.min():.4g} to {known.max():.4g}" if known.size else "no sample"
            missing = values.size - known.size
            lines.append(f"  {quoted(name)}: {span}{f', {missing} missing' if missing else ''}")
        lines += [f"  {quoted(name)}: {reason}" for name, reason in self.set_aside.items()]
        return "\n".join(lines)

    @property
    def _extent(self) -> str:
        length = self.time[-1] - self.time[0]
        return f"{len(self)} samples over {length:.4g} s, {self.sample_time:.4g} s apart"

    def __len__(self) -> int:
        return self.time.size

    @property
    def sample_time(self) -> float:
        """Median interval between samples, in seconds."""
        return float(np.median(np.diff(self.time)))

    def channel(self, name: str) -> Float[np.ndarray, " samples"]:
        """Return a channel that is to be used, checked for being usable.

        Parameters
        ----------
        name : str
            Column name.

        Returns
        -------
        ndarray, shape (samples,)
            Read-only float64 values, NaN where a sample is missing.

        Raises
        ------
        InputError
            If there is no such column, it holds no numbers, every sample is missing, or a value
            is infinite.
        """
        if name in self.set_aside:
            raise InputError(f"column '{quoted(name)}' {self.set_aside[name]}", self.name)
        if name not in self.channels:
            raise InputError(
                f"no column '{quoted(name)}'",
                self.name,
                f"Available: {listed(list(self.channels))}. Choose one of these, or name it under "
                "[columns] of the model",
            )
        values = self.channels[name]
        if np.isnan(values).all():
            raise InputError(
                f"every sample of column '{name}' is missing", self.name, "Leave the column out"
            )
        infinite = np.flatnonzero(np.isinf(values))
        if infinite.size:
            raise InputError(
                f"column '{name}' is infinite at row {infinite[0] + 1}",
                self.name,
                "Leave the cell empty where a sample is missing",
            )
        return values

    def select(
        self,
        indices: slice
        | Sequence[int]
        | Integer[np.ndarray, " kept"]
        | Bool[np.ndarray, " samples"],
    ) -> Recording:
        """Return the recording restricted to some samples, in increasing time.

        Parameters
        ----------
        indices : slice, int array or bool array
            Samples to keep.
        """
        if not isinstance(indices, slice):
            indices = np.asarray(indices)
        channels = {key: values[indices] for key, values in self.channels.items()}
        return replace(self, time=self.time[indices], channels=channels)

    def window(self, t_from: float, t_to: float) -> Recording:
        """Return the samples with ``t_from <= t <= t_to`` (seconds), time kept as it is."""
        start = int(np.searchsorted(self.time, t_from, side="left"))
        stop = int(np.searchsorted(self.time, t_to, side="right"))
        return self.select(slice(start, stop))


def _frozen(values: ArrayLike) -> np.ndarray:
    """Return a read-only float64 array; copied but for what nobody can write to."""
    array = np.asarray(values, dtype=np.float64)
    if not isinstance(array.base, bytes):
        array = np.array(array)
    array.setflags(write=False)
    return array


def _check_time(name: str, time: np.ndarray) -> None:
    if time.ndim != 1 or time.size < MIN_SAMPLES:
        raise InputError(
            f"time has shape {time.shape}",
            name,
            f"A recording needs one time column of at least {MIN_SAMPLES} samples",
        )
    bad = np.flatnonzero(~np.isfinite(time))
    if bad.size:
        raise InputError(
            f"time is missing or infinite at row {bad[0] + 1}",
            name,
            "Give every sample its time; leave only other columns empty",
        )
    wrong = np.flatnonzero(np.diff(time) <= 0.0)
    if wrong.size:
        at, row = time[wrong[0] + 1], wrong[0] + 2
        if time[wrong[0]] == at:
            raise InputError(
                f"time {at:.12g} s of row {row} repeats row {row - 1}",
                name,
                "Remove duplicate samples; if the clock is too coarse, write it with more digits",
            )
        raise _went_back(name, time, wrong)


def _went_back(name: str, time: np.ndarray, wrong: np.ndarray) -> InputError:
    """Tell a clock that began anew from rows in disorder."""
    before, at, row = time[wrong[0]], time[wrong[0] + 1], wrong[0] + 2
    where = f"row {row}: {before:.12g} s, then {at:.12g} s"
    stretches = np.diff(np.concatenate([[0], wrong + 1, [time.size]]))
    if stretches.min() >= MIN_SAMPLES and stretches.mean() >= RESTARTED:
        times = "once" if wrong.size == 1 else f"{wrong.size} times"
        return InputError(
            f"time goes back {times}, first at {where}",
            name,
            "If it was restarted there, give each stretch its own file; if it overflowed, count on",
        )
    return InputError(
        f"time is not increasing at {where}",
        name,
        "Sort the rows by time, and give each experiment its own file",
    )
