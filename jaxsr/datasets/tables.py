"""Text of a table, digit by digit the same on every machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd


def as_text(table: pd.DataFrame, form: str | Mapping[str, str]) -> str:
    """Write a table as CSV.

    Parameters
    ----------
    table : DataFrame
        Of numbers.
    form : str or mapping of str to str
        Format of a number, such as ``%.7g``, for all columns or by column.
    """
    forms = {name: form if isinstance(form, str) else form[name] for name in table}
    columns: Sequence[list[str]] = [
        [forms[name] % value for value in table[name].astype(float)] for name in table
    ]
    rows = [",".join(row) for row in zip(*columns, strict=True)]
    return "\n".join([",".join(map(str, table)), *rows]) + "\n"


def from_zero(table: pd.DataFrame, digits: int = 6) -> pd.DataFrame:
    """Return a table whose ``time_s`` starts at zero; `digits` are those of its stamps."""
    time = table["time_s"].to_numpy()
    return table.assign(time_s=np.round(time - time[0], digits)).reset_index(drop=True)
