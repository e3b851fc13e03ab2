"""Free runs as a table, against closed forms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jaxsr import cli
from jaxsr._result import InputError
from jaxsr.models import Simulator, parse_model, simulation
from jaxsr.models.simulation import simulate_to_csv, start_told
from jaxsr.recordings import Recording, read_recording

OSCILLATOR = """
[model]
name = "oscillator"
states = ["q", "v"]
outputs = ["q_meas"]
[equations]
q = "v"
v = "-w**2*q"
[readings]
q_meas = "q"
[parameters]
w = { value = 3.0, unit = "1/s" }
[initial]
q = 0.5
v = 0.0
[columns]
q_meas = "position"
"""


def simulator(text: str) -> Simulator:
    return Simulator(parse_model(text))


def test_oscillator_follows_the_cosine() -> None:
    table = simulate_to_csv(simulator(OSCILLATOR), duration=10.0, dt=0.1)
    assert list(table.columns) == ["t", "position", "q", "v"]
    assert len(table) == 101 and table.t.iloc[-1] == pytest.approx(10.0)
    assert np.abs(table.position - 0.5 * np.cos(3.0 * table.t)).max() < 1e-6
    assert np.abs(table.v + 1.5 * np.sin(3.0 * table.t)).max() < 1e-5


def test_few_steps_in_numbers_are_those_of_a_compiled_program(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    runs = []
    for most in (10_000, 0):
        monkeypatch.setattr(simulation, "INTERPRETED", most)
        runs.append(simulate_to_csv(simulator(OSCILLATOR), duration=3.0, dt=0.1))
    np.testing.assert_allclose(runs[0], runs[1], rtol=1e-12, atol=1e-12)


@pytest.mark.long
def test_a_long_gap_of_rows_is_crossed_with_steps_of_its_own() -> None:
    """Sixty turns between two rows: no even number of steps between rows resolves them."""
    time = np.concatenate([np.arange(0.0, 1.0, 0.01), 130.0 + np.arange(0.0, 1.0, 0.01)])
    table = simulate_to_csv(simulator(OSCILLATOR), Recording("gap.csv", time, {}))
    assert np.abs(table.position - 0.5 * np.cos(3.0 * time)).max() < 1e-4


def test_coulomb_friction_stops_a_sliding_block_at_the_right_place() -> None:
    text = (
        OSCILLATOR.replace("-w**2*q", "-2.0*sign(v)")
        .replace("q = 0.5", "q = 0.0")
        .replace("v = 0.0", "v = 3.0")
    )
    table = simulate_to_csv(simulator(text), duration=4.0, dt=0.01)
    at = np.minimum(table.t, 1.5)
    # The sign is smoothed over 2/1000 of the speed, hence the tolerance.
    assert np.abs(table.q - (3.0 * at - at**2)).max() < 0.01
    assert np.abs(table.v[table.t > 1.6]).max() < 0.01


def test_stiff_decay_follows_its_slow_input() -> None:
    text = OSCILLATOR.replace("-w**2*q", "-1e5*(v - cos(w*t/3.0))")
    table = simulate_to_csv(simulator(text), duration=3.0, dt=0.1)
    assert np.abs(table.v[1:] - np.cos(table.t[1:])).max() < 1e-4
    assert np.abs(table.q - 0.5 - np.sin(table.t)).max() < 1e-4


def forced(free: bool) -> Simulator:
    text = OSCILLATOR.replace('outputs = ["q_meas"]', 'inputs = ["u"]\noutputs = ["q_meas"]')
    text = text.replace("-w**2*q", "u")
    if free:
        text = text.replace("q = 0.5\nv = 0.0", 'q = "free"\nv = "free"')
    return simulator(text + 'u = "force"\n')


def test_recorded_input_on_an_uneven_grid() -> None:
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.01, 0.05, 300))
    recording = Recording("a.csv", time, {"force": time})
    table = simulate_to_csv(forced(free=False), recording)
    assert list(table.columns) == ["t", "force", "position", "q", "v"]
    t0 = time[0]
    exact = 0.5 + time**3 / 6 - t0**3 / 6 - t0**2 / 2 * (time - t0)
    assert np.abs(table.position - exact).max() < 1e-9


def test_free_start_is_estimated_on_the_first_samples() -> None:
    time = np.arange(400) * 0.02
    truth = 1.0 - 2.0 * time + 0.5 * np.sin(time)
    rng = np.random.default_rng(1)
    noise = 1e-4 * rng.standard_normal(time.size)
    channels = {"force": -0.5 * np.sin(time), "position": truth + noise}
    table = simulate_to_csv(forced(free=True), Recording("a.csv", time, channels))
    assert table.q[0] == pytest.approx(1.0, abs=1e-4)
    assert table.v[0] == pytest.approx(-1.5, abs=1e-3)
    # What comes later changes nothing.
    channels["position"] = np.where(time < 1.0, channels["position"], 7.0)
    again = simulate_to_csv(forced(free=True), Recording("a.csv", time, channels))
    assert np.abs(table.q - again.q).max() < 1e-6


def test_how_a_run_starts_is_told_as_it_is_done() -> None:
    long = Recording("a.csv", np.arange(2000) * 0.01, {})
    short = Recording("b.csv", np.arange(30) * 0.01, {})
    free, given = forced(free=True).model, forced(free=False).model
    mixed = replace(given, initial={"q": 0.5, "v": "free"})
    assert start_told(free, long) == "start: all states estimated on the first 100 samples of a.csv"
    assert start_told(free, short).endswith("the first 30 samples of b.csv")
    assert start_told(given, long) == "start: q, v given in [initial]"
    told = "start: q given in [initial]; v estimated on the first 100 samples of a.csv"
    assert start_told(mixed, long) == told


@pytest.mark.long
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("v = 0.0", 'v = "free"'), "start of v is free"),
        (("-w**2*q", "v**2 + 1.0"), "diverges|do not agree"),
        (('outputs = ["q', 'inputs = ["u"]\noutputs = ["q'), "inputs u are unknown"),
    ],
)
def test_runs_that_cannot_be_done_say_why(
    change: tuple[str, str], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Each of them is a program of its own: three are as many failures as eight.
    monkeypatch.setattr(simulation, "ATTEMPTS", (*simulation.ATTEMPTS[:2], simulation.ATTEMPTS[4]))
    with pytest.raises(InputError, match=message):
        simulate_to_csv(simulator(OSCILLATOR.replace(*change)), duration=10.0, dt=0.1)


def test_command_writes_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model, out = tmp_path / "m.toml", tmp_path / "run.csv"
    model.write_text(OSCILLATOR)
    assert (
        cli.main(["simulate", str(model), "--duration", "1", "--dt", "0.1", "--out", str(out)]) == 0
    )
    assert "11 rows" in (said := capsys.readouterr().out) and "start: q, v given in" in said
    recording = read_recording(out)
    assert np.abs(recording.channel("position") - 0.5 * np.cos(3 * recording.time)).max() < 1e-6
    again = tmp_path / "again.csv"
    assert cli.main(["simulate", str(model), str(out), "--out", str(again)]) == 0
    assert again.read_text() == out.read_text()


@pytest.mark.parametrize("header", ["Zeit [ms]", "t_us", "Time, min", "time"])
def test_times_are_written_in_the_unit_that_their_header_states(
    header: str, tmp_path: Path
) -> None:
    model, given, out = tmp_path / "m.toml", tmp_path / "given.csv", tmp_path / "run.csv"
    model.write_text(OSCILLATOR.replace("[columns]", f'[columns]\nt = "{header}"'))
    seconds = {"Zeit [ms]": 1e-3, "t_us": 1e-6, "Time, min": 60.0, "time": 1.0}[header]
    rows = [f"{0.1 * k / seconds!r};0.0" for k in range(60)]
    given.write_text("\n".join([f"{header};other", *rows]) + "\n")
    assert cli.main(["simulate", str(model), str(given), "--out", str(out)]) == 0
    again = read_recording(out, time=header)
    np.testing.assert_allclose(again.time, 0.1 * np.arange(60), atol=1e-9)
    assert np.abs(again.channel("position") - 0.5 * np.cos(3 * again.time)).max() < 1e-6
