"""The commands' exit statuses, one-line errors, start-up time and Ctrl-C."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import jaxsr
from jaxsr import _demo_command, cli
from jaxsr._progress import Budget
from jaxsr.models import parse_model

ROOT = Path(__file__).resolve().parents[1]


class Recorded:
    """Stand in for the library's calls and keep what they were given."""

    def __init__(self) -> None:
        self.calls: list[dict[str, Any]] = []
        self.during: Any = lambda budget: None

    def __call__(self, *args: Any, **options: Any) -> SimpleNamespace:
        self.calls.append({"args": args, **options})
        run = options.get("run")  # of discover()
        self.during(run.budget if run else options["budget"])
        (run.progress if run else options["progress"]).stage("working")
        return SimpleNamespace(
            verdict="nothing",
            sentence="No mismatch.",
            equations=[],
            summary=lambda: "Verdict: law",
            unread=(),
            columns={},
            save=self.save,
            write=self.write,
        )

    def save(
        self,
        directory: Path,
        budget: Budget | None = None,
        more: Mapping[str, str] | None = None,
    ) -> None:
        directory.mkdir()
        for name, text in {"report.html": "whole", **(more or {})}.items():
            (directory / name).write_text(text)

    def write(self, directory: Path, **options: Any) -> None:
        (directory / "diagnosis.json").write_text("{}")


@pytest.fixture
def library(monkeypatch: pytest.MonkeyPatch) -> Recorded:
    recorded = Recorded()
    reader = SimpleNamespace(from_file=lambda path, table=None: ("simulator", path))
    monkeypatch.setitem(jaxsr.__dict__, "Simulator", reader)
    monkeypatch.setitem(jaxsr.__dict__, "diagnose", recorded)
    monkeypatch.setitem(jaxsr.__dict__, "discover", recorded)
    return recorded


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name in ("m.toml", "a.csv", "b.csv", "v0.csv", "v1.csv", "w.csv"):
        (tmp_path / name).write_text("t,x\n0,0\n")
    (tmp_path / "dangling").symlink_to("absent")
    (tmp_path / "taken" / "report.html").mkdir(parents=True)
    return tmp_path


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """Let Ctrl-C raise, also where the tests run under ``nohup`` or in the background."""
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, previous)


def test_diagnose_passes_each_file_in_its_role(files: Path, library: Recorded, capsys: Any) -> None:
    argv = "diagnose m.toml a.csv b.csv --held-out v0.csv v1.csv --seed 3 --out d".split()
    assert cli.main(argv) == 0
    (call,) = library.calls
    assert call["args"] == (("simulator", "m.toml"), ["a.csv", "b.csv"])
    assert call["held_out"] == ["v0.csv", "v1.csv"] and call["seed"] == 3
    assert call["command"] == "jaxsr " + " ".join(argv)
    captured = capsys.readouterr()
    assert "Verdict: nothing. No mismatch." in captured.out and "d/report.html" in captured.out
    assert re.fullmatch(r"jaxsr: \d+\.\d s: working\n", captured.err)


def test_discover_passes_its_options(files: Path, library: Recorded) -> None:
    argv = (
        "discover a.csv --states z1,z2 --derivatives dz1,dz2 --inputs u --validation b.csv w.csv "
        "--held-out v0.csv --modes 2 --budget 9 --out d"
    )
    assert cli.main(argv.split()) == 0
    (call,) = library.calls
    data, roles = call["args"]
    assert data == ["a.csv"]
    assert roles.states == ("z1", "z2") and roles.derivatives == ("dz1", "dz2")
    assert roles.inputs == ("u",) and call["prior"].modes == "2" and roles.order == 1
    assert call["run"].validation == ["b.csv", "w.csv"]
    assert call["run"].held_out == ["v0.csv"]
    assert 7.0 < call["run"].budget.seconds < 9.0  # the report is written within the budget, too


def test_discover_passes_what_is_known_of_the_law(files: Path, library: Recorded) -> None:
    argv = [
        *"discover a.csv --states q --order 2 --autonomous --checkpoint kept --out d".split(),
        *("--signs", "d_q: d_q=-, Max(q, 0)=+", "--signs", "q: d_q = +"),
        *("--guesses", "d_q: sin(q) - d_q", "--guesses", "d_q: Max(q, 0)"),
        *("--treatment", "smoothing=none, view=weak"),
    ]
    assert cli.main(argv) == 0
    (call,) = library.calls
    roles, prior = call["args"][1], call["prior"]
    assert roles.autonomous and roles.treatment == jaxsr.Treatment(smoothing="none", view="weak")
    assert prior.signs == {"d_q": {"d_q": -1, "Max(q, 0)": 1}, "q": {"d_q": 1}}
    assert prior.guesses == {"d_q": ["sin(q) - d_q", "Max(q, 0)"]}
    assert call["run"].checkpoint == "kept"


@pytest.mark.parametrize(
    ("option", "value", "told"),
    [
        ("--signs", "x=-", "names no state"),
        ("--signs", "x: x", "no term with a sign"),
        ("--signs", "x: x=-2", "no term with a sign"),
        ("--signs", "x: =-", "no term with a sign"),
        ("--signs", "x: x=-, x=+", "stands twice"),
        ("--signs", "x: x + 1=-", "not one term"),
        ("--signs", "y: x=-", "'y' is no state"),
        ("--guesses", "sin(x)", "names no state"),
        ("--guesses", "x: sin(", "guesses of x"),
        ("--guesses", "y: sin(x)", "'y' is no state"),
        ("--treatment", "weak", "says nothing"),
        ("--treatment", "view=weak,view=weak", "says nothing"),
        ("--treatment", "view=sharp", "unknown view"),
        ("--checkpoint", "d", "directory of the results"),
        ("--checkpoint", "a.csv", "--checkpoint a.csv"),
    ],
)
def test_what_is_known_of_a_law_is_refused_in_one_line(
    option: str, value: str, told: str, files: Path, capsys: Any
) -> None:
    assert cli.main([*"discover a.csv --states x --out d".split(), option, value]) == 2
    (*_, error) = capsys.readouterr().err.splitlines()
    assert error.startswith("jaxsr: error: ") and told in error
    assert not Path("d").exists()


def test_a_command_takes_options_in_groups_and_shows_each(capsys: Any) -> None:
    assert cli.main(["discover", "--help"]) == 0
    shown = capsys.readouterr().out
    listed = "autonomous signs guesses treatment checkpoint states order modes held-out budget out"
    assert all(f"  --{name} " in shown for name in listed.split())


@pytest.mark.parametrize(
    "line",
    [
        "nonsense",
        "diagnose",
        "diagnose m.toml a.csv",
        "diagnose m.toml --out d",
        "diagnose a.csv --out d",
        "diagnose m.toml a.csv --out d --nonsense",
        "diagnose m.toml absent.csv --out d",
        "diagnose absent.toml a.csv --out d",
        "diagnose m.toml a.csv --held-out absent.csv --out d",
        "diagnose m.toml a.csv --held-out --out d",
        "diagnose m.toml a.csv --held-out v0.csv a.csv --out d",
        "diagnose m.toml a.csv ./a.csv --out d",
        "diagnose m.toml a.csv --out b.csv",
        "diagnose m.toml a.csv --out b.csv/d",
        "diagnose m.toml a.csv --out d --seed -1",
        "diagnose m.toml a.csv --out d --seed x",
        "diagnose m.toml a.csv --out d --budget 0",
        "diagnose m.toml a.csv --out d --budget nan",
        "diagnose m.toml a.csv --out d --false-claim-cost -1",
        "diagnose a.csv --simulated b.csv w.csv --out d",
        "diagnose a.csv --simulated b.csv --out d",
        "diagnose m.toml a.csv --simulated b.csv --out d",
        "discover a.csv --out d",
        "discover a.csv --states z1, --out d",
        "discover a.csv --states z1,z2 --derivatives dz1 --out d",
        "discover a.csv --states z1 --order 3 --out d",
        "discover a.csv --states z1 --modes many --out d",
        "discover a.csv --states z1 --validation a.csv --out d",
        "simulate a.csv --out f.csv",
        "simulate m.toml --out f.csv",
        "simulate m.toml a.csv --dt 1 --out f.csv",
        "simulate m.toml --duration 1 --dt 0 --out f.csv",
        "simulate m.toml a.csv --out a.csv",
        "simulate m.toml a.csv --out .",
        "simulate m.toml a.csv --out a.csv/f.csv",
        "demo --out a.csv",
        f"diagnose m.toml a.csv --out {'x' * 256}",
        f"diagnose m.toml a.csv --out {'x' * 256}/d",
        f"simulate m.toml a.csv --out {'x' * 256}.csv",
        "diagnose m.toml a.csv --out dangling",
        "diagnose m.toml a.csv --out dangling/d",
        "discover a.csv --states x --out dangling/d/e",
        "simulate m.toml a.csv --out dangling/f.csv",
        "diagnose m.toml a.csv --out taken",
        "diagnose m.toml a.csv --out /proc/d",
        "diagnose m.toml a.csv --held-out /dev/null --out d",
        "datasets fetch nonsense",
    ],
)
def test_wrong_use_is_one_line_and_status_2(
    line: str, files: Path, library: Recorded, capsys: Any
) -> None:
    before = {path.name: path.read_text() for path in files.iterdir() if path.is_file()}
    assert cli.main(line.split()) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("jaxsr: error: ")
    assert captured.err.count("\n") == 1 and "Traceback" not in captured.err
    assert not library.calls
    after = {path.name: path.read_text() for path in files.iterdir() if path.is_file()}
    assert after == before and not any(path.name[0] == "." for path in files.iterdir())


def test_a_learnt_simulator_is_saved_with_the_rest(
    files: Path, library: Recorded, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (
        '[model]\nname = "m"\ntime = "t"\nstates = ["x"]\ninputs = []\noutputs = ["y"]\n'
        '[equations]\nx = "-x"\n[readings]\ny = "x"\n'
    )
    learnt = SimpleNamespace(simulator=SimpleNamespace(model=parse_model(text)))
    monkeypatch.setitem(jaxsr.__dict__, "learn_simulator", lambda *args, **options: learnt)
    assert cli.main("diagnose a.csv --simulated b.csv --out d".split()) == 0
    assert 'x = "-x"' in Path("d/learned.toml").read_text()


def test_a_report_that_breaks_leaves_the_answer(
    files: Path, library: Recorded, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    def save(directory: Path, budget: Any = None) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(tempfile, "tempdir", str(files))
    monkeypatch.setattr(library, "save", save)
    assert cli.main("diagnose m.toml a.csv --out d".split()) == 1
    captured = capsys.readouterr()
    assert "Verdict: nothing" in captured.out and "ZeroDivisionError" in captured.err
    (rescue,) = files.glob("jaxsr-results-*")
    assert f"The results are in {rescue}: diagnosis.json" in captured.err


def test_a_defect_of_ours_shows_its_traceback(files: Path, library: Recorded, capsys: Any) -> None:
    library.during = lambda budget: 1 / 0
    assert cli.main("diagnose m.toml a.csv --out d".split()) == 1
    assert "ZeroDivisionError" in capsys.readouterr().err
    assert not Path("d").exists()


@pytest.mark.usefixtures("ctrl_c")
def test_first_interrupt_keeps_the_best_so_far(files: Path, library: Recorded, capsys: Any) -> None:
    def during(budget: Budget) -> None:
        signal.raise_signal(signal.SIGINT)
        assert budget.interrupted and budget.exhausted

    library.during = during
    assert cli.main("diagnose m.toml a.csv --out d".split()) == 130
    assert Path("d/report.html").read_text() == "whole"
    assert "best so far is in d" in capsys.readouterr().err
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.usefixtures("ctrl_c")
def test_second_interrupt_ends_at_once(files: Path, library: Recorded, capsys: Any) -> None:
    def during(budget: Budget) -> None:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    library.during = during
    assert cli.main("diagnose m.toml a.csv --out d".split()) == 130
    assert not Path("d").exists()
    assert "nothing was written" in capsys.readouterr().err


def test_outside_the_main_thread_no_handler_is_set(files: Path, library: Recorded) -> None:
    status: list[int] = []
    argv = "diagnose m.toml a.csv --out d".split()
    thread = threading.Thread(target=lambda: status.append(cli.main(argv)))
    thread.start()
    thread.join()
    assert status == [0]


def test_demo_knows_its_files() -> None:
    model, train, held_out = _demo_command._files()
    assert all(path.is_file() for path in (model, *train, *held_out))


def run_python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=60
    )


def test_help_is_quick_and_loads_no_numerical_library() -> None:
    code = (
        "import sys; from jaxsr.cli import main; status = main(['--help']);"
        "print(sorted({'jax', 'numpy', 'scipy', 'pandas', 'sympy'} & set(sys.modules)));"
        "sys.exit(status)"
    )
    seconds = []
    for _ in range(3):
        begin = time.perf_counter()
        done = run_python(code)
        seconds.append(time.perf_counter() - begin)
        assert done.returncode == 0
        assert done.stdout.splitlines()[-1] == "[]"
        for command in ("discover", "diagnose", "simulate", "demo", "datasets"):
            assert command in done.stdout
    # The best of three: what the machine does besides is not the program's doing.
    assert min(seconds) < 1.0


@pytest.mark.parametrize(
    "arguments",
    [[], ["-h"], ["--help"], ["datasets"], ["diagnose", "-h"], ["datasets", "list", "-h"]],
)
def test_help_is_what_people_type_for_it(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(arguments) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("Usage: jaxsr") and "-h, --help" in shown


def test_version_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"jaxsr {jaxsr.__version__}\n"


@pytest.mark.long
def test_module_runs_as_a_program_and_quiet_pipe_close_is_no_error() -> None:
    command = [sys.executable, "-m", "jaxsr", "datasets", "list"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=60)
    assert done.returncode == 0 and "emps" in done.stdout
    reader, writer = os.pipe()
    os.close(reader)
    for unbuffered in ("", "1"):
        environment = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
        done = subprocess.run(
            command, stdout=writer, stderr=subprocess.PIPE, cwd=ROOT, timeout=60, env=environment
        )
        assert done.stderr == b"" and done.returncode == 0
    os.close(writer)


def test_namesake_is_named_once(tmp_path: Path) -> None:
    info = tmp_path / "jaxsr-0.3.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: jaxsr\nVersion: 0.3.0\n")
    code = f"import sys; sys.path.append({str(tmp_path)!r}); import jaxsr; import jaxsr.cli"
    done = run_python(code)
    assert done.returncode == 0
    assert done.stderr.count("another project") == 1 and "0.3.0" in done.stderr
    assert run_python("import jaxsr").stderr == ""


@pytest.mark.long
def test_a_diagnosis_loads_what_it_needs_alone() -> None:
    arm = ROOT / "jaxsr" / "datasets" / "demo" / "arm.toml"
    code = (
        f"import sys, jaxsr; jaxsr.diagnose; jaxsr.Simulator.from_file({str(arm)!r});"
        "unused = {'sklearn', 'matplotlib', 'rich', 'sympy', 'pint', 'scipy.signal'};"
        "print(sorted(unused & set(sys.modules)))"
    )
    assert run_python(code).stdout == "[]\n"


def test_importing_changes_nothing_of_jax() -> None:
    assert run_python("import sys, jaxsr; sys.exit('jax' in sys.modules)").returncode == 0
    assert set(jaxsr.__all__) <= set(dir(jaxsr))
    with pytest.raises(AttributeError, match="nonsense"):
        jaxsr.__getattr__("nonsense")
