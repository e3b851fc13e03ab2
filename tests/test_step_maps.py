"""Step functions: the flow through their steps, which functions they are, and what is refused."""

from __future__ import annotations

import importlib.util
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from jaxsr._result import InputError
from jaxsr.cli import main
from jaxsr.expressions import evaluate, to_text
from jaxsr.models.formats import unit_edits
from jaxsr.models.formats.step_map import is_step, read_steps
from jaxsr.models.model import Parameter

EXACT = """
import math


def step(x, u, p):
    # a damped turn and decay whose flow is known, over {h} s
    c, s = math.cos(2.0 * {h}), math.sin(2.0 * {h})
    fade = math.exp(-p["d"] * {h})
    return [fade * (c * x[0] + s * x[1]), fade * (c * x[1] - s * x[0])]


def field(t, x, u, p):
    return x


def short(x, u):
    return x


def wrong(x, u, p):
    return [x[0]]


def broken(x, u, p):
    return x[7]
"""
TABLE = """
[model]
base = "m.py:{name}"
sample_time = {h}
states = ["a", "b"]
outputs = ["y"]
[readings]
y = "a"
[parameters]
d = {{ value = 0.3, bounds = [0.0, 1.0] }}
[initial]
a = 1.0
b = 0.0
"""
CART = """
def step(x, u, p):
    q, v = x
    v = v + 0.01 * (u[0] - p["c"] * v - p["k"] * q) / p["m"]
    return [q + 0.01 * v, v]
"""
CART_TABLE = """
[model]
base = "m.py:step"
sample_time = 0.01
states = ["q", "v"]
inputs = ["F"]
outputs = ["q_meas"]
input_hold = "zero"
[readings]
q_meas = "q"
[parameters]
m = { value = 2.0, bounds = [1.0, 4.0] }
c = { value = 0.5, bounds = [0.0, 5.0] }
k = { value = 8.0, bounds = [1.0, 20.0] }
[initial]
q = 0.1
v = 0.0
"""


def written(folder: Path, text: str, table: str) -> str:
    (folder / "m.py").write_text(text)
    (folder / "m.toml").write_text(table)
    return f"{folder / 'm.py'}:step"


def test_rates_of_steps_are_those_of_their_flow_to_the_third_order(tmp_path: Path) -> None:
    errors = []
    a, b = np.random.default_rng(0).normal(size=(2, 20))
    for h in (0.02, 0.01):
        unit = read_steps(written(tmp_path, EXACT.format(h=h), TABLE.format(name="step", h=h)))
        terms, at = unit.simulator.model.equation_terms, {"a": a, "b": b, "d": 0.3}
        found = np.array([evaluate(terms[s], at) for s in ("a", "b")])
        truth = np.array([-0.3 * a + 2.0 * b, -0.3 * b - 2.0 * a])
        errors.append(np.sqrt(np.mean((found - truth) ** 2)))
        unit.native.close()
    assert errors[0] < 1e-4 and 2.8 < np.log2(errors[0] / errors[1]) < 3.2


def test_euler_s_steps_are_read_as_the_law_that_they_go_along(tmp_path: Path) -> None:
    unit = read_steps(written(tmp_path, CART, CART_TABLE))
    unit.native.close()
    assert to_text(unit.simulator.model.equation_terms["v"]) == "(-k*q - c*v + F)/m"
    (row,) = unit.checks
    assert row["check"] == "time_step" and "steps of 0.01 s differ" in row["message"]


def test_pairs_are_seen_and_forces_enter_beside_the_input(tmp_path: Path) -> None:
    twice = CART.replace("def step", "def half").replace("0.01", "0.005")
    twice += "\n\ndef step(x, u, p):\n    return half(half(x, u, p), u, p)\n"
    unit = read_steps(written(tmp_path, twice, CART_TABLE))
    model = unit.simulator.model
    unit.native.close()
    assert to_text(model.equation_terms["q"]) == "v" and not unit.checks
    assert model.vector_field is not None and model.vector_field.columns["v"].beside == "F"


def test_a_step_function_is_told_by_its_arguments(tmp_path: Path) -> None:
    path = tmp_path / "m.py"
    path.write_text(EXACT.format(h=0.01) + "from somewhere import step as other\n")
    assert is_step(f"{path}:step") and is_step(f"{path}:short")
    assert not is_step(f"{path}:field") and not is_step(f"{path}:other")
    assert not is_step("model.toml")


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("wrong", "returns states of shape (1,), for 2 of them"),
        ("broken", "raises IndexError"),
    ],
)
def test_functions_that_are_none_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, what: str
) -> None:
    model = written(tmp_path, EXACT.format(h=0.01), TABLE.format(name=name, h=0.01))
    model = model.replace(":step", f":{name}")
    data = tmp_path / "a.csv"
    data.write_text("t,y\n0,1\n0.01,1\n0.02,2\n")
    assert main(["diagnose", model, str(data), "--out", str(tmp_path / "out")]) == 2
    assert what in capsys.readouterr().err.strip().splitlines()[-1]


def test_a_file_without_a_table_or_a_step_is_refused(tmp_path: Path) -> None:
    model = written(tmp_path, EXACT.format(h=0.01), TABLE.format(name="step", h=0.01))
    (tmp_path / "m.toml").write_text(TABLE.format(name="step", h=1).replace("sample_time = 1", ""))
    with pytest.raises(InputError, match="does not say how long a step is"):
        read_steps(model)
    (tmp_path / "m.toml").unlink()
    with pytest.raises(InputError, match="no table of states and parameters"):
        read_steps(model)


def test_a_run_is_the_function_s_own(tmp_path: Path) -> None:
    model = written(tmp_path, CART, CART_TABLE)
    time = np.arange(60) * 0.02  # two steps a sample
    force = np.sin(3.0 * time)
    pd.DataFrame({"t": time, "F": force}).to_csv(tmp_path / "a.csv", index=False)
    out = tmp_path / "run.csv"
    assert main(["simulate", model, str(tmp_path / "a.csv"), "--out", str(out)]) == 0
    q, v, own = 0.1, 0.0, []
    for u in force:
        own.append(q)
        for _ in range(2):
            v += 0.01 * (u - 0.5 * v - 8.0 * q) / 2.0
            q += 0.01 * v
    assert pd.read_csv(out)["q_meas"].to_numpy() == pytest.approx(own, rel=1e-12, abs=1e-15)


def test_what_was_found_is_a_step_function_again(tmp_path: Path) -> None:
    unit = read_steps(written(tmp_path, CART, CART_TABLE))
    given = unit.simulator.model
    parameters = {**given.parameters, "Fc": Parameter(1.5), "c": Parameter(0.7, None, (0.0, 5.0))}
    explained = replace(given, parameters=parameters, additions={"v": "-Fc*sign(v)"})
    files, said = unit_edits.edited_unit(unit, given, explained)
    unit.native.close()
    assert list(files) == ["explained.py"] and any("runs m.py" in line for line in said)
    (tmp_path / "explained.py").write_text(files["explained.py"])
    spec = importlib.util.spec_from_file_location("explained", tmp_path / "explained.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    q, v = module.step(np.array([0.1, 0.3]), np.array([1.0]))
    own = 0.3 + 0.01 * (1.0 - 0.7 * 0.3 - 8.0 * 0.1) / 2.0
    assert v == pytest.approx(own - 0.01 * 1.5) and q == pytest.approx(0.1 + 0.01 * own)


@pytest.mark.slow
def test_a_planted_effect_is_found_in_a_step_function(tmp_path: Path) -> None:
    model, out = written(tmp_path, CART, CART_TABLE.replace("q = 0.1\nv = 0.0", "")), tmp_path / "d"
    rng, time = np.random.default_rng(0), np.arange(500) * 0.02
    force = np.sum([4.0 * np.sin(w * time + w) for w in (0.7, 1.3, 2.1, 3.3, 5.1)], axis=0)
    q, v, own = 0.1, 0.0, []
    for u in force:
        own.append(q)
        for _ in range(2):
            v += 0.01 * (u - 0.5 * v - 8.0 * q - 1.5 * np.sign(v)) / 2.0
            q += 0.01 * v
    y = np.array(own) + 2e-4 * rng.normal(size=time.size)
    data = tmp_path / "a.csv"
    pd.DataFrame({"t": time, "F": force, "q_meas": y}).to_csv(data, index=False)
    assert main(["diagnose", model, str(data), "--out", str(out), "--budget", "240"]) == 0
    document = json.loads((out / "diagnosis.json").read_text())
    assert document["verdict"] == "structure"
    assert document["findings"][0]["mechanism"] == "coulomb_friction"
    assert document["findings"][0]["parameters"]["Fc"]["value"] == pytest.approx(1.5, rel=0.1)
    assert (out / "explained.py").is_file()
