"""A batch on a scheduler of its own: workers and the scheduler die, nothing is lost or double."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from batch_stand_in import DOCUMENT, MODEL, stand_in
from test_batch import DECAY, but_for_seconds, record

import jaxsr
from jaxsr import cli
from jaxsr.batch import Case, cluster, diagnose_many, engine
from jaxsr.batch.claim import claimed
from jaxsr.batch.task import NOT_BEGUN

PATIENCE = 60.0


class Machines:
    """A scheduler and its workers, processes that can be killed."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self.folder = folder
        self.address = ""
        self.all: list[subprocess.Popen[bytes]] = []

    def start(self, *words: str) -> subprocess.Popen[bytes]:
        """Start a program of Dask, in a directory that is not that of the cases."""
        here = Path(jaxsr.__file__).parents[1]
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(here), str(here / "tests")]),
        }
        process = subprocess.Popen(
            [sys.executable, "-m", *words],
            cwd=self.folder,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        self.all.append(process)
        return process

    def scheduler(self, port: str = "0") -> subprocess.Popen[bytes]:
        file = self.folder / "scheduler.json"
        file.unlink(missing_ok=True)
        process = self.start(
            *("distributed.cli.dask_scheduler", "--port", port, "--no-dashboard"),
            *("--host", "127.0.0.1", "--scheduler-file", str(file)),
        )
        until(file.exists)
        until(lambda: '"address"' in file.read_text())
        self.address = file.read_text().split('"address": "')[1].split('"')[0]
        return process

    def worker(self) -> subprocess.Popen[bytes]:
        return self.start(
            *("distributed.cli.dask_worker", self.address, "--nthreads", "1"),
            *("--no-nanny", "--no-dashboard", "--host", "127.0.0.1"),
        )


def until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.fixture
def machines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Machines]:
    pytest.importorskip("distributed")
    (tmp_path / "cases").mkdir()
    monkeypatch.chdir(tmp_path / "cases")
    started = Machines(tmp_path / "elsewhere")
    try:
        yield started
    finally:
        for process in started.all:
            process.kill()
            process.wait()


def words(word: str) -> Counter[str]:
    """Return how often each case did what the log says with a word."""
    log = Path("out/log.txt")
    lines = log.read_text().splitlines() if log.exists() else []
    return Counter(line.split()[1] for line in lines if line.split()[0] == word)


@contextmanager
def killing(process: subprocess.Popen[bytes], when: Callable[[], bool]) -> Iterator[None]:
    """Kill a process outright as soon as something is true."""
    over = threading.Event()

    def watch() -> None:
        while not over.is_set() and not when():
            time.sleep(0.02)
        if not over.is_set():
            process.send_signal(signal.SIGKILL)

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@pytest.mark.long
def test_workers_and_the_scheduler_die_and_every_case_ends_once(
    machines: Machines, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(engine, "_task", stand_in)
    monkeypatch.setattr(cluster, "PATIENCE", 5.0)
    Path("m.toml").write_text(MODEL)
    Path("a.csv").write_text("t,x\n0,1\n")
    names = [f"case_{k}" for k in range(6)]
    cases = {name: Case("m.toml", "a.csv") for name in names}
    listed = "".join(f'[cases.{n}]\nmodel = "m.toml"\ndata = "a.csv"\n' for n in names)
    Path("cases.toml").write_text(listed)

    scheduler = machines.scheduler()
    first = machines.worker()
    machines.worker()
    with killing(first, lambda: words("ended").total() >= 2):
        fleet = diagnose_many(cases, "out", scheduler=machines.address)
    assert first.poll() is not None and list(fleet) == names and not fleet.failures
    # What the killed worker ran ended with it, and was begun by the other one.
    assert words("ended") == Counter(names) and words("began").total() <= 7
    assert not list(Path("out").glob(".*.running"))

    Path("out/log.txt").unlink()
    command = ["batch", "cases.toml", "--out", "out", "--scheduler"]
    with killing(scheduler, lambda: words("ended").total() >= 2):
        assert cli.main([*command, machines.address]) == 2
    said = capsys.readouterr().err
    assert said.splitlines()[-1].startswith("jaxsr: error: ") and "--resume goes on" in said
    assert "Traceback" not in said
    done = words("ended")
    assert 2 <= done.total() < 6
    machines.scheduler()
    machines.worker()
    assert cli.main([*command, machines.address, "--resume"]) == 0
    assert words("ended") == Counter(names)


def test_what_was_given_up_and_goes_on_is_not_done_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second worker waits for the first, which a scheduler believed dead, and takes its word."""
    monkeypatch.chdir(tmp_path)
    Path("m.toml").write_text(MODEL)
    Path("a.csv").write_text("t,x\n0,1\n")
    task = engine.Task("case", Case("m.toml", "a.csv"), "out", str(tmp_path))
    outcomes: list[engine.Outcome] = []
    both = [threading.Thread(target=lambda: outcomes.append(stand_in(task))) for _ in range(2)]
    for thread in both:
        thread.start()
    for thread in both:
        thread.join()
    assert [outcome.done for outcome in outcomes] == [True, True]
    assert words("began") == words("ended") == Counter(["case"])
    with claimed(task.claim, lambda: False) as held:
        assert held is not None
        with claimed(task.claim, lambda: True) as other:
            assert other is None
    assert (
        not task.claim.exists() and (tmp_path / "out/case/diagnosis.json").read_text() == DOCUMENT
    )


@dataclass(eq=False)
class Given:
    """A future of the client below."""

    key: str
    status: str = "pending"


class Client:
    """A client of Dask whose futures do what they are told."""

    status = "running"

    def __init__(self) -> None:
        self.given: list[Any] = []

    def submit(self, work: Any, task: Any, *, key: str, pure: bool) -> Any:
        self.given.append(Given(key))
        return self.given[-1]


@pytest.mark.parametrize("status", ["lost", "cancelled"])
def test_what_dask_loses_is_given_out_once_more(tmp_path: Path, status: str) -> None:
    client = Client()
    futures = cluster.Futures(client, stand_in)
    task = engine.Task("case", Case("m.toml", "a.csv"), "out", str(tmp_path))
    futures.submit(task)
    assert not list(futures.ended())
    client.given[0].status = status
    client.status = "connecting"  # its scheduler may come back
    assert not list(futures.ended()) and len(client.given) == 1
    client.status = "running"
    assert not list(futures.ended()) and len(client.given) == 2
    assert client.given[0].key != client.given[1].key
    client.given[1].status = status
    (outcome,) = futures.ended()
    assert outcome.message == "lost twice by Dask" and outcome.repeatable and not len(futures)

    futures.submit(task)
    client.given[2].status, client.status = status, "closed"
    with pytest.raises(jaxsr.InputError, match="the scheduler is gone"):
        list(futures.ended())
    task.mark.parent.mkdir()
    task.mark.write_text("")  # what its process wrote counts, who heard of it or not
    (outcome,) = futures.ended()
    assert outcome.done and not len(futures)


def test_workers_that_are_asked_to_end_begin_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    began: list[str] = []

    def run(task: engine.Task, stop: Callable[[], bool]) -> engine.Outcome:
        if stop():
            return engine.Outcome(task.name, 130, NOT_BEGUN)
        began.append(task.name)
        while not stop():
            time.sleep(0.02)
        return engine.Outcome(task.name, 130)

    monkeypatch.setattr(engine, "run_task", run)
    case = Case("m.toml", "a.csv")
    tasks = [engine.Task(f"case_{k}", case, "out", str(tmp_path)) for k in range(9)]
    asked = engine.Engine(workers=2, stop=lambda: len(began) >= 2)
    ended = [outcome.name for outcome in asked.outcomes(tasks)]
    assert sorted(ended) == sorted(began) and 2 <= len(ended) < 9


@pytest.mark.slow
def test_a_scheduler_that_comes_back_is_used_again(
    machines: Machines, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "_task", stand_in)
    Path("m.toml").write_text(MODEL)
    Path("a.csv").write_text("t,x\n0,1\n")
    names = [f"case_{k}" for k in range(5)]
    scheduler = machines.scheduler()
    machines.worker()
    address = machines.address

    def restart() -> bool:
        if words("ended").total() < 1:
            return False
        scheduler.kill()
        scheduler.wait()
        machines.scheduler(port=address.rpartition(":")[2])
        machines.worker()
        return True

    with killing(scheduler, restart):
        fleet = diagnose_many(
            {name: Case("m.toml", "a.csv") for name in names}, "out", scheduler=address
        )
    assert machines.address == address and list(fleet) == names
    assert words("ended") == Counter(names)


@pytest.mark.slow
def test_diagnoses_of_a_worker_that_was_killed_are_those_of_single_runs(
    machines: Machines,
) -> None:
    for k, name in enumerate(("a", "b", "c")):
        record(f"{name}.csv", 0.8 + 0.2 * k, k)
    Path("decay.toml").write_text(DECAY)
    cases = {name: Case("decay.toml", f"{name}.csv") for name in ("a", "b", "c")}
    machines.scheduler()
    first = machines.worker()
    machines.worker()
    with killing(first, lambda: len(list(Path("out").glob(".*.running"))) == 2):
        fleet = diagnose_many(cases, "out", scheduler=machines.address)
    assert first.poll() is not None and list(fleet) == ["a", "b", "c"] and not fleet.failures
    os.rename("out", "kept")
    for name, case in cases.items():
        assert cli.main(case.arguments(f"out/{name}")) == 0
        for path in Path("out", name).iterdir():
            assert but_for_seconds(path) == but_for_seconds(Path("kept", name, path.name))
