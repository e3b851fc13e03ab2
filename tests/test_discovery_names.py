"""Columns with blanks, units and slashes in their names."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

import jaxsr
from jaxsr._arguments import split_names, split_pairs
from jaxsr._result import InputError
from jaxsr.cli import main
from jaxsr.discovery.naming import Naming, identifier
from jaxsr.evolution import SearchConfig
from jaxsr.expressions import is_identifier
from jaxsr.recordings import Recording

QUICK = SearchConfig(population=20, refined=2, generations=2, restarts=0, patience=2)
ANGLE, RATE, PUSH = "Angle/rad", "Rate, filtered (rad/s)", "Motor torque [Nm]"


def _table():
    t = np.linspace(0.0, 8.0, 200)
    q, v = np.exp(-0.1 * t) * np.sin(2.0 * t), np.zeros(200)
    v = np.exp(-0.1 * t) * (2.0 * np.cos(2.0 * t) - 0.1 * np.sin(2.0 * t))
    return t, {ANGLE: q, RATE: v, PUSH: np.sin(3.0 * t)}


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("a,b", ("a", "b")),
        ("Angle/rad, RPM (1/min)", ("Angle/rad", "RPM (1/min)")),
        ('"Rate, filtered (rad/s)",q', ("Rate, filtered (rad/s)", "q")),
        ('5" pipe', ('5" pipe',)),
    ],
)
def test_names_are_split_at_commas_outside_quotes(text, names):
    assert split_names(text, "--states") == names


def test_pairs_name_columns():
    assert split_pairs(['z1=Angle/rad,z2="a, b"', "u=c=d"], "--columns") == {
        "z1": "Angle/rad",
        "z2": "a, b",
        "u": "c=d",
    }
    assert split_pairs(None, "--columns") == {}
    for wrong in ("z1", "=a", "z1=", "z1=a,z1=b"):
        with pytest.raises(InputError, match="--columns"):
            split_pairs([wrong], "--columns")


@pytest.mark.parametrize(
    ("name", "symbol"),
    [
        ("Angle/rad", "Angle_rad"),
        ("RPM (1/min)", "RPM_1_min"),
        ("2nd mass", "x_2nd_mass"),
        ("sin", "sin_"),
        ("lambda", "lambda_"),
        ("φ", "phi"),
        ("ω_1 / s⁻¹", "omega_1_s_1"),
        ("Geschwindigkeit für A", "Geschwindigkeit_fur_A"),
        ("速度", "x"),
        ("", "x"),
    ],
)
def test_a_symbol_reads_like_its_column(name, symbol):
    assert identifier(name, set()) == symbol
    assert is_identifier(symbol)


def test_symbols_differ_where_columns_do():
    naming = Naming.of(["a b", "a/b", "a_b"])
    assert naming.symbols(["a b", "a/b", "a_b"]) == ("a_b_2", "a_b_3", "a_b")


def test_the_model_names_the_columns_and_runs_on_the_same_file():
    t, channels = _table()
    record = Recording("a", t, channels)
    found = jaxsr.discover(
        [record], states=["z1", RATE], inputs=[PUSH], columns={"z1": ANGLE}, config=QUICK, modes=1
    )
    rate, push = "Rate_filtered_rad_s", "Motor_torque_Nm"
    assert [e.state for e in found.equations] == ["z1", rate]
    assert found["z1"].expression == rate  # its integral is recognised
    assert found.columns == {"z1": ANGLE, rate: RATE, push: PUSH}
    assert found.to_dict()["columns"] == found.columns
    assert found.model.columns == {"z1_meas": ANGLE, f"{rate}_meas": RATE, push: PUSH}


def test_units_follow_their_columns_and_rates_are_read_by_their_own():
    t, channels = _table()
    record = Recording("a", t, {ANGLE: channels[ANGLE], f"d_{ANGLE}": channels[RATE]})
    found = jaxsr.discover([record], states=[ANGLE], order=2, config=QUICK, units={ANGLE: "rad"})
    assert found.model.units["Angle_rad"] == "rad"
    np.testing.assert_array_equal(found.samples.variables["d_Angle_rad"][:5], channels[RATE][:5])


def test_the_command_takes_names_and_says_what_stands_for_what(tmp_path, capsys):
    t, channels = _table()
    path = tmp_path / "run.csv"
    pd.DataFrame({"Time / s": t, **channels}).to_csv(path, index=False)
    words = ["discover", str(path), "--states", f'z1,"{RATE}"', "--columns", f"z1={ANGLE}"]
    words += ["--time", "Time / s", "--out", str(tmp_path / "out"), "--budget", "4", "--modes", "1"]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert f"z1 is column {ANGLE}" in told and "d(z1)/dt = Rate_filtered_rad_s" in told
    document = json.loads((tmp_path / "out" / "discovery.json").read_text())
    assert document["columns"]["z1"] == ANGLE
    text = (tmp_path / "out" / "model.toml").read_text()
    assert f'z1_meas = "{ANGLE}"' in text and 't = "Time / s"' in text
    table = tmp_path / "runs.csv"
    assert (
        main(["simulate", str(tmp_path / "out" / "model.toml"), str(path), "--out", str(table)])
        == 0
    )


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--states", "Angle/deg"], "no column 'Angle/deg'"),
        (["--states", "z1", "--columns", "z1=Angle"], "no column 'Angle'"),
        (["--states", "z1", "--columns", "z 1=Angle/rad"], "cannot stand in an expression"),
        (["--states", ANGLE, "--columns", "a=Angle/rad,b=Angle/rad"], "two names"),
        (["--states", ANGLE, "--inputs", "x"], "--columns x=COLUMN"),
    ],
)
def test_messages_name_the_options_of_discover(words, told, tmp_path, capsys):
    t, channels = _table()
    path = tmp_path / "run.csv"
    pd.DataFrame({"t": t, **channels}).to_csv(path, index=False)
    assert main(["discover", str(path), *words, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert told in error and "[columns]" not in error and error.count("\n") == 1


def test_a_file_without_time_is_told_of_the_option(tmp_path, capsys):
    path = tmp_path / "run.csv"
    pd.DataFrame({"a": np.arange(30.0) ** 2, "b": np.sin(np.arange(30.0))}).to_csv(
        path, index=False
    )
    assert main(["discover", str(path), "--states", "a", "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert "--time" in error and "sample_time" not in error
