"""Model files: round trips, units, edits, and errors that name file, key, symbol and remedy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from model_texts import EVERYTHING

from jaxsr._result import InputError
from jaxsr.models import (
    Edit,
    Model,
    Parameter,
    Simulator,
    apply_edit,
    difference,
    model_text,
    parse_model,
    read_model,
    write_model,
)
from jaxsr.models.field import Field, Point
from jaxsr.models.reading import build_model

SHIPPED = sorted((Path(__file__).resolve().parents[1] / "jaxsr" / "datasets").rglob("*.toml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_shipped_models_survive_writing(path: Path, tmp_path: Path) -> None:
    model = read_model(path)
    write_model(model, tmp_path / path.name)
    assert read_model(tmp_path / path.name) == model


def test_a_model_of_every_table_survives_writing() -> None:
    model = parse_model(EVERYTHING, "m.toml")
    text = model_text(model)
    again = parse_model(text, "m.toml")
    assert again == model
    assert model_text(again) == text
    assert again.per_recording["y0"]["a file.csv"] == 0.1
    assert again.columns["u"] == "motor force (N)"
    assert again.delays == {"u": 0.002, "y": "tau"}
    assert again.events[0].reset == {"v": "-0.8*v"}
    assert again.parameters["k"].value == 1e-300
    assert again.resolution == {"y": 1e-5}


def test_missing_and_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such model file"):
        read_model(tmp_path / "none.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="cannot be read"):
        read_model(tmp_path / "binary.toml")
    (tmp_path / "empty.toml").write_text("")
    with pytest.raises(InputError, match="no \\[model\\] table"):
        read_model(tmp_path / "empty.toml")


def forced(law: str) -> str:
    return EVERYTHING.replace("u - Fc*sign(v) - pull", law)


@pytest.mark.parametrize(
    "law",
    [
        "u*sin(2.0*t)",
        "u*sin(2.0*t + pi/3)",
        "u*sin(5.0*t - 0.1*q)",
        "u*exp(-(v/0.1)**2)",
        "u*sin(t/tau)",
        "u*cos(pi*q)",
        "u*sign(2.0*v - q)",
        "u*Heaviside(t - 1.0)",
    ],
)
def test_a_literal_factor_mends_the_dimension_of_an_argument(law: str) -> None:
    assert parse_model(forced(law)).equations["v"] == law


@pytest.mark.parametrize(
    "law",
    ["u*sin(q)", "u*sin(t)", "u*exp(-v)", "u*sin(q + t/tau)", "u*sin(t + 2.0)", "2.0*q", "u + q"],
)
def test_true_errors_of_dimension_remain(law: str) -> None:
    with pytest.raises(InputError, match="dimension"):
        parse_model(forced(law))


def test_without_units_nothing_is_checked() -> None:
    text = """
    [model]
    states = ["x"]
    outputs = ["y"]
    [equations]
    x = "sin(t) + t*x"
    [readings]
    y = "x"
    """
    assert parse_model(text).name == "model"


EDITS = [
    {"equations.v": "u - Fc*sign(v) - pull - c*v", "parameters.c": Parameter(0.5, "N*s/m", (0, 9))},
    {"parameters.M": Parameter(2.5, "kg", (1.0, 3.0))},
    {"readings.y": "1.1*q"},
    {"inertia.v.v": "M + 0.5"},
    {"delays.u": 0.0, "initial.q": "free", "clock.y": "1 + 2*s"},
    {
        "model.states": ("q", "v", "z", "h"),
        "equations.h": "(u - h)/tau",
        "initial.h": "free",
        "units.h": "N",
    },
]


@pytest.mark.parametrize("changes", EDITS, ids=lambda c: next(iter(c)))
def test_difference_is_the_inverse_of_apply(changes: dict) -> None:
    before = parse_model(EVERYTHING)
    after = apply_edit(before, Edit(changes))
    assert after != before
    assert dict(difference(before, after).changes) == changes
    assert apply_edit(before, difference(before, after)) == after
    assert parse_model(model_text(after)) == after
    assert difference(before, before).changes == {}


def test_an_edit_as_json_has_plain_values() -> None:
    plain = Edit(EDITS[0]).as_json()
    assert plain["parameters.c"] == {"value": 0.5, "unit": "N*s/m", "bounds": [0, 9]}
    assert Edit(EDITS[-1]).as_json()["model.states"] == ["q", "v", "z", "h"]


PYTHON = "def fall(t, x, u, p):\n    return [x[1], -p['g'] + u[0]]\n"
TABLE = """
[model]
base = "fall.py:fall"
states = ["q", "v"]
inputs = ["a"]
outputs = ["y"]
[additions]
v = "-c*v"
[readings]
y = "q"
[parameters]
g = 9.81
c = 0.5
"""


def test_a_python_simulator_is_loaded_only_when_named(tmp_path: Path) -> None:
    (tmp_path / "fall.py").write_text("import pathlib\n" + PYTHON)
    (tmp_path / "fall.toml").write_text(TABLE)
    simulator = Simulator.from_file(f"{tmp_path / 'fall.py'}:fall")
    rates = simulator.rates(0.0, (1.0, 4.0), (2.0,), simulator.values())
    assert [float(r) for r in rates] == pytest.approx([4.0, -9.81 + 2.0 - 2.0])
    assert parse_model(model_text(simulator.model)) == simulator.model
    (tmp_path / "fall.py").write_text("raise SystemExit('was run')\n")
    with pytest.raises(InputError, match=r"stands on Python .* Name it in the call"):
        Simulator.from_file(tmp_path / "fall.toml")


@pytest.mark.parametrize(
    ("name", "source", "message"),
    [
        ("fall.py:fell", PYTHON, "base is"),
        ("fall.py", PYTHON, "names no function"),
        ("none.py:fall", PYTHON, "no such Python file"),
        ("fall.py:fall", "x = 1\n", "has no function"),
        ("fall.py:fall", "1/0\n", "fails on import: ZeroDivisionError"),
    ],
)
def test_python_simulators_that_cannot_be_loaded(
    name: str, source: str, message: str, tmp_path: Path
) -> None:
    (tmp_path / "fall.py").write_text(source)
    (tmp_path / "fall.toml").write_text(TABLE)
    with pytest.raises(InputError, match=message):
        Simulator.from_file(str(tmp_path / name))


def test_models_compare_by_value() -> None:
    a, b = parse_model(EVERYTHING), parse_model(EVERYTHING)
    assert a == b and hash(a) == hash(b)
    assert isinstance(a, Model) and a != replace(a, inputs=())


def test_definitions_that_double_each_other_are_walked_once() -> None:
    # Written out, the last of them would have 2**60 symbols.
    doubled = {"d0": "sin(q)", **{f"d{k}": f"d{k - 1} + d{k - 1}" for k in range(1, 60)}}
    document = {
        "model": {"states": ["q"], "outputs": ["y"]},
        "definitions": doubled,
        "equations": {"q": "-r*d59 - Fc*sign(q)"},
        "readings": {"y": "d59"},
        "parameters": {name: {"value": 1.0, "unit": "1/s"} for name in ("r", "Fc")},
        "units": {"q": "rad"},
    }
    simulator = Simulator(build_model(document))
    assert simulator.model.equation_terms["q"].variables == {"q", "r", "Fc"}
    (rate,), (slopes,) = Field(simulator, [1.0, 0.0]).slopes(Point(0.0, [np.array([0.5])], []))
    np.testing.assert_allclose(rate, -(2.0**59) * np.sin(0.5))
    np.testing.assert_allclose(slopes["q"], -(2.0**59) * np.cos(0.5))
