"""Models with many equations: mechanisms at each of them, found together."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxsr.diagnosis import diagnose
from jaxsr.diagnosis.setup import prepare
from jaxsr.models import Simulator, parse_model
from jaxsr.models.lifting import closed
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import build_segments
from jaxsr.recordings import Recording

COUNT, STEP = 5, 0.01
TIME = np.arange(1500) * STEP
MASSES = (2.0, 1.5, 1.0, 1.2, 0.8)
Force = Callable[[int, float], float]


def table(title: str, rows: dict[str, str]) -> list[str]:
    return [f"[{title}]", *(f"{name} = {value}" for name, value in rows.items())]


def driven_chain() -> Simulator:
    """Five masses, each driven by a force of its own, springs between neighbours and to ground."""
    every = range(1, COUNT + 1)
    names = {letter: [f"{letter}{i}" for i in every] for letter in "qvuyw"}
    lists = {
        "states": names["q"] + names["v"],
        "inputs": names["u"],
        "outputs": names["y"] + names["w"],
    }
    pull = {i: "".join(f" - k*(q{i} - q{j})" for j in (i - 1, i + 1) if j in every) for i in every}
    units = dict.fromkeys(names["q"] + names["y"], '"m"') | dict.fromkeys(names["u"], '"N"')
    units |= dict.fromkeys(names["v"] + names["w"], '"m/s"')
    parameters = {
        f"m{i}": f'{{ value = {m}, unit = "kg", bounds = [0.1, 10.0] }}'
        for i, m in enumerate(MASSES, start=1)
    }
    for name, value in (("k", 30.0), ("c", 20.0)):
        parameters[name] = f'{{ value = {value}, unit = "N/m", bounds = [1.0, 200.0] }}'
    lines = [
        *table("model", {n: str(v).replace("'", '"') for n, v in lists.items()}),
        *table("equations", {f"q{i}": f'"v{i}"' for i in every}),
        *(f'v{i} = "u{i} - c*q{i}{pull[i]}"' for i in every),
        *table("inertia", {f"v{i}": f'{{ v{i} = "m{i}" }}' for i in every}),
        *table("readings", {f"y{i}": f'"q{i}"' for i in every}),
        *(f'w{i} = "v{i}"' for i in every),
        *table("parameters", parameters),
        *table("units", units),
    ]
    return Simulator(parse_model("\n".join(lines) + "\n", "chain.toml"))


CHAIN = driven_chain()


def moved(force: Force, seed: int, deviation: float = 1e-5) -> Recording:
    """The chain in motion with a further force on every mass; noise in m and m/s."""
    rng = np.random.default_rng(seed)
    lines, phases = rng.uniform(2.0, 9.0, (COUNT, 4)), rng.uniform(0.0, 6.28, (COUNT, 4))

    def drive(t: float) -> np.ndarray:
        return 5.0 * np.sin(lines * t + phases).sum(1)

    def field(t: float, s: np.ndarray) -> np.ndarray:
        q, v = s[:COUNT], s[COUNT:]
        pull = np.zeros(COUNT)
        pull[:-1] += 30.0 * np.diff(q)
        pull[1:] -= 30.0 * np.diff(q)
        more = np.array([force(i + 1, v[i]) for i in range(COUNT)])
        return np.concatenate([v, (drive(t) - 20.0 * q + pull + more) / np.array(MASSES)])

    found = solve_ivp(
        field,
        (0.0, TIME[-1]),
        np.zeros(2 * COUNT),
        t_eval=TIME,
        rtol=1e-8,
        atol=1e-10,
        max_step=STEP,
    )
    noise = deviation * rng.standard_normal(found.y.shape)
    columns = {f"u{i + 1}": np.array([drive(t)[i] for t in TIME]) for i in range(COUNT)}
    columns |= {f"y{i + 1}": (found.y + noise)[i] for i in range(COUNT)}
    columns |= {f"w{i + 1}": (found.y + noise)[COUNT + i] for i in range(COUNT)}
    return Recording("chain.csv", TIME, columns)


def left_out(mass: int, v: float) -> float:
    """Coulomb friction of masses 1 and 4, quadratic drag of mass 2."""
    if mass == 2:
        return -1.5 * v * abs(v)
    return -0.8 * np.tanh(v / 0.005) if mass in (1, 4) else 0.0


LEFT_OUT = {
    "coulomb_friction@equation:v1": ("Fc", 0.8),
    "quadratic_drag@equation:v2": ("kd", 1.5),
    "coulomb_friction@equation:v4": ("Fc", 0.8),
}


@pytest.mark.long
def test_one_segment_alone_goes_the_way_of_several() -> None:
    prepared = prepare(CHAIN.model, [moved(left_out, 3)])
    theta = np.array([p.value for p in CHAIN.model.parameters.values()])
    ways = []
    for rows in ([(0, 0, 800)], [(0, 0, 800), (0, 0, 800)]):
        segments = build_segments(CHAIN.model, prepared, rows, 2)
        path = segments.course.copy()
        ways.append(closed(CHAIN, Stepping("rk4", 2, ()), segments, theta, path, near=False))
    assert ways[0] is not None
    assert ways[1] is not None
    np.testing.assert_allclose(ways[0][:, :, 0], ways[1][:, :, 1], rtol=1e-10, atol=1e-12)


@pytest.mark.long
def test_a_diagnosis_says_nothing_where_nothing_is_left_out() -> None:
    # noise above what inputs held between samples leave
    record = moved(lambda mass, v: 0.0, 0, 5e-3).select(slice(0, 500))
    found = diagnose(CHAIN, [record], budget=30.0)
    assert found.verdict in ("nothing", "parameter")
    assert not [f for f in found.findings if f["mechanism"] != "wrong_value"]


@pytest.mark.slow
def test_a_diagnosis_names_each_of_many_equations() -> None:
    found = diagnose(CHAIN, [moved(left_out, 0)], held_out=[moved(left_out, 1)], budget=90.0)
    assert found.verdict == "structure"
    assert {f"{f['mechanism']}@{f['site']}" for f in found.findings} == set(LEFT_OUT)
    for finding in found.findings:
        name, value = LEFT_OUT[f"{finding['mechanism']}@{finding['site']}"]
        (estimate,) = (v for n, v in finding["parameters"].items() if n.startswith(name))
        assert estimate["value"] == pytest.approx(value, rel=0.1)
    held = found.fit["held_out"]
    assert held["explained"][0] < 0.1 * held["recalibrated"][0]


@pytest.mark.slow
def test_a_wrong_sensor_is_told_from_what_acts_at_many_equations() -> None:
    true = moved(left_out, 0)
    columns = dict(true.channels)
    columns["y3"] = 1.08 * columns["y3"]
    found = diagnose(CHAIN, [Recording("a.csv", TIME, columns)], budget=90.0)
    told = {f"{f['mechanism']}@{f['site']}" for f in found.findings}
    assert told == {*LEFT_OUT, "sensor_gain@output:y3"}
    (wrong,) = (f for f in found.findings if f["mechanism"] == "sensor_gain")
    assert next(iter(wrong["parameters"].values()))["value"] == pytest.approx(1.08, rel=0.01)
