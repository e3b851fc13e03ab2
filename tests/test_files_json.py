"""Checksums, and values as plain JSON."""

from __future__ import annotations

import enum
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxsr._files import (
    dump_json,
    sha256,
)


def test_checksum(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"abc" * 100_000)
    assert sha256(tmp_path / "x") == hashlib.sha256(b"abc" * 100_000).hexdigest()


class Colour(enum.StrEnum):
    RED = "red"


@dataclass(frozen=True)
class Point:
    x: float
    y: Any


def test_json_is_plain() -> None:
    obj = {
        "nan": float("nan"),
        "array": np.array([[1.0, np.nan], [np.inf, 2.0]]),
        "scalars": (np.float64(0.1), np.float32(0.5), np.int64(3), np.bool_(True), None),
        "point": Point(np.float64("-inf"), Colour.RED),
        "path": Path("a/b"),
        "set": {"b", "a"},
        "micro": "µ",
        1: "key",
    }
    assert json.loads(dump_json(obj), parse_constant=pytest.fail) == {
        "nan": None,
        "array": [[1.0, None], [None, 2.0]],
        "scalars": [0.1, 0.5, 3, True, None],
        "point": {"x": None, "y": "red"},
        "path": "a/b",
        "set": ["a", "b"],
        "micro": "µ",
        "1": "key",
    }
    with pytest.raises(TypeError, match="object"):
        dump_json([object()])
