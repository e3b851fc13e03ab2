"""The bundled demo recordings: their form, that they tell nothing, and that they can be remade."""

import importlib.util
import json
import sys
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

ROOT = Path(__file__).resolve().parent.parent
DEMO = ROOT / "jaxsr" / "datasets" / "demo"
TRUTH = json.loads((ROOT / "benchmarks" / "demo_truth.json").read_text())
SETS = sorted(TRUTH["sets"])
FILES = [f"{name}_{part}" for name in SETS for part in ("train", "validation")]
COLUMNS = ["time_s", "encoder1_rad", "encoder2_rad", "torque1_Nm", "torque2_Nm"]


def read(name: str) -> pd.DataFrame:
    return pd.read_csv(DEMO / f"{name}.csv")


@pytest.fixture(scope="module")
def make_demo():
    """Import the making script, which needs MuJoCo."""
    pytest.importorskip("mujoco", reason="needs MuJoCo (the extra `mujoco`)")
    path = ROOT / "benchmarks" / "make_demo.py"
    spec = importlib.util.spec_from_file_location("make_demo", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["make_demo"] = module  # dataclasses look their module up by name
    spec.loader.exec_module(module)
    yield module
    del sys.modules["make_demo"]


def test_folder_holds_the_model_and_eight_small_files():
    assert {p.name for p in DEMO.iterdir()} == {"arm.toml", *(f"{n}.csv" for n in FILES)}
    assert sum(p.stat().st_size for p in DEMO.iterdir()) < 1_000_000


@pytest.mark.parametrize("name", FILES)
def test_recording_is_complete_and_uniform(name):
    table = read(name)
    assert list(table.columns) == COLUMNS
    assert np.isfinite(table.to_numpy()).all()
    # Times are written with two decimals: a step is exact to the rounding of a double.
    np.testing.assert_allclose(np.diff(table["time_s"]), 0.01, atol=1e-9)
    assert table["time_s"].iloc[0] == 0.0


@pytest.mark.parametrize("name", FILES)
def test_encoders_read_whole_counts(name):
    step = TRUTH["sensors"]["quantisation_rad"]
    counts = read(name)[["encoder1_rad", "encoder2_rad"]].to_numpy() / step
    # Six decimals of a step of 7.7e-4 rad: counts are whole to 7e-4.
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-3)


@pytest.mark.parametrize("name", FILES)
def test_motion_is_wide_and_reverses_often(name):
    table = read(name)
    for column in ("encoder1_rad", "encoder2_rad"):
        q = table[column].to_numpy()
        assert np.ptp(q) > 2.0
        # Differences over 0.1 s, far above noise and step.
        direction = np.sign(q[10:] - q[:-10])
        assert np.sum(np.abs(np.diff(direction[direction != 0])) == 2) >= 10


def test_experiments_differ():
    torques = [read(n)["torque1_Nm"].to_numpy()[:900] for n in FILES]
    correlation = np.corrcoef(torques) - np.eye(len(FILES))
    assert np.abs(correlation).max() < 0.9


def test_model_file_is_the_true_arm():
    given = tomllib.loads((DEMO / "arm.toml").read_text())["parameters"]
    assert set(given) == set(TRUTH["model_parameters"])
    for name, value in TRUTH["model_parameters"].items():
        # The noise lets 20 s of data tell about 1e-4 of a parameter.
        assert given[name]["value"] == pytest.approx(value, rel=1e-6)
        low, high = given[name]["bounds"]
        assert low < value < high


def test_model_file_reads_every_column():
    tables = tomllib.loads((DEMO / "arm.toml").read_text())
    roles = ["t", *tables["model"]["inputs"], *tables["model"]["outputs"]]
    assert sorted(tables["columns"][r] for r in roles) == sorted(COLUMNS)
    assert tables["model"]["input_hold"] == "zero"


def test_nothing_in_the_package_tells_the_effects():
    told = {"coulomb", "dry friction", "frictionloss", "stiffness", "spring", "coupling", "drag"}
    told |= {e["mechanism"] for e in TRUTH["sets"].values() if e["mechanism"]}
    for path in DEMO.iterdir():
        text = (path.name + path.read_text()).lower()
        assert not [word for word in told if word in text], path.name
    # The truth stays outside: no module may open it.
    for path in (ROOT / "jaxsr").rglob("*.py"):
        assert "demo_truth" not in path.read_text(), path


def test_truth_names_one_effect_at_most():
    assert [TRUTH["sets"][s]["verdict"] for s in SETS] == ["structure"] * 3 + ["nothing"]
    for effect in TRUTH["sets"].values():
        assert len(effect["parameters"]) == (effect["mechanism"] is not None)


@pytest.mark.parametrize("name", SETS)
def test_effect_is_visible_yet_moderate(make_demo, name):
    """The concealed force is 5 to 30 % of a joint's rms torque where it acts."""
    effect = make_demo.EFFECTS[name]
    if effect is None:
        return
    table = read(f"{name}_train")
    q = table[["encoder1_rad", "encoder2_rad"]].to_numpy()
    # Rates over 0.06 s: noise of about 0.01 rad/s against rates of some rad/s.
    w = (q[6:] - q[:-6]) / 0.06
    force = np.array([effect.force(*x) for x in zip(q[3:-3], w, strict=True)])
    torque = table[["torque1_Nm", "torque2_Nm"]].to_numpy()
    share = np.sqrt(np.mean(force**2, axis=0) / np.mean(torque**2, axis=0))
    acting = share[share > 0]
    assert len(acting) == len(effect.sites)
    assert np.all((acting > 0.05) & (acting < 0.30))


@pytest.mark.slow
def test_remaking_gives_the_committed_files(make_demo, tmp_path):
    make_demo.write_recordings(make_demo.make_runs(make_demo.Arm()), tmp_path)
    for name in FILES:
        remade = pd.read_csv(tmp_path / f"{name}.csv")
        # Another processor or MuJoCo may turn a rounding: one encoder count, a few 1e-4 N m.
        difference = np.abs(remade - read(name)).max()
        assert difference[["encoder1_rad", "encoder2_rad"]].max() < 8e-4, name
        assert difference[["torque1_Nm", "torque2_Nm"]].max() < 2e-3, name
        assert difference["time_s"] == 0.0


@pytest.mark.slow
def test_model_file_and_effect_reproduce_mujoco(make_demo):
    """arm.toml plus the true force, integrated by SciPy, follows MuJoCo below the noise."""
    made = make_demo.make_runs(make_demo.Arm())
    errors = make_demo.verify({k: v for k, v in made.items() if k.endswith("validation")})
    # A tenth of the readings' noise; a wrong sign or term gives 1e-2 rad and more.
    assert max(errors.values()) < 4e-5
