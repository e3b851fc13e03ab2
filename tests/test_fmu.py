"""FMUs: what their own code computes, what is drafted from them, and what is refused."""

from __future__ import annotations

import json
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
import pytest
from fmu_plants import recorded, slave_fmu

from benchmarks.fmu_plants import LAW, SLOPE, cart_fmu, compiler, description
from jaxsr._result import InputError
from jaxsr.cli import main
from jaxsr.expressions import evaluate, to_text
from jaxsr.models.field import Field, Point
from jaxsr.models.formats import unit_edits
from jaxsr.models.formats.fmu import BACKEND, Unit, read_fmu, unit_text
from jaxsr.models.model import Parameter
from jaxsr.models.native import process
from jaxsr.models.native.process import Native

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler on this machine")
GIVEN = "(F - 0.5*v - 8.0*q)/2.0"
CURVED = "V[2] = V[1]; V[3] = (V[4] - V[6]*V[1] - V[7]*V[0])/(V[5] + 0.2*cos(V[0]));"
"""A law of no library: the inertia changes with the position."""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("data"), GIVEN, count=120)


@pytest.fixture(scope="module")
def curved(tmp_path_factory: pytest.TempPathFactory, data: Path) -> Iterator[Unit]:
    unit = read_fmu(cart_fmu(tmp_path_factory.mktemp("curved"), CURVED), None, [data])
    yield unit
    unit.native.close()


@needs_compiler
@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_is_read_as_the_formulas_that_it_computes(
    tmp_path: Path, data: Path, version: int
) -> None:
    unit = read_fmu(cart_fmu(tmp_path, version=version), None, [data])
    unit.native.close()
    model = unit.simulator.model
    assert model.vector_field is not None
    rates = {s: to_text(r) for s, r in model.vector_field.rates.items()}
    assert rates == {"q": "v", "v": "(-k*q - c*v + F)/m"}
    assert to_text(model.term(model.entries("v")[0][1])) == "1.0/m"
    assert model.units == {"q": "m", "v": "m/s", "F": "N", "q_meas": "m"}
    assert model.parameters["c"].unit == "N*s/m"
    # tunable parameters are free, fixed ones are not
    assert model.free_parameters == ("m", "c")
    assert 'base = "plant.fmu"' in unit.drafted and "lies on a line" in unit.drafted


@needs_compiler
def test_what_is_no_formula_is_asked_with_its_slopes(curved: Unit) -> None:
    model = curved.simulator.model
    field = Field(curved.simulator, curved.simulator.values(), active=("m", "k"))
    rng = np.random.default_rng(0)
    q, v, force = rng.normal(size=(3, 40))
    value, rows = field.slopes(Point(np.zeros(40), [q, v], [force]))
    inertia = 2.0 + 0.2 * np.cos(q)
    rate = (force - 0.5 * v - 8.0 * q) / inertia
    assert value[1] == pytest.approx(rate, rel=1e-12)
    assert rows[1]["q"] == pytest.approx((-8.0 + 0.2 * np.sin(q) * rate) / inertia, rel=1e-6)
    assert rows[1]["m"] == pytest.approx(-rate / inertia, rel=1e-6)
    # k is fixed to the FMU, which is initialised anew for another value
    assert rows[1]["k"] == pytest.approx(-q / inertia, rel=1e-6, abs=1e-9)
    # a force enters beside the input, in its unit, by a gain that depends on q and m alone
    gain = model.term("v_per_F")
    assert gain.variables == {"q", "m"}
    own = evaluate(gain, {"q": q, "m": 2.0})
    assert own == pytest.approx(1.0 / inertia, rel=1e-8)


@needs_compiler
def test_jax_asks_the_same(curved: Unit) -> None:
    simulator = curved.simulator
    x, u = (np.array([0.3, -0.2]), np.array([0.5, 1.0])), (np.array([1.0, 2.0]),)
    theta = simulator.values()
    with jax.enable_x64(True):
        rates = simulator.rates(0.0, x, u, theta)
        by_v = jax.jvp(
            lambda v: simulator.rates(0.0, (x[0], v), u, theta)[1], (x[1],), (np.ones(2),)
        )[1]
    plain = Field(simulator, theta).rates(Point(np.zeros(2), list(x), list(u)))
    assert np.asarray(rates[1]) == pytest.approx(plain[1], rel=1e-12)
    assert np.asarray(by_v) == pytest.approx(-0.5 / (2.0 + 0.2 * np.cos(x[0])), rel=1e-6)


@needs_compiler
def test_directional_derivatives_are_taken_where_they_are_given(tmp_path: Path, data: Path) -> None:
    slope = "(x[j] == 0 ? -77.0 : x[j] == 1 ? -V[6]/V[5] : 1.0/V[5])"
    unit = read_fmu(cart_fmu(tmp_path, CURVED, slope=slope), None, [data])
    _, rows = Field(unit.simulator, unit.simulator.values()).slopes(
        Point(np.zeros(1), [np.ones(1), np.zeros(1)], [np.zeros(1)])
    )
    unit.native.close()
    assert rows[1]["q"] == -77.0  # what the FMU says, right or wrong
    assert SLOPE.startswith("(x[j] == 0")


@needs_compiler
def test_a_parameter_of_the_fmu_changes_its_rates(tmp_path: Path) -> None:
    native = Native(BACKEND, cart_fmu(tmp_path), {})
    told = {"states": ["q", "v"], "inputs": ["F"], "outputs": [], "parameters": ["m", "k"]}
    native.choose(2, np.ones(6), **told)
    rows = np.array([[0, 0.1, 0.2, 1, 2, 8], [0, 0.1, 0.2, 1, 4, 8], [0, 0.1, 0.2, 1, 4, 0]], float)
    found = native.rates(rows)
    native.close()
    assert found[:, 1] == pytest.approx([0.05, 0.025, 0.225])


@pytest.mark.long
@needs_compiler
@pytest.mark.parametrize(
    ("law", "what"),
    [
        (LAW + "if (V[0] > 1e6) for (;;) V[3] += 1e-9;", "does not answer within"),
        (LAW + "if (V[0] > 1e6) abort();", "ended while it ran"),
        (LAW + 'if (V[0] > 1e6) { printf("noise"); fflush(stdout); }', ""),
    ],
)
def test_code_that_hangs_dies_or_prints(tmp_path: Path, law: str, what: str) -> None:
    native = Native(
        BACKEND, cart_fmu(tmp_path, "extern int printf(); extern void *stdout;" + law), {}
    )
    native._seconds = 1.0
    told = {"states": ["q", "v"], "inputs": ["F"], "outputs": [], "parameters": []}
    native.choose(2, np.ones(4), **told)
    assert np.isfinite(native.rates(np.zeros((1, 4)))).all()
    bad = np.array([[0.0, 1e7, 0.0, 0.0]])
    if not what:
        assert np.isfinite(native.rates(bad)).all()
        native.close()
        return
    for _ in range(2):  # and it stays so
        with pytest.raises(InputError, match=what):
            native.rates(bad)
    assert native._process.poll() is not None


@pytest.mark.long
@needs_compiler
@pytest.mark.parametrize(
    ("change", "what"),
    [
        ("zip", "is no FMU: not a ZIP archive"),
        ("description", "has no readable modelDescription.xml"),
        ("version", "is FMI 1.0"),
        ("binary", "holds no binary for linux64 (win64)"),
        ("column", "no column is input 'F' (columns: q, push; names:"),
        ("sidecar", "[model] base is not plant.fmu"),
        ("states", "states are q; plant.fmu has q, v"),
    ],
)
def test_what_is_refused_is_said_in_one_line(
    tmp_path: Path, data: Path, capsys: pytest.CaptureFixture[str], change: str, what: str
) -> None:
    path, table = tmp_path / "plant.fmu", tmp_path / "plant.toml"
    if change in ("column", "states"):
        cart_fmu(tmp_path)
    else:
        with zipfile.ZipFile(path, "w") as archive:
            text = description(2, False, "plant")
            text = text.replace('"2.0"', '"1.0"') if change == "version" else text
            archive.writestr("modelDescription.xml", "<" if change == "description" else text)
            archive.writestr("binaries/win64/plant.dll", "")
    if change == "zip":
        path.write_text("no archive")
    if change == "column":
        data = tmp_path / "b.csv"
        data.write_text("t,q,push\n0,0,1\n1,0,1\n2,1,1\n")
    head = '[model]\nbase = "BASE"\nstates = ["q"]\noutputs = ["y"]\n[readings]\ny = "q"\n'
    if change in ("sidecar", "states"):
        table.write_text(head.replace("BASE", "plant.fmu" if change == "states" else "other.fmu"))
    assert main(["diagnose", str(path), str(data), "--out", str(tmp_path / "out")]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert what in lines[-1] and not any("Traceback" in line for line in lines)


@needs_compiler
def test_a_run_is_that_of_the_formulas(tmp_path: Path, data: Path) -> None:
    plant, out = cart_fmu(tmp_path), tmp_path / "run.csv"
    assert main(["simulate", str(plant), str(data), "--out", str(out)]) == 0
    run, record = pd.read_csv(out), pd.read_csv(data)
    assert (tmp_path / "plant.toml").is_file()
    assert run["q"].to_numpy() == pytest.approx(record["q"].to_numpy(), abs=2e-3)


@needs_compiler
def test_what_was_found_is_written_and_runs(tmp_path: Path, data: Path) -> None:
    unit = read_fmu(cart_fmu(tmp_path), None, [data])
    given = replace(unit.simulator.model, initial={"q": 0.1, "v": 0.0})
    parameters = {**given.parameters, "m": Parameter(2.5, "kg", (0.2, 20.0)), "Fc": Parameter(1.5)}
    found = {"parameters": parameters, "additions": {"v": "(1.0/m)*(-Fc*sign(v))"}}
    explained = replace(given, **found)
    files, said = unit_edits.edited_unit(unit, given, explained)
    unit.native.close()
    tree = ElementTree.fromstring(files["explained.ssv"])
    told = {p.attrib["name"]: p[0].attrib["value"] for p in tree[0]}
    assert told == {"m": "2.5"} and any("m = 2.5" in line for line in said)
    (tmp_path / "explained.py").write_text(files["explained.py"])
    command = [sys.executable, "explained.py", str(data), "run.csv"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    own = pd.read_csv(tmp_path / "run.csv")
    from jaxsr import Simulator, read_recording
    from jaxsr.models import parse_model
    from jaxsr.models.simulation import simulate_to_csv

    law = "(F - 0.5*v - 8.0*q - 1.5*sign(v))/2.5"
    from fmu_plants import CART

    same = parse_model(CART.replace("LAW", law))
    run = simulate_to_csv(Simulator(same), read_recording(data))
    assert own["q"].to_numpy() == pytest.approx(run["y"].to_numpy(), abs=2e-3)


def test_units_of_modelica_are_read() -> None:
    assert unit_text("N.m.s/rad") == "N*m*s/rad"
    assert unit_text("kg.m2") == "kg*m^2"
    assert unit_text("m/s2") == "m/s^2"
    assert unit_text("no such unit") is None and unit_text("") is None


@pytest.mark.long
def test_co_simulation_is_known_by_its_steps(tmp_path: Path, data: Path) -> None:
    unit = read_fmu(slave_fmu(tmp_path), None, [data])
    model = unit.simulator.model
    q, v, force = np.random.default_rng(1).normal(size=(3, 5))
    rate = evaluate(
        model.equation_terms["v"],
        {"q": q, "v": v, "F": force, "m": 2.0, "c": 0.5, "k": 8.0},
    )
    unit.native.close()
    # by Euler's steps of 2 ms: true to their length
    assert rate == pytest.approx((force - 0.5 * v - 8.0 * q) / 2.0, abs=0.02)
    assert to_text(model.equation_terms["q"]) == "v"
    assert model.input_hold == "zero"


def test_co_simulation_with_a_memory_that_cannot_be_set_is_refused(
    tmp_path: Path, data: Path
) -> None:
    after = "self.z += step_size * (self.F - self.z)"
    plant = slave_fmu(tmp_path, " + self.z", "self.z = 0.0", after)
    with pytest.raises(InputError, match="has states beside q, v that cannot be set"):
        read_fmu(plant, None, [data])


def test_processes_end_with_their_owner(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a ZIP archive"):
        (tmp_path / "a.fmu").write_text("x")
        Native(BACKEND, tmp_path / "a.fmu", {})
    assert all(n._process.poll() is not None or n.about for n in list(process._ALIVE))


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "verdict", "mechanism", "value"),
    [
        ("(F - 0.5*v - 8.0*q - 1.5*sign(v))/2.0", "structure", "coulomb_friction", 1.5),
        ("(F - 0.5*v - 8.0*q)/3.0", "parameter", "wrong_value", 3.0),
        (GIVEN, "nothing", "", 0.0),
    ],
)
def test_a_planted_effect_is_found_in_an_fmu(
    tmp_path: Path, law: str, verdict: str, mechanism: str, value: float
) -> None:
    document = _answered(cart_fmu(tmp_path), tmp_path, law)
    assert document["verdict"] == verdict
    if not mechanism:
        assert not document["findings"]
        return
    (finding,) = document["findings"]
    assert finding["mechanism"] == mechanism
    name = "Fc" if mechanism == "coulomb_friction" else "m"
    assert finding["parameters"][name]["value"] == pytest.approx(value, rel=0.05)
    assert finding["parameters"][name]["unit"] == ("N" if name == "Fc" else "kg")
    assert (tmp_path / "out" / ("explained.py" if name == "Fc" else "explained.ssv")).is_file()


def _answered(plant: Path, folder: Path, law: str, count: int = 500) -> dict[str, Any]:
    """Diagnose an FMU on a recording of a law, and return the document in ``folder/out``."""
    train = recorded(folder, law, count=count)
    other = recorded(folder, law, "b.csv", seed=1, count=count)
    out = folder / "out"
    command = ["diagnose", str(plant), str(train), "--held-out", str(other), "--out", str(out)]
    assert main([*command, "--budget", "240"]) == 0
    return json.loads((out / "diagnosis.json").read_text())
