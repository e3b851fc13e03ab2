"""Tables of pandas as recordings hold them."""

from __future__ import annotations

import numpy as np
import pandas as pd

from jaxsr._result import InputError
from jaxsr.recordings.contents import Contents, contents_of
from jaxsr.recordings.table import Table, quoted


def contents_of_frame(
    frame: pd.DataFrame, time: str | None, name: str, sample_time: float | None
) -> Contents:
    """Return what a DataFrame holds, see `Recording.from_pandas`."""
    if not isinstance(frame.index, pd.RangeIndex) and sample_time is None:
        index = str(frame.index.name or "time")
        if index in map(str, frame.columns):
            what = f"the index and a column are both named '{quoted(index)}'"
            raise InputError(what, name, "Rename one of them, or call reset_index(drop=True)")
        frame = frame.rename_axis(index).reset_index()
        time = index if time is None else time
    numbers: dict[str, np.ndarray] = {}
    texts: dict[str, pd.Series] = {}
    for place, column in enumerate(frame.columns):
        key, values = str(column), frame.iloc[:, place]
        if key in numbers or key in texts:
            raise InputError(f"two columns are named '{quoted(key)}'", name, "Rename one of them")
        array = _numbers(values)
        if array is None:
            texts[key] = values.astype("string").reset_index(drop=True)
        else:
            numbers[key] = array
    return contents_of(Table(numbers, texts), name, time, sample_time)


def _numbers(values: pd.Series) -> np.ndarray | None:
    """Return a column as float64, datetime64[ns] or timedelta64[ns]; None where it is text."""
    kind = values.dtype
    if isinstance(kind, pd.DatetimeTZDtype):
        return values.dt.tz_convert("UTC").dt.tz_localize(None).to_numpy("datetime64[ns]")
    if pd.api.types.is_datetime64_dtype(kind):
        return values.to_numpy("datetime64[ns]")
    if pd.api.types.is_timedelta64_dtype(kind):
        return values.to_numpy("timedelta64[ns]")
    if pd.api.types.is_complex_dtype(kind) or not pd.api.types.is_numeric_dtype(kind):
        return None
    return values.to_numpy(dtype=np.float64, na_value=np.nan)
