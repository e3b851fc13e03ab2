"""Read a table from text: CSV as people have it."""

from __future__ import annotations

import io
import re
import warnings

import numpy as np
import pandas as pd

from jaxsr._result import InputError
from jaxsr.recordings.cells import MISSING, Decimal, numbers_of
from jaxsr.recordings.encoding import decode
from jaxsr.recordings.layout import MOST_COLUMNS, Layout, find_layout
from jaxsr.recordings.table import Table, quoted


def read_csv(raw: bytes, file: str) -> Table:
    """Read the bytes of a text file.

    Raises
    ------
    InputError
        If it is no table of numbers under a header, or can be read in two ways.
    """
    if raw.startswith(b"PK\x03\x04"):
        raise InputError("a zip archive, not text", file, "A workbook's name ends in .xlsx")
    text, encoding = decode(raw, file)
    return read_text(text, file, (encoding,) if encoding else ())


def read_text(text: str, file: str, said: tuple[str, ...] = ()) -> Table:
    """Read a table from text with plain line ends; `said` tells what was done before."""
    layout = find_layout(text, file)
    body = text[layout.start :].encode("utf-8", "replace")
    frame = _frame(body, layout, file)
    frame = _without_empty_end(frame)
    _refuse_more_cells_than_names(frame, layout, file)
    named = [i for i, name in enumerate(layout.names) if name]
    numbers: dict[str, np.ndarray] = {}
    texts: dict[str, pd.Series] = {}
    for i in named:
        column = frame.iloc[:, i]
        if pd.api.types.is_numeric_dtype(column):
            kept = pd.api.types.is_integer_dtype(column) and column.dtype != np.uint64
            numbers[layout.names[i]] = column.to_numpy(np.int64 if kept else np.float64)
        else:
            texts[layout.names[i]] = column
    proven = layout.decimal
    read, texts = numbers_of(texts, proven, file)
    numbers = {n: (numbers | read)[n] for n in layout.names if n in numbers or n in read}
    comma = proven is Decimal.COMMA
    notes = (*said, *layout.said, *(("decimal commas",) if comma else ()))
    nameless = frame.iloc[:, 0] if _starts_without_a_name(frame, layout) else None

    def exact(name: str) -> pd.Series:
        i = layout.names.index(name)
        return _frame(body, layout, file, only=i).iloc[: len(frame), 0]

    units = dict(zip(layout.names, layout.units, strict=False))
    return Table(numbers, texts, nameless, units, said=notes, exact=exact)


def _without_empty_end(frame: pd.DataFrame) -> pd.DataFrame:
    """Leave out lines at the end that hold nothing but separators."""
    if frame.empty or frame.iloc[-1].notna().any():
        return frame
    full = np.flatnonzero(frame.notna().to_numpy().any(axis=1))
    return frame.iloc[: full[-1] + 1 if full.size else 0]


def _starts_without_a_name(frame: pd.DataFrame, layout: Layout) -> bool:
    if not layout.names or layout.names[0]:
        return False
    return not pd.api.types.is_numeric_dtype(frame.iloc[:, 0])


def _frame(body: bytes, layout: Layout, file: str, only: int | None = None) -> pd.DataFrame:
    """Parse the samples; `only` reads one column, as it is written."""
    if layout.width > MOST_COLUMNS:
        raise InputError(f"more than {MOST_COLUMNS} columns", file, "Keep those that are used")
    try:
        with warnings.catch_warnings():
            # values beyond the columns would be dropped with a warning
            warnings.simplefilter("error", pd.errors.ParserWarning)
            return pd.read_csv(
                io.BytesIO(body),
                sep=r"\s+" if layout.separator is None else layout.separator,
                decimal="," if layout.decimal is Decimal.COMMA else ".",
                header=None,
                names=range(layout.width),
                index_col=False,
                usecols=None if only is None else [only],
                dtype=None if only is None else str,
                na_values=list(MISSING),
                keep_default_na=True,
                skipinitialspace=layout.separator != "\t",  # else an empty last cell is lost
                low_memory=False,
                encoding="utf-8",
            )
    except pd.errors.EmptyDataError:
        raise InputError("a header but no samples", file, "Give at least 3 samples") from None
    except pd.errors.ParserWarning as error:
        what = f"a line has more values than the {layout.width} columns of the table"
        raise InputError(what, file, "Give every column a name, or check the lines") from error
    except (pd.errors.ParserError, ValueError, OverflowError) as error:
        text = re.sub(
            r"(?<=line )\d+", lambda m: str(int(m.group()) + layout.line), str(error).strip()
        )
        text = text.removeprefix("Error tokenizing data. C error: ")
        raise InputError(f"not a table: {quoted(text, 80)}", file, "Check that line") from error


def _refuse_more_cells_than_names(frame: pd.DataFrame, layout: Layout, file: str) -> None:
    """Cells beyond the header must be empty: a separator at the end of every line is common."""
    beyond = frame.iloc[:, len(layout.names) :].notna().to_numpy()
    if not beyond.any():
        return
    row = int(np.flatnonzero(beyond.any(axis=1))[0])
    last = int(np.flatnonzero(beyond[row])[-1])
    raise InputError(
        f"row {row + 1} (about line {row + 1 + layout.line}) has {len(layout.names) + last + 1} "
        f"values, the header names {len(layout.names)}",
        file,
        "Give every column a name, or check that line",
    )
