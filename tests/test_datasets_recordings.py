"""Contents of the converted recordings, and of the model files beside them."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from pathlib import Path

import jax
import numpy as np
import pandas as pd
import pytest
import scipy.integrate
import scipy.io
import sympy

from jaxsr.datasets import list_datasets
from jaxsr.models import Simulator

RECORDINGS = Path(__file__).resolve().parents[2] / "shared" / "recordings"
NAMES = [dataset.name for dataset in list_datasets()]
PACKAGED = [dataset.name for dataset in list_datasets() if dataset.model]

needs_recordings = pytest.mark.skipif(
    not RECORDINGS.is_dir(), reason="the real recordings (../shared/recordings) are absent"
)

Fetched = dict[str, dict[str, pd.DataFrame]]


@pytest.fixture
def folder(datasets_folder: Path) -> Path:
    return datasets_folder


@pytest.fixture(scope="module")
def fetched(datasets_folder: Path) -> Fetched:
    folders = {name: datasets_folder / name for name in NAMES}
    return {
        name: {path.name: pd.read_csv(path) for path in sorted(folders[name].glob("*.csv"))}
        for name in NAMES
    }


def _model(dataset_name: str) -> dict:
    dataset = next(one for one in list_datasets() if one.name == dataset_name)
    text = (files("jaxsr.datasets") / "models" / dataset.model).read_text(encoding="utf-8")
    return tomllib.loads(text)


@pytest.mark.long
@needs_recordings
def test_the_whole_arm_stands_beside_its_first_joint(folder: Path) -> None:
    """Gravity on the rigid arm is most of what the motors of the shoulder and the elbow hold."""
    simulator = Simulator.from_file(folder / "ur10e" / "ur10e_arm.toml")
    model = simulator.model
    assert [s for s in model.states if s in model.inertia] == [f"v{k}" for k in range(1, 7)]
    table = pd.read_csv(folder / "ur10e" / "ur10e_ident.csv")
    columns = [[table[f"{c}{k}"].to_numpy() for k in range(1, 7)] for c in ("q", "qd", "i")]
    still = [*columns[0], *(np.zeros(len(table)) for _ in range(6))]
    with jax.enable_x64(True):
        forces = simulator.forces(0.0, tuple(still), tuple(columns[2]), simulator.values())
    for joint, share in ((2, 0.3), (3, 0.4)):
        torque = model.parameters[f"K{joint}"].value * columns[2][joint - 1]
        left = np.asarray(forces[model.states.index(f"v{joint}")])
        assert np.std(left) < share * np.std(torque)


@needs_recordings
def test_time_increases_and_nothing_is_missing(fetched: Fetched) -> None:
    for tables in fetched.values():
        for name, table in tables.items():
            time = table.iloc[:, 0].to_numpy()
            assert time[0] == 0.0, name
            assert np.all(np.diff(time) > 0), name
            assert table.notna().all(axis=None), name


@needs_recordings
@pytest.mark.parametrize(
    ("name", "file", "columns", "samples", "step"),
    [
        ("emps", "emps_train.csv", "time_s motor_force_N position_m reference_m", 24_841, 1e-3),
        (
            "emps",
            "emps_pulses.csv",
            "time_s motor_force_N position_m reference_m pulses_N",
            24_841,
            1e-3,
        ),
        ("silverbox", "silverbox_arrow.csv", "time_s input_V output_V", 40_475, 2**14 / 1e7),
        ("silverbox", "silverbox_multisine_10.csv", "time_s input_V output_V", 8_692, 2**14 / 1e7),
        ("silverbox", "silverbox_schroeder.csv", "time_s input_V output_V", 1_024, 2**14 / 1e7),
        ("cascaded_tanks", "tanks_train.csv", "time_s pump_V level_V", 1_024, 4.0),
        ("cascaded_tanks", "tanks_validation.csv", "time_s pump_V level_V", 1_024, 4.0),
    ],
)
def test_columns_counts_and_uniform_time(
    fetched: Fetched, name: str, file: str, columns: str, samples: int, step: float
) -> None:
    table = fetched[name][file]
    assert list(table.columns) == columns.split()
    assert len(table) == samples
    # EMPS stamps are rounded to 0.02 microseconds.
    assert np.allclose(np.diff(table["time_s"]), step, rtol=0, atol=1e-7)


@needs_recordings
def test_emps_force_is_gain_times_controller_output(fetched: Fetched) -> None:
    raw = scipy.io.loadmat(RECORDINGS / "emps" / "DATA_EMPS.mat")
    force = fetched["emps"]["emps_train.csv"]["motor_force_N"]
    assert np.allclose(force / raw["vir"].ravel(), 35.15065188, rtol=1e-9)
    assert set(fetched["emps"]["emps_pulses.csv"]["pulses_N"]) == {0.0, 5.0}


@needs_recordings
def test_multisines_are_cut_at_their_bounds(fetched: Fetched) -> None:
    """Run-in of 400 samples that repeats after 8192, then silence, in ten different inputs."""
    inputs = []
    for index in range(1, 11):
        table = fetched["silverbox"][f"silverbox_multisine_{index:02d}.csv"]
        u = table["input_V"].to_numpy() - table["input_V"].mean()
        run_in, repeat = u[20:390], u[8212:8582]
        assert np.std(run_in - repeat) < 0.05 * np.std(run_in)
        assert np.std(run_in[1:] - repeat[:-1]) > 0.2 * np.std(run_in)
        assert np.std(u[8610:]) < 0.05 * np.std(u)
        assert np.std(u[:5]) < 0.05 * np.std(u)
        inputs.append(u)
    overlap = np.corrcoef(inputs) - np.eye(10)
    assert np.abs(overlap).max() < 0.2


@needs_recordings
def test_silverbox_pieces_join_without_gap(fetched: Fetched) -> None:
    raw = scipy.io.loadmat(RECORDINGS / "silverbox" / "SNLS80mV.mat")["V2"].ravel()
    tables = fetched["silverbox"]
    names = ["silverbox_arrow.csv", *(f"silverbox_multisine_{k:02d}.csv" for k in range(1, 11))]
    joined = np.concatenate([tables[name]["output_V"].to_numpy() for name in names])
    assert np.array_equal(joined, raw[100 : 40_575 + 86_920])


@needs_recordings
def test_balls_fall_and_keep_height_and_velocity_consistent(fetched: Fetched) -> None:
    tables = fetched["falling_balls"]
    assert len(tables) == 22
    for name, table in tables.items():
        assert list(table.columns) == ["time_s", "height_m", "velocity_m_s"], name
        assert 30 <= len(table) <= 70, name
        frames = 30 * np.diff(table["time_s"])  # a step is 2, at times 2.05, 1 or 3
        assert np.allclose(frames, np.round(frames), atol=0.06), name
        assert np.median(frames) == pytest.approx(2, abs=0.02), name
        fallen = table["height_m"].iloc[0] - table["height_m"].iloc[-1]
        assert 25 < fallen < 50, name
        travelled = np.trapezoid(table["velocity_m_s"], table["time_s"])
        assert travelled == pytest.approx(-fallen, abs=0.1 * fallen), name


@needs_recordings
def test_balls_are_named_by_sheet(fetched: Fetched) -> None:
    assert fetched["falling_balls"]["balls_baseball_drop1.csv"].iloc[0].tolist() == [
        0.0,
        47.6989460979,
        0.639164806286,
    ]
    assert {"balls_bowling_ball_drop2.csv", "balls_whiffle_ball_1_drop1.csv"} <= set(
        fetched["falling_balls"]
    )


@needs_recordings
def test_pendulum_velocity_is_the_rate_of_its_position(fetched: Fetched) -> None:
    tables = fetched["dfki_pendulum"]
    assert {name: len(table) for name, table in tables.items()} == {
        "pendulum_ddp.csv": 3000,
        "pendulum_energy_shaping.csv": 4000,
        "pendulum_energy_shaping_1kg.csv": 4000,
        "pendulum_sysid.csv": 1170,
    }
    for name, table in tables.items():
        time, position = table["time_s"], table["position_rad"]
        integral = scipy.integrate.cumulative_trapezoid(table["velocity_rad_s"], time, initial=0)
        error = np.std(position - position[0] - integral)
        assert error < 0.05 * np.std(position), name


@needs_recordings
@pytest.mark.parametrize(
    ("file", "upstream", "first", "last"),
    [
        ("ur10e_ident.csv", "ident_30sec_12harm.csv", 635, 3510),
        ("ur10e_unloaded.csv", "unloaded_14harm50sec.csv", 195, 4966),
        ("ur10e_ptp.csv", "validation_ptp_10_points.csv", 700, 4200),
    ],
)
def test_ur10e_windows(fetched: Fetched, file: str, upstream: str, first: int, last: int) -> None:
    table = fetched["ur10e"][file]
    raw = np.loadtxt(RECORDINGS / "ur10e" / upstream, delimiter=",")
    assert table.shape == (last - first + 1, 31)
    assert table["t_s"].iloc[-1] == pytest.approx(raw[last - 1, 0] - raw[first - 1, 0])
    for column, index in {
        "q1": 1,
        "q6": 6,
        "qd1": 7,
        "i1": 13,
        "i_des1": 19,
        "tau_des6": 30,
    }.items():
        assert table[column].iloc[0] == raw[first - 1, index]
        assert table[column].iloc[-1] == raw[last - 1, index]


def _ur10e_weak_system(table: pd.DataFrame, half_width: float) -> tuple[np.ndarray, np.ndarray]:
    """Return library and torque of joint 1 against test functions (1 - s^2)^8, 10 N m/A."""
    time, v1 = table["t_s"].to_numpy(), table["qd1"].to_numpy()
    q2, q3 = table["q2"].to_numpy(), table["q3"].to_numpy()
    c2, c23 = np.cos(q2), np.cos(q2 + q3)
    inertia = np.stack([np.ones_like(c2), c2**2, c2 * c23, c23**2]) * v1
    friction = np.stack([v1, np.sign(v1)])
    torque = 10.0 * table["i1"].to_numpy()
    rows = []
    for centre in np.arange(time[0] + half_width, time[-1] - half_width, 0.05):
        inside = np.abs(time - centre) < half_width
        s, t = (time[inside] - centre) / half_width, time[inside]
        phi, phi_dot = (1 - s**2) ** 8, -16 * s * (1 - s**2) ** 7 / half_width
        rows.append(
            np.concatenate(
                [
                    np.trapezoid(-phi_dot * inertia[:, inside], t),
                    np.trapezoid(phi * friction[:, inside], t),
                    [np.trapezoid(phi * torque[inside], t)],
                ]
            )
        )
    system = np.array(rows)
    return system[:, :-1], system[:, -1]


@needs_recordings
def test_ur10e_inertia_basis_explains_the_held_out_files(fetched: Fetched) -> None:
    """With friction added, the model's inertia reaches the published error, not without."""
    tables = fetched["ur10e"]
    theta, torque = _ur10e_weak_system(tables["ur10e_ident.csv"], 0.12)
    xi = np.linalg.lstsq(theta, torque, rcond=None)[0]
    parameters = _model("ur10e")["parameters"]
    written = [parameters[name]["value"] for name in ("Ja", "Jb", "Jc", "Jd")]
    assert np.allclose(xi[:4], written, atol=0.3)
    for file in ("ur10e_unloaded.csv", "ur10e_ptp.csv"):
        theta, torque = _ur10e_weak_system(tables[file], 0.12)
        error = np.linalg.norm(theta @ xi - torque) / np.linalg.norm(torque)
        rigid = np.linalg.norm(theta[:, :4] @ xi[:4] - torque) / np.linalg.norm(torque)
        assert error < 0.098
        assert rigid > 0.9


def test_ur10e_coriolis_term_is_the_rate_of_the_inertia() -> None:
    """J1_dot in the file equals sum_k dJ1/dq_k * qd_k, symbolically."""
    definitions = _model("ur10e")["definitions"]
    known: dict[str, sympy.Expr] = {}
    for name, text in definitions.items():
        known[name] = sympy.sympify(text).subs(known)
    q2, q3, qd2, qd3 = sympy.symbols("q2 q3 qd2 qd3")
    rate = sympy.diff(known["J1"], q2) * qd2 + sympy.diff(known["J1"], q3) * qd3
    assert sympy.simplify(known["J1_dot"] - rate) == 0


@needs_recordings
@pytest.mark.parametrize("name", NAMES)
def test_model_roles_have_columns_in_every_recording(
    fetched: Fetched, folder: Path, name: str
) -> None:
    model = tomllib.loads((folder / name / f"{name}.toml").read_text(encoding="utf-8"))
    columns = model.get("columns", {})
    roles = ["t", *model["model"]["inputs"], *model["model"]["outputs"]]
    for file, table in fetched[name].items():
        for role in roles:
            assert columns.get(role, role) in table.columns, (file, role)


@pytest.mark.parametrize("name", PACKAGED)
def test_model_is_complete(name: str) -> None:
    model = _model(name)
    states = model["model"]["states"]
    assert set(model["equations"]) == set(states)
    assert set(model["readings"]) == set(model["model"]["outputs"])
    for symbol in [*states, *model["model"]["inputs"], *model["model"]["outputs"]]:
        assert symbol in model["units"]
    for parameter in model["parameters"].values():
        low, high = parameter.get("bounds", (-np.inf, np.inf))
        assert low < parameter["value"] < high
        assert parameter["unit"]
