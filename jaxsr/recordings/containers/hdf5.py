"""HDF5 by h5py: vectors, and columns of matrices and tables, wherever they lie."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import h5py
import numpy as np

WIDEST = 64
"""Columns of a matrix that are still channels."""


def read(path: str) -> list[tuple[str, None, np.ndarray, str]]:
    """Return name, no time of its own, values and unit of every vector."""
    found: list[tuple[str, None, np.ndarray, str]] = []

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.size:
            found.extend((n, None, v, _unit(item)) for n, v in _vectors(name, item))

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    names = [name.rpartition("/")[2] for name, *_ in found]
    # By their own names, where those are different; else by their paths.
    if len(set(names)) == len(names):
        return [(n, None, v, u) for n, (_, _, v, u) in zip(names, found, strict=True)]
    return found


def _vectors(name: str, item: Any) -> Iterator[tuple[str, np.ndarray]]:
    if item.dtype.names:
        table = item[()]
        for column in item.dtype.names:
            if table[column].ndim == 1:
                yield f"{name}/{column}", table[column]
        return
    if item.dtype.kind not in "fiub":
        return
    values = np.squeeze(item[()])
    if values.ndim == 1:
        yield name, values
    elif values.ndim == 2:
        matrix = values if values.shape[0] >= values.shape[1] else values.T
        if matrix.shape[1] <= WIDEST:
            for k in range(matrix.shape[1]):
                yield f"{name}_{k + 1}", np.ascontiguousarray(matrix[:, k])


def _unit(item: Any) -> str:
    unit = item.attrs.get("unit", item.attrs.get("units", ""))
    unit = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit
    return unit if isinstance(unit, str) else ""
