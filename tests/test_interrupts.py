"""Signals end a command at any moment: exit status 130, the best so far whole or nothing."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from jaxsr._process import Run

ROOT = Path(__file__).resolve().parents[1]
ARM = ROOT / "jaxsr" / "datasets" / "demo"

WHOLE_PROGRAM = """
print(flush=True)
import runpy
runpy.run_module("jaxsr", run_name="__main__", alter_sys=True)
"""

QUICK_PROGRAM = """
import sys, time
began = time.monotonic()
from pathlib import Path
from types import SimpleNamespace
from jaxsr.__main__ import main
from jaxsr._process import listen
listen()
for name in ("jaxsr.evaluation", "jaxsr.report.page", "matplotlib.figure"):  # slow to load
    sys.modules[name] = SimpleNamespace(keep_compiled=lambda: None)
import jaxsr
from jaxsr._files import atomic_directory, atomic_write_text


def write(folder, **options):
    atomic_write_text(folder / "diagnosis.json", "{}")
    if "slow" in sys.argv[-1]:
        print("saving", flush=True)
        time.sleep(60)
    atomic_write_text(folder / "report.html", "x" * 1_000_000)


def save(out, **options):
    with atomic_directory(Path(out)) as folder:
        write(folder)


def diagnose(simulator, data, *, budget, progress, **options):
    assert budget.elapsed >= time.monotonic() - began
    print("searching", flush=True)
    while not budget.exhausted:
        time.sleep(0.01)
    said = {"verdict": "nothing", "sentence": "No mismatch.", "unread": ()}
    return SimpleNamespace(**said, save=save, write=write)


jaxsr.diagnose = diagnose
jaxsr.Simulator = SimpleNamespace(from_file=lambda path, *tables: path)
sys.exit(main())
"""


@pytest.fixture
def files(tmp_path: Path) -> Path:
    for name in ("m.toml", "a.csv"):
        (tmp_path / name).write_text("t,x\n0,0\n")
    return tmp_path


def started(
    program: str, folder: Path, *argv: str, first: Callable[[], object] | None = None
) -> subprocess.Popen[str]:
    """Start a program in `folder`; `first` is what its process does before."""

    def before() -> None:  # also where the tests run under `nohup` or in the background
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        if first is not None:
            first()

    return subprocess.Popen(
        [sys.executable, "-c", program, *argv],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "JAXSR_CLOCK": "wall"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=before,
    )


def quick(folder: Path, *options: str, first: Callable[[], object] | None = None):
    """Start a diagnosis that searches until it is asked to end."""
    argv = ("diagnose", "m.toml", "a.csv", "--out", *(options or ("d",)))
    process = started(QUICK_PROGRAM, folder, *argv, first=first)
    assert process.stdout is not None and process.stdout.readline() == "searching\n"
    return process


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    out, err = process.communicate(timeout=120)
    assert "Traceback" not in err
    return process.returncode, out, err


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_keeps_the_best_so_far(files: Path, number: int) -> None:
    process = quick(files)
    process.send_signal(number)
    if number != signal.SIGINT:  # what supervisors send again is the same request
        time.sleep(0.2)
        process.send_signal(number)
    status, out, err = ended(process)
    assert status == 130 and "best so far is in d" in err and "No mismatch." in out
    assert names(files) == {"m.toml", "a.csv", "d"}
    assert names(files / "d") == {"diagnosis.json", "report.html", ".jaxsr-files"}


@pytest.mark.long
def test_a_second_interrupt_drops_the_work_without_litter(files: Path) -> None:
    process = quick(files, "slow")
    process.send_signal(signal.SIGINT)
    assert process.stdout is not None and process.stdout.readline() == "saving\n"
    assert any(name.startswith(".jaxsr-staging") for name in names(files))
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    status, out, err = ended(process)
    assert status == 130 and out == "" and "nothing was written" in err
    assert names(files) == {"m.toml", "a.csv"}


def test_the_echo_of_a_request_is_no_second_one(monkeypatch: pytest.MonkeyPatch) -> None:
    now, dropped = [0.0], []
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    run = Run(0.0, dropped.append, echo=0.1)
    run.keeps = True
    for moment, number, drops in [
        (1.0, signal.SIGINT, 0),
        (1.05, signal.SIGINT, 0),
        (2.0, signal.SIGTERM, 0),
        (2.1, signal.SIGINT, 1),
    ]:
        now[0] = moment
        run.hear(number, None)
        assert len(dropped) == drops and run.asked.is_set()
    early = Run(0.0, dropped.append)  # nothing to keep yet
    early.hear(signal.SIGTERM, None)
    assert len(dropped) == 2


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_what_the_parent_ignores_stays_ignored(files: Path, number: int) -> None:
    process = quick(files, first=lambda: signal.signal(number, signal.SIG_IGN))
    process.send_signal(number)
    time.sleep(0.2)
    assert process.poll() is None and names(files) == {"m.toml", "a.csv"}
    process.send_signal(signal.SIGTERM)
    assert ended(process)[0] == 130 and "report.html" in names(files / "d")


@pytest.mark.long
def test_a_reader_that_left_loses_no_work(files: Path) -> None:
    process = quick(files)
    assert process.stdout is not None and process.stderr is not None
    process.stdout.close()
    process.stderr.close()
    process.send_signal(signal.SIGHUP)
    assert process.wait(timeout=60) == 130
    assert "report.html" in names(files / "d")


@pytest.mark.long
def test_results_that_do_not_fit_are_saved_elsewhere(
    files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = files / "temporary"
    elsewhere.mkdir()
    monkeypatch.setenv("TMPDIR", str(elsewhere))
    size = 100_000, 100_000
    process = quick(files, first=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, size))
    process.send_signal(signal.SIGINT)
    status, out, err = ended(process)
    assert status == 2 and "No mismatch." in out
    (error,) = [line for line in err.splitlines() if "error" in line]
    (rescue,) = elsewhere.iterdir()
    assert "File too large" in error and str(rescue) in error and "diagnosis.json" in error
    assert names(rescue) == {"diagnosis.json"}
    assert names(files) == {"m.toml", "a.csv", "temporary"}


def processor_time(process: subprocess.Popen[str]) -> float:
    """Return the seconds that a process has worked."""
    words = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def interrupt(folder: Path, moment: float, seconds: float) -> tuple[int, str]:
    """Interrupt a diagnosis that has worked a `moment` in its interpreter; check what it leaves."""
    argv = ("diagnose", str(ARM / "arm.toml"), str(ARM / "set1_train.csv"), "--out", "d")
    process = started(WHOLE_PROGRAM, folder, *argv, "--budget", str(seconds))
    assert process.stdout is not None and process.stdout.readline() == "\n"
    until = processor_time(process) + moment
    while process.poll() is None and processor_time(process) < until:
        time.sleep(0.002)
    process.send_signal(signal.SIGINT)
    status, _, err = ended(process)
    if (folder / "d").exists():
        assert {"diagnosis.json", "explained.toml", "report.html"} <= names(folder / "d")
    else:
        assert "nothing was written" in err
    assert names(folder) <= {"d"}
    return status, err


@pytest.mark.long
@pytest.mark.parametrize("moment", [0.05, 0.2, 0.6, 1.2])
def test_an_interrupt_while_libraries_load(tmp_path: Path, moment: float) -> None:
    assert interrupt(tmp_path, moment, 5.0)[0] == 130


@pytest.mark.long
def test_the_run_begins_with_the_process() -> None:
    code = (
        "import time; now = time.monotonic(); from jaxsr._process import _process_began;"
        "print(now - _process_began())"
    )

    def before(command: list[str]) -> float:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
        return float(done.stdout)

    assert -0.5 < before([sys.executable, "-c", code]) <= 2.0
    # What a wrapper waited for before it became this program is not the run's time.
    waited = ["sh", "-c", 'sleep 2.1; exec "$@"', "sh", sys.executable, "-c", code]
    assert -0.5 < before(waited) <= 0.0


@pytest.mark.slow
def test_interrupts_at_fifty_moments(tmp_path: Path) -> None:
    for moment in np.geomspace(0.05, 12.0, 50):
        folder = tmp_path / f"{moment:.3f}"
        folder.mkdir()
        status, err = interrupt(folder, moment, 8.0)
        # A diagnosis that was done before is a whole one.
        assert status == 130 or (status == 0 and "interrupted" not in err), moment


def test_the_program_does_what_is_registered_for_its_end_and_is_gone(monkeypatch) -> None:
    """Taking down what numerical libraries hold would last most of a second beyond the budget."""
    from jaxsr import __main__ as program

    done: list[object] = []
    monkeypatch.setattr(program, "main", lambda: 3)
    monkeypatch.setattr("atexit._run_exitfuncs", lambda: done.append("registered"))
    monkeypatch.setattr("os._exit", done.append)
    program.program()
    assert done == ["registered", 3]
