"""Python vector fields and models with events, diagnosed from the command line to the edit."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from jaxsr import Simulator, diagnose, read_recording
from jaxsr._progress import Budget
from jaxsr.cli import main
from jaxsr.diagnosis.calibrating.horizon import Outlook
from jaxsr.diagnosis.setup import prepare, seen_by
from jaxsr.diagnosis.weak.weak_system import weak_system
from jaxsr.models import parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.models.simulation import simulate_to_csv
from jaxsr.recordings import Recording

ARM = """
import jax.numpy as jnp


def arm(t, x, u, p):
    q1, q2, w1, w2 = x
    cq2 = jnp.cos(q2)
    h = p["b"] * jnp.sin(q2)
    inertia = jnp.array(
        [[p["a"] + 2 * p["b"] * cq2, p["d"] + p["b"] * cq2], [p["d"] + p["b"] * cq2, p["d"]]]
    )
    gravity = p["g2"] * jnp.sin(q1 + q2)
    force = jnp.array(
        [
            u[0] - p["Fv1"] * w1 + h * (2 * w1 * w2 + w2**2) - p["g1"] * jnp.sin(q1) - gravity,
            u[1] - p["Fv2"] * w2 - h * w1**2 - gravity,
        ]
    )
    return jnp.concatenate([x[2:], jnp.linalg.solve(inertia, force)])
"""
CART = """
[model]
name = "cart"
{base}states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
{equations}
[readings]
y = "q"
[parameters]
M = {{ value = 2.0, unit = "kg", bounds = [1.0, 4.0] }}
c = {{ value = 0.5, unit = "N*s/m", bounds = [0.0, 5.0] }}
k = {{ value = 8.0, unit = "N/m", bounds = [1.0, 20.0] }}
[units]
q = "m"
v = "m/s"
u = "N"
y = "m"
"""
FUNCTION = """
import jax.numpy as jnp
def cart(t, x, u, p):
    q, v = x
    return jnp.array([v, (u[0] - p["c"]*v - p["k"]*q)/p["M"]])
"""
DEMO = Path(__file__).parents[1] / "jaxsr" / "datasets" / "demo"


def cart(equation: str) -> str:
    return CART.format(base="", equations=f'[equations]\nq = "v"\nv = "{equation}"\n')


def recorded(folder: Path, equation: str, seed: int = 0) -> Path:
    """Write a recording of the cart with another law, encoder steps small."""
    rng, time = np.random.default_rng(seed), np.arange(800) * 0.02
    phases = rng.uniform(0, 6, 5)
    u = sum(
        4.0 * np.sin(w * time + p) for w, p in zip([0.7, 1.3, 2.1, 3.3, 5.1], phases, strict=True)
    )
    plain = cart(equation).split("[units]")[0]  # the number of a law bears no unit
    model = parse_model(plain + "[initial]\nq = 0.1\nv = 0.0\n")
    run = simulate_to_csv(Simulator(model), Recording("r", time, {"u": np.asarray(u)}))
    run["y"] += 2e-4 * rng.normal(size=time.size)
    path = folder / "a.csv"
    run[["t", "y", "u"]].to_csv(path, index=False)
    return path


def written(folder: Path) -> str:
    (folder / "m.py").write_text(FUNCTION)
    (folder / "m.toml").write_text(CART.format(base='base = "m.py:cart"\n', equations=""))
    return f"{folder / 'm.py'}:cart"


@pytest.mark.slow
def test_coulomb_friction_on_a_function_is_found_written_and_run(tmp_path: Path) -> None:
    data = recorded(tmp_path, "(u - c*v - k*q - 1.5*sign(v))/M")
    model, out = written(tmp_path), tmp_path / "d"
    assert main(["diagnose", model, str(data), "--out", str(out), "--budget", "120"]) == 0
    document = json.loads((out / "diagnosis.json").read_text())
    (finding,) = document["findings"]
    assert document["verdict"] == "structure" and finding["site"] == "equation:v"
    assert finding["mechanism"] == "coulomb_friction"
    assert finding["parameters"]["Fc"]["value"] == pytest.approx(1.5, rel=0.02)
    assert finding["parameters"]["Fc"]["unit"] == "N" and finding["term"] == "-Fc*sign(v)"
    assert finding["edit"]["additions.v"] == "(1.0/M)*(-Fc*sign(v))"
    explained = out / "explained.toml"
    assert 'base = "m.py:cart"' in explained.read_text()
    run = ["simulate", model, str(data), "--out", str(tmp_path / "run.csv")]
    assert main([*run, "--model", str(explained)]) == 0
    recording, found = read_recording(data), read_recording(tmp_path / "run.csv")
    apart = found.channel("y") - recording.channel("y")
    assert np.sqrt(np.mean(apart**2)) < 2e-3 < 0.01 * np.std(recording.channel("y"))


def test_the_table_is_named_beside_a_function_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written(tmp_path)
    table = str(tmp_path / "m.toml")
    given = ["simulate", table, "--duration", "1", "--dt", "0.1", "--out", str(tmp_path / "r.csv")]
    assert main([*given, "--model", table]) == 2
    assert "--model goes with file.py:function" in capsys.readouterr().err


@pytest.mark.long
def test_a_wrong_value_in_a_function_is_a_parameter(tmp_path: Path) -> None:
    data = recorded(tmp_path, "(u - c*v - 11.0*q)/M")
    found = diagnose(Simulator.from_file(written(tmp_path)), [data], budget=120)
    assert found.verdict == "parameter"
    assert {f["site"] for f in found.findings} == {"parameter:k"}
    assert found.findings[0]["parameters"]["k"]["value"] == pytest.approx(11.0, rel=0.01)


@pytest.mark.long
def test_the_weak_view_of_a_function_is_that_of_its_formulas(tmp_path: Path) -> None:
    """Masses in front of rates: the arm as a function says what its TOML says."""
    (tmp_path / "arm.py").write_text(ARM)
    text = (DEMO / "arm.toml").read_text()
    head, rest = text.split("[definitions]")
    table = head.replace("input_hold", 'base = "arm.py:arm"\ninput_hold')
    (tmp_path / "arm.toml").write_text(table + "[readings]" + rest.split("[readings]")[1])
    ways = []
    for name in (f"{tmp_path / 'arm.py'}:arm", DEMO / "arm.toml"):
        simulator = Simulator.from_file(name)
        seen = seen_by(simulator, prepare(simulator.model, [DEMO / "set1_train.csv"]))
        assert seen is not None
        theta = np.array([p.value for p in simulator.model.parameters.values()])
        ways.append((seen, weak_system(simulator, seen.grid, theta)))
    (function, own), (formulas, other) = ways
    np.testing.assert_allclose(own.residual, other.residual, atol=1e-10)
    np.testing.assert_allclose(own.jacobian, other.jacobian, atol=1e-8)
    assert {c.label for c in function.candidates} <= {c.label for c in formulas.candidates}


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_the_demo_arm_as_a_function_gives_the_findings_of_its_model_file(
    number: int, tmp_path: Path
) -> None:
    (tmp_path / "arm.py").write_text(ARM)
    head, rest = (DEMO / "arm.toml").read_text().split("[definitions]")
    table = head.replace("input_hold", 'base = "arm.py:arm"\ninput_hold')
    (tmp_path / "arm.toml").write_text(table + "[readings]" + rest.split("[readings]")[1])
    found = [
        diagnose(Simulator.from_file(model), [DEMO / f"set{number}_train.csv"])
        for model in (f"{tmp_path / 'arm.py'}:arm", DEMO / "arm.toml")
    ]
    function, formulas = found
    assert function.verdict == formulas.verdict
    keys = [{(f["site"], f["mechanism"]) for f in d.findings} for d in found]
    assert keys[0] == keys[1]
    for finding in function.findings:
        key = finding["site"], finding["mechanism"]
        twin = next(f for f in formulas.findings if (f["site"], f["mechanism"]) == key)
        for name, parameter in finding["parameters"].items():
            other = twin["parameters"][name]
            low, high = other["ci95"]
            assert parameter["unit"] == other["unit"]
            assert abs(parameter["value"] - other["value"]) <= max(high - low, 1e-9)


BALL = """
[model]
name = "ball"
states = ["q", "v"]
outputs = ["h"]
[equations]
q = "v"
v = "-g"
[readings]
h = "q"
[parameters]
g = { value = 9.8, bounds = [9.0, 10.5] }
e = { value = 0.8, bounds = [0.1, 1.0] }
[[events]]
when = "q"
direction = -1
reset = { v = "-e*v" }
"""


def dropped(drag: float, e: float, seed: int = 0) -> Recording:
    """A ball between floor and sky, in short Euler-midpoint steps, impacts within a step."""
    rng, dt, fine = np.random.default_rng(seed), 0.01, 200
    q, v, heights = 2.0, 0.0, []
    step = dt / fine
    for _ in range(300):
        heights.append(q)
        for _ in range(fine):
            middle = v + 0.5 * step * (-9.8 - drag * v * abs(v))
            q, before = q + step * middle, q
            v += step * (-9.8 - drag * middle * abs(middle))
            if q < 0.0 < before + 1e-15:
                share = before / (before - q)
                v, q = -e * v, -e * v * (1.0 - share) * step
    y = np.array(heights) + 5e-4 * rng.normal(size=300)
    return Recording("drop.csv", np.arange(300) * dt, {"h": y})


@pytest.mark.long
def test_a_model_with_events_keeps_its_budget_in_steps() -> None:
    """Counted, not timed: nothing is compiled, and no candidate is begun after the budget."""
    import jaxsr.models.rollout as rollout

    calls = []
    compiled = rollout._outputs_jit, rollout._linearise_jit
    rollout._outputs_jit = rollout._linearise_jit = lambda *a: calls.append(a)  # type: ignore[assignment]
    try:
        found = diagnose(Simulator(parse_model(BALL)), [dropped(0.0, 0.75)], budget=15)
    finally:
        rollout._outputs_jit, rollout._linearise_jit = compiled
    assert not calls
    assert found.verdict in ("parameter", "undecided")


def test_a_spent_budget_ends_the_choice_of_a_horizon() -> None:
    simulator = Simulator(parse_model(BALL))
    from jaxsr.diagnosis.mechanisms.super_model import SuperModel

    prepared = prepare(simulator.model, [dropped(0.0, 0.75)])
    asked = []

    def stop() -> bool:
        asked.append(1)
        return True

    outlook = Outlook(
        SuperModel.build(simulator.model, []),
        prepared,
        Stepping("rk4", 1),
        np.array([0.01]),
        simulator,
        stop,
    )
    headline = outlook.headline([((), np.array([9.8, 0.8]))])
    assert headline.seconds == min(headline.lengths) and len(asked) < 20


@pytest.mark.slow
def test_a_drag_on_a_bouncing_ball_is_found() -> None:
    found = diagnose(Simulator(parse_model(BALL)), [dropped(0.15, 0.8)], budget=Budget(600.0))
    assert found.verdict == "structure" and len(found.findings) == 1
    finding = found.findings[0]
    assert finding["site"] == "equation:v"
    assert finding["mechanism"] in ("quadratic_drag", "power_law_drag")
    assert finding["parameters"]["kd"]["value"] == pytest.approx(0.15, rel=0.2)
