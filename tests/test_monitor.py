"""The monitor: its sequential test, what it learns as normal, streams and folders."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import jaxsr
from benchmarks.monitor_plants import MOUNT, TANKS, correlated
from jaxsr._arguments import expand_file_lists
from jaxsr.cli import main
from jaxsr.diagnosis.setup import prepare
from jaxsr.monitoring import live
from jaxsr.monitoring.detector import Watch, exponent
from jaxsr.monitoring.folder import recordings
from jaxsr.monitoring.windows import Rhythm
from jaxsr.recordings import Recording, write_csv


@pytest.fixture(scope="module")
def normal() -> Recording:
    return MOUNT.runs(np.random.default_rng(1), 1, 1500)[0]


@pytest.fixture(scope="module")
def watch(normal: Recording) -> jaxsr.Monitor:
    return jaxsr.monitor(MOUNT.model, [normal], false_alarms_per_hour=0.5)


def ratios(rng: np.random.Generator, shift: float, shape: tuple[int, ...]) -> np.ndarray:
    """Log likelihood ratios of a mean `shift` against 0 of unit Gaussians that have mean 0."""
    return shift * rng.normal(size=shape) - 0.5 * shift**2


def test_alarms_in_normal_running_are_no_more_frequent_than_stated() -> None:
    """Optional stopping: R(t) - t is a martingale, so that the mean time to R >= A is A or more."""
    rng, threshold, times = np.random.default_rng(0), 50.0, []
    for _ in range(100):
        watch, t = Watch.begun(2), 0
        while watch.log_evidence < np.log(threshold):
            watch = watch.after(np.array([ratios(rng, s, ()) for s in (0.4, 1.5)]), float(t))
            t += 1
        times.append(t)
    mean, error = np.mean(times), np.std(times) / np.sqrt(len(times))
    assert mean > threshold - 3.0 * error
    assert mean < 8.0 * threshold  # and not for want of any


def test_a_change_is_found_soon_and_dated() -> None:
    rng, watch = np.random.default_rng(0), Watch.begun(1)
    for t in range(1000):
        gain = ratios(rng, 1.0, (1,)) + (1.0 if t >= 500 else 0.0)  # the mean is 1 from here on
        watch = watch.after(gain, float(t))
        if watch.log_evidence > np.log(1e4):
            break
    assert 500 <= t < 550
    assert abs(watch.since[0] - 500) < 20


def test_the_exponent_is_1_where_ratios_are_as_expected_and_less_where_they_are_not() -> None:
    rng = np.random.default_rng(0)
    assert exponent(ratios(rng, 0.7, (3, 400))) == 1.0
    heavy = 2.0 * ratios(rng, 1.5, (1, 400)) + 1.0
    theta = exponent(heavy)
    assert 0.02 < theta < 0.8
    # blocks that are fair one by one, and depend on one another
    slow = correlated(rng, (4000, 1), 0.995)[:, 0] - 0.5
    assert exponent(slow[None]) < 0.5


def test_windows_do_not_go_across_a_break_and_follow_one_another() -> None:
    time = np.concatenate([np.arange(100), 500 + np.arange(60)]).astype(float)
    item = type("Item", (), {"time": time})()
    rhythm = Rhythm(16, 32)
    found = rhythm.windows(0, item)
    assert [w.first for w in found] == [8, 24, 40, 56, 72, 108, 124, 140]
    assert all(w.start >= 100 for w in found if w.first >= 100)
    assert [w.start for w in found[:5]] == [0, 0, 8, 24, 40]
    assert [w.first for w in rhythm.windows(0, item, judged=56)] == [56, 72, 108, 124, 140]


def test_what_is_learnt_is_the_sensors_noise(watch: jaxsr.Monitor) -> None:
    noise = watch.normal.filter.noise
    assert noise.white + noise.coloured == pytest.approx(0.02**2, rel=0.15)
    assert watch.exponent == 1.0


@pytest.mark.long
def test_normal_running_raises_no_alarm_and_a_softer_spring_does(watch: jaxsr.Monitor) -> None:
    rng = np.random.default_rng(2)
    assert watch.read(MOUNT.runs(rng, 1, 3000)[0]) == []
    watch.reset()
    alarms = watch.read(MOUNT.runs(rng, 1, 2000, "softer", 1000)[0])
    watch.reset()
    assert alarms
    assert 100.0 < alarms[0].time < 130.0
    assert 85.0 < alarms[0].since < alarms[0].time
    assert "does not follow its model" in alarms[0].sentence
    assert alarms[0].stretch.time[-1] >= alarms[0].time


@pytest.mark.slow
def test_ratios_are_1_at_most_in_normal_running_however_little_of_it_was_learnt() -> None:
    """What is not there at all is told by a bound alone, and a step from it may go too far."""
    learnt = MOUNT.runs(np.random.default_rng([37, 0]), 3, 2000)[1]
    watch = jaxsr.monitor(MOUNT.model, [learnt])
    prepared = prepare(MOUNT.model, MOUNT.runs(np.random.default_rng(6), 1, 10_000))
    windows = watch.rhythm.windows(0, prepared[0])
    gains = live._gains(watch._follower, watch.normal, watch._ways, prepared, windows)
    means = np.log(np.mean(np.exp(gains), axis=1))
    assert means.max() < 0.2
    assert watch.exponent == 1.0


def test_a_stream_in_pieces_is_judged_as_the_whole(watch: jaxsr.Monitor) -> None:
    run = MOUNT.runs(np.random.default_rng(3), 1, 600, "softer", 200)[0]
    whole = [alarm.time for alarm in watch.read(run)]
    watch.reset()
    names = ("force", "y")
    pieces = (
        {"t": run.time[a : a + 50], **{n: run.channel(n)[a : a + 50] for n in names}}
        for a in range(0, 600, 50)
    )
    told = [alarm.time for alarm in watch.watch(pieces)]
    watch.finish()
    watch.reset()
    assert whole[0] == told[0]
    with pytest.raises(jaxsr.InputError, match="no column 'force'"):
        watch.feed({"t": run.time, "y": run.channel("y")})
    watch.finish()


@pytest.mark.long
def test_correlated_noise_and_lost_samples_are_normal() -> None:
    rng = np.random.default_rng(4)
    first, second = (_with_losses(run, rng) for run in TANKS.runs(rng, 2, 2000))
    watch = jaxsr.monitor(TANKS.model, [first], false_alarms_per_hour=0.1)
    noise = watch.normal.filter.noise
    assert noise.correlation[1] * noise.coloured[1] / 0.05**2 == pytest.approx(0.6, abs=0.15)
    assert watch.read(second) == []
    assert watch.hours == pytest.approx(2000 / 3600, rel=0.1)


def _with_losses(run: Recording, rng: np.random.Generator) -> Recording:
    channels = {name: values.copy() for name, values in run.channels.items()}
    channels["lower"][rng.random(len(run)) < 0.3] = np.nan
    return Recording(run.name, run.time, channels)


def test_refusals_say_what_to_do(normal: Recording) -> None:
    with pytest.raises(jaxsr.InputError, match="false_alarms_per_hour"):
        jaxsr.monitor(MOUNT.model, [normal], false_alarms_per_hour=0.0)
    with pytest.raises(jaxsr.InputError, match="normal"):
        jaxsr.monitor(MOUNT.model, [])
    with pytest.raises(jaxsr.InputError, match="too short"):
        jaxsr.monitor(MOUNT.model, [normal.select(slice(0, 60))])


def test_files_that_are_still_written_are_waited_for(tmp_path: Path) -> None:
    looks = 0

    def stop() -> bool:
        nonlocal looks
        looks += 1
        if looks == 2:
            (tmp_path / "b.csv").write_text("half")
        return len(found) == 2 or looks > 500

    (tmp_path / "a.csv").write_text("whole")
    (tmp_path / "notes.txt").write_text("no recording")
    found: list[str] = []
    for path in recordings([tmp_path], True, stop, pause=0.01):
        found.append(path.name)
    assert found == ["a.csv", "b.csv"]
    assert [p.name for p in recordings([tmp_path], False, lambda: False)] == ["a.csv", "b.csv"]


@pytest.mark.long
def test_the_command_judges_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(5)
    runs, folder = MOUNT.runs(rng, 2, 1200), tmp_path / "runs"
    folder.mkdir()
    (tmp_path / "model.toml").write_text(MOUNT.text, encoding="utf-8")
    for name, run in (
        (tmp_path / "normal.csv", runs[0]),
        (folder / "1.csv", runs[1]),
        (folder / "2.csv", MOUNT.runs(rng, 1, 1200, "softer", 400)[0]),
    ):
        write_csv(run, name)
    (folder / "3.csv").write_text("t,y\n0,1\n1,2\n2,4\n", encoding="utf-8")
    model, normal, out = (str(tmp_path / n) for n in ("model.toml", "normal.csv", "out"))
    assert main(["monitor", model, str(folder), "--normal", normal, "--out", out]) == 0
    said = capsys.readouterr()
    assert "2.csv: does not follow its model" in said.out
    assert "of 2 files" in said.out
    document = json.loads((tmp_path / "out" / "monitor.json").read_text(encoding="utf-8"))
    assert document["schema"] == "jaxsr.monitor/1"
    assert {row["stream"] for row in document["alarms"]} == {"2.csv"}
    assert list(document["skipped"]) == [str(folder / "3.csv")]
    assert main(["monitor", model, str(folder), "--normal", normal, "--out", out, "--rate=0"]) == 2


def test_normal_takes_every_file_up_to_the_next_option() -> None:
    assert expand_file_lists(["m", "d", "--normal", "a", "b", "--out", "x"]) == [
        *("m", "d", "--normal", "a", "--normal", "b", "--out", "x")
    ]
