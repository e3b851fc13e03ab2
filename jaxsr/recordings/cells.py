"""Cells of text: numbers with a decimal point or comma, missing samples, and what is neither."""

from __future__ import annotations

import enum
import itertools
import re
from collections.abc import Mapping

import numpy as np
import pandas as pd

from jaxsr._result import InputError
from jaxsr.recordings.table import quoted

_STEMS = (
    "na",
    "n/a",
    "n.a.",
    "n.a",
    "n. a.",
    "nan",
    "-nan",
    "+nan",
    "nan(ind)",
    "-nan(ind)",
    "null",
    "none",
    "nil",
    "missing",
    "invalid",
    "void",
    "k.a.",
    "k. a.",
    "-",
    "--",
    "---",
    "–",
    "—",
    ".",
    "?",
    "*",
    "#n/a",
    "#nv",
    "#na",
    "#value!",
    "#wert!",
    "#div/0!",
    "#num!",
    "#zahl!",
    "#ref!",
    "#bezug!",
    "#name?",
    "#null!",
    "<na>",
    "<null>",
    "1.#qnan",
    "-1.#qnan",
    "1.#ind",
    "-1.#ind",
    "nv",
    "n/v",
    "n/d",
    "nd",
)
MISSING = frozenset(
    itertools.chain.from_iterable((w, w.upper(), w.capitalize(), w.title()) for w in _STEMS)
) | {"NaN", "-NaN", "+NaN", "NaN(ind)", "-NaN(ind)"}
"""Words that stand for a missing sample, in every usual case."""

_EXPONENT = r"(?:[eEdD][+-]?[0-9]{1,4})?"
# A run of digits may be read in one way only: two ways take time with the square of its length.
POINT = re.compile(rf"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+){_EXPONENT}")
COMMA = re.compile(rf"[+-]?(?:[0-9]+(?:,[0-9]*)?|,[0-9]+){_EXPONENT}")
GROUPED_COMMA = re.compile(r"[+-]?[1-9][0-9]{0,2}(?:,[0-9]{3})+(?:\.[0-9]*)?")
GROUPED_POINT = re.compile(r"[+-]?[1-9][0-9]{0,2}(?:\.[0-9]{3})+(?:,[0-9]*)?")
INFINITE = re.compile(r"[+-]?(?:inf|infinity|1\.#inf)", re.IGNORECASE)


class Decimal(enum.Enum):
    """Which sign stands before the decimals."""

    POINT = "."
    COMMA = ","


def tidy(cell: str) -> str:
    """Return a cell without the characters that only typesetting puts there."""
    return cell.strip().replace("\u2212", "-").replace("\u00a0", "").replace("\u202f", "")


def is_missing(cell: str) -> bool:
    """Return whether a cell stands for a missing sample."""
    return not cell or cell in MISSING


def is_number(cell: str) -> bool:
    """Return whether a cell is a number in any reading."""
    return bool(readings(cell)) or INFINITE.fullmatch(cell) is not None


def readings(cell: str) -> set[Decimal]:
    """Return the decimal signs under which a cell is a number."""
    found = set()
    if POINT.fullmatch(cell) or GROUPED_COMMA.fullmatch(cell):
        found.add(Decimal.POINT)
    if COMMA.fullmatch(cell) or GROUPED_POINT.fullmatch(cell):
        found.add(Decimal.COMMA)
    return found


def proves_comma(cell: str) -> bool:
    """Return whether a cell is a number only if commas stand before decimals."""
    return "," in cell and readings(cell) == {Decimal.COMMA}


def numbers_of(
    texts: Mapping[str, pd.Series], proven: Decimal | None, file: str
) -> tuple[dict[str, np.ndarray], dict[str, pd.Series]]:
    """Read columns that were not plain numbers.

    Parameters
    ----------
    texts : mapping of str to Series of str
        NaN where a cell is empty.
    proven : Decimal or None
        The decimal sign that other cells of the file are sure of.
    file : str
        For messages.

    Returns
    -------
    numbers : dict of str to ndarray
    others : dict of str to Series of str
        Columns without any number.

    Raises
    ------
    InputError
        If a column of numbers holds a word, or could be read in two ways.
    """
    columns = {name: _Column(name, text) for name, text in texts.items()}
    sure = {c.only for c in columns.values() if c.only is not None}
    if proven is not None:
        sure.add(proven)
    hint = next(iter(sure)) if len(sure) == 1 else None
    numbers, others = {}, {}
    for name, column in columns.items():
        if column.is_text:
            others[name] = column.text
        else:
            numbers[name] = column.values(hint, file)
    return numbers, others


class _Column:
    """A column of text under both readings."""

    def __init__(self, name: str, text: pd.Series) -> None:
        self.name = name
        clean = text.astype("string").fillna("").str.strip()
        for typeset, plain in (("\u2212", "-"), ("\u00a0", ""), ("\u202f", "")):
            clean = clean.str.replace(typeset, plain, regex=False)
        self.text = clean
        cells = clean.to_numpy(dtype=object)
        self._cells = cells
        self._missing = np.array([is_missing(c) for c in cells], dtype=bool)
        infinite = np.array([INFINITE.fullmatch(c) is not None for c in cells], dtype=bool)
        known = self._missing | infinite
        found = [set() if k else readings(c) for c, k in zip(cells, known, strict=True)]
        self._fits = {
            sign: np.array([k or sign in f for k, f in zip(known, found, strict=True)], dtype=bool)
            for sign in Decimal
        }
        self._known = known

    @property
    def is_text(self) -> bool:
        """Whether no cell is a number."""
        return not any((fit & ~self._known).any() for fit in self._fits.values())

    @property
    def only(self) -> Decimal | None:
        """The one reading under which the column is a column of numbers and holds a sign."""
        whole = [sign for sign, fit in self._fits.items() if fit.all()]
        return whole[0] if len(whole) == 1 and not self.is_text else None

    def values(self, hint: Decimal | None, file: str) -> np.ndarray:
        whole = [sign for sign, fit in self._fits.items() if fit.all()]
        if not whole:
            raise self._odd_cell(hint, file)
        if len(whole) == 1:
            return self._read(whole[0])
        first, second = self._read(Decimal.POINT), self._read(Decimal.COMMA)
        differ = np.flatnonzero((first != second) & np.isfinite(first))
        if differ.size == 0:
            return first
        signs = {s for s in Decimal if any(s.value in self._cells[i] for i in differ)}
        if len(signs) == 1 and (hint in signs or (hint is None and signs == {Decimal.POINT})):
            return self._read(signs.pop())
        row = int(differ[0])
        raise InputError(
            f"'{quoted(self._cells[row])}' in column '{quoted(self.name)}', row {row + 1}, may be "
            f"{first[row]:.15g} or {second[row]:.15g}: commas and points can be read both as "
            "decimal signs and as grouping",
            file,
            "Write the numbers with a decimal point and without grouping",
        )

    def _odd_cell(self, hint: Decimal | None, file: str) -> InputError:
        fits = self._fits
        sign = hint or max(Decimal, key=lambda s: int(np.count_nonzero(fits[s])))
        row = int(np.flatnonzero(~fits[sign])[0])
        return InputError(
            f"column '{quoted(self.name)}' is not numeric: row {row + 1} holds "
            f"'{quoted(self._cells[row])}'",
            file,
            "Leave the cell empty where a sample is missing",
        )

    def _read(self, sign: Decimal) -> np.ndarray:
        text = pd.Series(np.where(self._missing, "nan", self._cells), dtype="string")
        if sign is Decimal.POINT:
            text = text.str.replace(",", "", regex=False)
        else:
            text = text.str.replace(".", "", regex=False).str.replace(",", ".", regex=False)
            infinite = self._known & ~self._missing
            text[infinite] = pd.Series(self._cells, dtype="string")[infinite]
        text = text.str.lower().str.replace("d", "e", regex=False)
        text = text.str.replace("1.#inf", "inf", regex=False)
        numbers = pd.Series(pd.to_numeric(text, errors="coerce"))
        return numbers.to_numpy(dtype=np.float64, na_value=np.nan)
