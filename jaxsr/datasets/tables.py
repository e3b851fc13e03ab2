"""Text of a table, digit by digit the same on every machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

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


def from_zero(time: pd.Series) -> pd.Series:
    """Return time from the first sample; stamps of the sets are whole microseconds."""
    return (time - time.iloc[0]).round(6)
