"""What is written as a model file is TOML, and reads back as the same model."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxsr._result import InputError
from jaxsr.models import Parameter, model_text, parse_model
from jaxsr.models.reading import build_model

NAMES = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,8}", fullmatch=True).map(lambda n: f"{n}_")
# Everything that text of Unicode can be: control characters, marks of direction, other planes.
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=12).filter(str.strip)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
POSITIVE = st.floats(min_value=1e-300, max_value=1e300)
UNITS = st.sampled_from(["m", "kg*m^2", "N·m", "1", "m/s**2", "°C"])


@st.composite
def documents(draw: st.DrawFn) -> dict[str, Any]:
    """Draw the tables of a model whose names are drawn, without any that clash."""
    names = draw(st.lists(NAMES, min_size=6, max_size=6, unique_by=str.lower))
    q, v, u, p, d, y = names
    low, value, high = sorted(draw(st.lists(NUMBERS, min_size=3, max_size=3, unique=True)))
    files = draw(st.dictionaries(TEXTS, NUMBERS, min_size=1, max_size=3))
    whole = {
        "model": {"name": draw(TEXTS), "states": [q, v], "inputs": [u], "outputs": [y]},
        "definitions": {d: f"{q} - {u}"},
        "equations": {q: v, v: f"{u} - {p}*{d}"},
        "readings": {y: f"{q} + 0.5"},
        "parameters": {p: {"value": value, "bounds": [low, high]}},
        "per_recording": {p: files},
        "initial": {q: draw(NUMBERS | st.integers(-5, 5)), v: "free"},
        "delays": {u: draw(POSITIVE)},
        "clock": {y: "1.0 + 1e-6"},
        "noise": {y: draw(POSITIVE)},
        "resolution": {y: draw(POSITIVE)},
        "events": [{"when": q, "direction": draw(st.integers(-1, 1)), "reset": {v: f"-{v}"}}],
        "units": {draw(st.sampled_from([p, d])): draw(UNITS)},
        "columns": {draw(st.sampled_from([q, u, y])): draw(TEXTS)},
    }
    needed = ("model", "definitions", "equations", "readings", "parameters")
    left_out = draw(st.sets(st.sampled_from([name for name in whole if name not in needed])))
    return {name: table for name, table in whole.items() if name not in left_out}


@settings(max_examples=60, deadline=None, derandomize=True)
@given(documents())
def test_a_written_model_reads_back(document: dict[str, Any]) -> None:
    model = build_model(document, "m.toml")
    text = model_text(model)
    tomllib.loads(text)
    again = parse_model(text, "m.toml")
    assert again == model
    assert model_text(again) == text


MODEL = build_model(
    {
        "model": {"states": ["q"], "outputs": ["y"]},
        "equations": {"q": "-q"},
        "readings": {"y": "q"},
        "parameters": {"m": 1.0},
    }
)


def test_names_of_other_planes_are_written_as_they_are() -> None:
    model = replace(
        MODEL, columns={"y": "\U0001d42f"}, per_recording={"m": {"\U0001f642.csv": 1.0}}
    )
    assert parse_model(model_text(model)) == model
    control = replace(MODEL, name="a\x7fb\x00c\x85\u2028d", per_recording={"m": {"\x7f": 1.0}})
    assert parse_model(model_text(control)) == control


def test_numbers_of_other_types_are_written_as_numbers() -> None:
    initial = {"q": np.float32(0.5)}
    parameters = {"m": Parameter(np.int64(3), None, (np.float64(1.0), np.int32(4)))}  # type: ignore[arg-type]
    again = parse_model(model_text(replace(MODEL, initial=initial, parameters=parameters)))
    assert again.initial == {"q": 0.5}
    assert again.parameters["m"] == Parameter(3.0, None, (1.0, 4.0))


def test_a_unit_that_is_empty_is_written_as_dimensionless() -> None:
    model = replace(MODEL, units={"y": ""}, parameters={"m": Parameter(1.0, " ")})
    again = parse_model(model_text(model))
    assert again.units == {"y": "1"} and again.parameters["m"].unit == "1"


def test_half_a_character_cannot_be_written() -> None:
    # A file's name whose bytes are no text comes to Python so.
    with pytest.raises(InputError, match=r"no text file can\. Rename"):
        model_text(replace(MODEL, per_recording={"m": {"run\udce9.csv": 1.0}}))
