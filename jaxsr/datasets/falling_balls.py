"""Falling balls: eleven sheets, two drops each, 42 to 58 samples at 15 Hz.

A few steps differ from 1/15 s (one half or one and a half of it, some 2 % longer), as upstream.
The upstream file is named ``.xls`` but is an Office Open XML workbook (a zip of XML). It holds
numbers and one header row, so the standard library reads it; its checksum is known.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import pandas as pd

_MAIN = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
_RELATION = "{http://schemas.openxmlformats.org/officeDocument/2006/relationships}"
_COLUMNS = ("drop", "time_s", "height_m", "velocity_m_s")


def convert(sources: Mapping[str, Path]) -> dict[str, pd.DataFrame]:
    """Return ``balls_<ball>_drop1.csv`` and ``balls_<ball>_drop2.csv`` for every ball.

    Parameters
    ----------
    sources : mapping of str to Path
        Upstream files by their path in the data set's folder.

    Returns
    -------
    dict of str to DataFrame
        Columns time_s, height_m, velocity_m_s, height upwards, as in the sheet.
    """
    tables = {}
    for sheet_name, sheet in _sheets(sources["Ball_drops_data.xls"]).items():
        ball = re.sub(r"\W+", "_", sheet_name.strip().lower())
        for drop, part in sheet.groupby("drop"):
            table = part.drop(columns="drop").reset_index(drop=True)
            tables[f"balls_{ball}_drop{int(float(str(drop)))}.csv"] = table
    return tables


def _sheets(path: Path) -> dict[str, pd.DataFrame]:
    with zipfile.ZipFile(path) as workbook:
        links = {
            link.attrib["Id"]: link.attrib["Target"]
            for link in ElementTree.fromstring(workbook.read("xl/_rels/workbook.xml.rels"))
        }
        book = ElementTree.fromstring(workbook.read("xl/workbook.xml"))
        return {
            sheet.attrib["name"]: _rows(
                workbook.read(f"xl/{links[sheet.attrib[f'{_RELATION}id']]}")
            )
            for sheet in book.iter(f"{_MAIN}sheet")
        }


def _rows(document: bytes) -> pd.DataFrame:
    """Return the numeric rows of one sheet, columns A to D, below its header."""
    rows = []
    for row in ElementTree.fromstring(document).iter(f"{_MAIN}row"):
        cells = {cell.attrib["r"][0]: cell for cell in row.iter(f"{_MAIN}c")}
        values = [_number(cells.get(letter)) for letter in "ABCD"]
        if all(value is not None for value in values):
            rows.append(values)
    return pd.DataFrame(rows, columns=list(_COLUMNS), dtype=float)


def _number(cell: ElementTree.Element | None) -> float | None:
    if cell is None or cell.attrib.get("t", "n") != "n":
        return None
    text = cell.findtext(f"{_MAIN}v")
    return None if text is None else float(text)
