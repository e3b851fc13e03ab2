"""How a table stands in a text: separator, preamble, header, units, first sample."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from jaxsr._result import InputError
from jaxsr.recordings.cells import Decimal, is_missing, is_number, readings, tidy
from jaxsr.recordings.dates import looks_like_clock
from jaxsr.recordings.table import quoted
from jaxsr.recordings.time_units import is_time_name, is_unit

HEAD_LINES = 400
HEAD_CHARACTERS = 200_000
HEAD_LINES_ALWAYS = 8
LOOKED_AT = 256
"""Cells of a line that tell its kind."""
LONGEST_CELL = 64
LONGEST_NAME = 1000
MOST_COLUMNS = 10_000
_COMMENT = re.compile(r"^\s*(?:#+|%+|//+|!+|\*+)\s*")
_SEPARATORS = (";", "\t", ",", "|", None)
_WORDS = {";": "semicolons", "\t": "tabs", "|": "bars", None: "blanks"}


@dataclass(frozen=True)
class Layout:
    """Where and how the samples stand.

    Attributes
    ----------
    separator : str or None
        None for blanks.
    names : tuple of str
        One a column, empty where the header has none.
    units : tuple of str
        One a column where a row of units stands under the header, else none.
    start : int
        Offset of the first sample in the text.
    line : int
        Lines before it.
    width : int
        Most cells of a line.
    decimal : Decimal or None
        What the first lines prove.
    said : tuple of str
        What is not plain.
    """

    separator: str | None
    names: tuple[str, ...]
    units: tuple[str, ...]
    start: int
    line: int
    width: int
    decimal: Decimal | None
    said: tuple[str, ...]


@dataclass(frozen=True)
class _Line:
    """A line of the head: its number, where it begins, its cells and of what kind they are."""

    index: int
    offset: int
    cells: tuple[str, ...]
    kinds: str  # n number, c clock, m missing, t text

    @property
    def has_samples(self) -> bool:
        return "n" in self.kinds or "c" in self.kinds

    @property
    def has_text(self) -> bool:
        return "t" in self.kinds


def find_layout(text: str, file: str) -> Layout:
    """Find the layout of a text.

    Parameters
    ----------
    text : str
        With plain line ends.
    file : str
        For messages.

    Raises
    ------
    InputError
        If there is no header, no sample, or more than one way to read it.
    """
    given, lines = _head(text, file)
    options = [_Option(lines, s, file) for s in ([given] if given else _SEPARATORS)]
    best = max(options, key=lambda option: option.score)
    if not best.score[0]:
        raise _no_samples(options[0], file)
    return best.layout(given is not None, file)


def _head(text: str, file: str) -> tuple[str | None, list[tuple[int, int, str]]]:
    """Return the separator that Excel's first line gives, and (number, offset, line)."""
    lines, offset, given = [], 0, None
    for index in range(HEAD_LINES):
        end = text.find("\n", offset)
        if end < 0 or (offset > HEAD_CHARACTERS and len(lines) > HEAD_LINES_ALWAYS):
            break
        line = text[offset:end]
        mark = re.fullmatch(r'"?sep=(.)"?[;,\t ]*', line[:20], re.IGNORECASE)
        if mark and not lines and given is None:
            given = mark.group(1)
        elif line.strip():
            lines.append((index, offset, line))
        offset = end + 1
    if not lines:
        raise InputError("a header but no samples", file, "Give at least 3 samples")
    return given, lines


class _Option:
    """The head of a text under one separator."""

    def __init__(
        self, lines: Sequence[tuple[int, int, str]], separator: str | None, file: str
    ) -> None:
        self.separator = separator
        self.lines = []
        for index, offset, line in lines:
            cells = split(line, separator, file)
            kinds = "".join(_kind(c) for c in cells[:LOOKED_AT])
            self.lines.append(_Line(index, offset, tuple(cells), kinds))
        self.first = self._first_sample()
        rows = [ln for ln in self.lines[self.first :] if ln.has_samples]
        self.width = _width([ln.cells for ln in rows])

    @property
    def score(self) -> tuple[float, ...]:
        """How well the lines read: cells that are numbers, columns, agreement with the header."""
        rows = [ln for ln in self.lines[self.first :] if ln.has_samples]
        if not rows:
            return (0.0, 0.0, 0.0)
        cells = sum(len(ln.kinds) for ln in rows)
        good = sum(ln.kinds.count("n") + ln.kinds.count("c") for ln in rows)
        empty = sum(ln.kinds.count("m") for ln in rows)
        share = round((good + 0.5 * empty) / cells, 1)
        header = self.lines[self.first - 1].cells if self.first else ()
        agrees = float(self.width > 1 and self.width == len(_full(header)))
        # blanks are what is left: between them an empty cell cannot be seen
        doubt = 0.5 if self.separator is None else 0.0
        return (1.0 + agrees + share - doubt, float(self.width > 1), float(good))

    def _first_sample(self) -> int:
        """Index of the first line of samples: after the last line of words above them."""
        first = 0
        for i, line in enumerate(self.lines):
            if line.has_samples or not line.has_text:
                continue
            above = self.lines[first:i]
            below = next((ln for ln in self.lines[i + 1 :] if ln.has_samples), None)
            if below is None:
                break
            if first and any(ln.kinds == below.kinds and ln.has_samples for ln in above):
                break  # a line of words among samples
            first = i + 1
        # a header of numbered channels (t, 1, 2) or units (s, 1) has a number, too
        if first < len(self.lines) - 2:
            line, then = self.lines[first], self.lines[first + 1 : first + 6]
            texts = [k for k, kind in enumerate(line.kinds) if kind == "t"]
            odd = texts and all(
                k < len(ln.kinds) and ln.kinds[k] in "ncm" for ln in then for k in texts
            )
            unit_row = all(is_unit(c) for c in line.cells)
            if odd and (first == 0 or unit_row):
                first += 1
        while first < len(self.lines) and not self.lines[first].has_samples:
            first += 1
        return first

    def layout(self, given: bool, file: str) -> Layout:
        above, names, units = self._header(file)
        rows = [ln for ln in self.lines[self.first :] if ln.has_samples]
        said = []
        if self.separator in _WORDS and self.width > 1 and not given:
            said.append(f"{_WORDS[self.separator]} between the columns")
        if above:
            said.append(f"{above} {'line' if above == 1 else 'lines'} above the header")
        if any(units):
            pairs = [f"{n} in {u}" for n, u in zip(names, units, strict=False) if n and u]
            said.append(f"a row of units ({quoted(', '.join(pairs), 80)})")
        decimal = _proven([c for ln in rows for c in ln.cells])
        width = max(len(names), max(len(ln.cells) for ln in rows))
        start = self.lines[self.first]
        return Layout(
            self.separator, names, units, start.offset, start.index, width, decimal, tuple(said)
        )

    def _header(self, file: str) -> tuple[int, tuple[str, ...], tuple[str, ...]]:
        above = self.lines[: self.first]
        if not above:
            raise InputError(
                "the first line holds numbers", file, "Give a header line of column names"
            )
        rows = [_names(ln, self.separator, self.width, file) for ln in above]
        fitting = [i for i, c in enumerate(rows) if self.width in (len(c), len(_full(c)))]
        last = fitting[-1] if fitting else len(rows) - 1
        units: tuple[str, ...] = ()
        before = [i for i in fitting if i < len(rows) - 1]
        if before and _are_units(rows[-1]) and len(_full(rows[-1])) <= self.width:
            units, last = tuple(rows[-1]), before[-1]
        names = rows[last]
        if max(map(len, names), default=0) > LONGEST_NAME:
            longest = max(map(len, names))
            raise InputError(
                f"a column's name has {longest} characters", file, "Check the header line"
            )
        _check_names(names, file)
        return last, tuple(names), units


def _width(rows: Sequence[Sequence[str]]) -> int:
    """Return how many columns rows have: those that any row fills, of the usual number of cells.

    A sensor of a lower rate leaves its column empty in most rows; separators at the end of every
    row make no columns.
    """
    counts = Counter(map(len, rows))
    usual = max(counts, key=lambda w: (counts[w], w), default=0)
    return max((len(_full(cells)) for cells in rows if len(cells) == usual), default=0)


def _are_units(cells: Sequence[str]) -> bool:
    """Return whether a row is one of units (s, deg or [s], [deg]) under a row of names."""
    if not any(cells) or any(is_time_name(c) for c in cells):
        return False
    return all(not c or is_unit(c) for c in cells)


def _check_names(names: Sequence[str], file: str) -> None:
    repeated = [n for n, count in Counter(n for n in names if n).items() if count > 1]
    if repeated:
        raise InputError(
            f"column '{quoted(repeated[0])}' appears twice", file, "Give each its own name"
        )


def split(line: str, separator: str | None, file: str) -> list[str]:
    """Return the cells of a line, without blanks around them."""
    if separator is None:
        return re.split(r"\s+(?![\[(])", line.strip())
    if len(line) - len(line.replace(separator, "")) >= MOST_COLUMNS:
        raise InputError(
            f"more than {MOST_COLUMNS} columns", file, "Keep the columns that are used"
        )
    if '"' not in line:
        return [cell.strip() for cell in line.split(separator)]
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]
    except (csv.Error, StopIteration) as error:
        raise InputError(f"not a table: {error}", file, "Check the quotes") from error


def _names(line: _Line, separator: str | None, width: int, file: str) -> list[str]:
    cells = list(line.cells)
    if cells:
        cells[0] = _COMMENT.sub("", cells[0])
        if separator is None and not cells[0] and len(_full(cells)) == width + 1:
            cells = cells[1:]  # a lone comment mark before the names
    return [c.strip().strip('"').strip() for c in cells]


def _full(cells: Sequence[str]) -> Sequence[str]:
    """Return the cells without empty ones at the end."""
    size = len(cells)
    while size and not cells[size - 1]:
        size -= 1
    return cells[:size]


def _kind(cell: str) -> str:
    cell = tidy(cell)
    if len(cell) > LONGEST_CELL:
        return "t"
    if is_missing(cell):
        return "m"
    if is_number(cell):
        return "n"
    return "c" if looks_like_clock(cell) else "t"


def _proven(cells: Sequence[str]) -> Decimal | None:
    """Return the decimal sign that the cells prove, if it is one."""
    found = set()
    for cell in map(tidy, cells):
        if "," in cell or "." in cell:
            signs = readings(cell)
            if len(signs) == 1:
                found |= signs
    return found.pop() if len(found) == 1 else None


def _no_samples(option: _Option, file: str) -> InputError:
    if len(option.lines) == 1:
        return InputError("a header but no samples", file, "Give at least 3 samples")
    line = option.lines[-1]
    return InputError(
        f"not a table: no line of numbers, line {line.index + 1} begins with "
        f"'{quoted(line.cells[0] if line.cells else '', 40)}'",
        file,
        "Give a header line and rows of numbers",
    )
