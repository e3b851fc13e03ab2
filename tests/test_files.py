"""Files appear whole or not at all, whatever step fails."""

from __future__ import annotations

import enum
import errno
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxsr import _files
from jaxsr._files import (
    atomic_directory,
    atomic_write_text,
    check_writable,
    check_writable_directory,
    dump_json,
    mend_directory,
    sha256,
)
from jaxsr._result import InputError

ROOT = Path(__file__).resolve().parents[1]
OLD = {"a.json": "old a", "b.toml": "old b", "stale.png": "old figure"}
NEW = {"a.json": "new a", "b.toml": "new b", "c.html": "new c"}


@pytest.fixture(autouse=True)
def _quick_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not wait for the disk."""
    monkeypatch.setattr(os, "fsync", lambda held: None)


def write(out: Path, files: dict[str, str]) -> None:
    with atomic_directory(out) as folder:
        for name, text in files.items():
            (folder / name).write_text(text)


def visible(out: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in out.iterdir() if path.name[0] != "."}


def hidden(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir() if path.name[0] == "."} - {_files._MANIFEST}


def test_new_files_replace_those_of_the_last_run_and_no_others(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    write(out, OLD)
    assert visible(out) == OLD
    (out / "notes.txt").write_text("mine")
    (out / "mine").mkdir()
    (out / "mine" / "x.csv").write_text("mine")
    write(out, NEW)
    shutil.rmtree(out / "mine")
    assert visible(out) == NEW | {"notes.txt": "mine"}
    assert hidden(out) == hidden(out.parent) == set()


def test_the_current_directory_can_be_the_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write(Path("."), OLD)
    write(Path("."), NEW)
    assert visible(tmp_path) == NEW and Path.cwd() == tmp_path


def test_results_have_the_permissions_of_plain_files(tmp_path: Path) -> None:
    write(tmp_path / "out", NEW)
    (tmp_path / "plain").mkdir()
    assert (tmp_path / "out").stat().st_mode == (tmp_path / "plain").stat().st_mode
    atomic_write_text(tmp_path / "one.txt", "x")
    (tmp_path / "two.txt").write_text("x")
    assert (tmp_path / "one.txt").stat().st_mode == (tmp_path / "two.txt").stat().st_mode


class Injected(Exception):
    pass


def failing(monkeypatch: pytest.MonkeyPatch, at: int, error: type[BaseException]) -> list[str]:
    """Make the `at`-th step that touches the disk fail; return the list of steps taken."""
    steps: list[str] = []

    def wrap(owner: Any, name: str) -> None:
        real: Callable[..., Any] = getattr(owner, name)

        def step(*args: Any, **options: Any) -> Any:
            steps.append(name)
            if len(steps) - 1 == at:
                raise error
            return real(*args, **options)

        monkeypatch.setattr(owner, name, step)

    for name in ("rename", "replace"):
        wrap(os, name)
    wrap(shutil, "copy2")
    wrap(Path, "unlink")
    wrap(Path, "write_text")
    return steps


FOREIGN = {"notes.txt": "mine"}


def made(out: Path, kind: str) -> dict[str, str]:
    """Make `out` as an earlier run left it, alone or among files of others; return its files."""
    if kind == "new":
        return {}
    write(out, OLD)
    if kind == "alone":
        return OLD
    (out / "notes.txt").write_text("mine")
    return OLD | FOREIGN


@pytest.mark.parametrize("error", [Injected, KeyboardInterrupt])
@pytest.mark.parametrize("kind", ["new", "alone", "shared"])
def test_a_failure_at_any_step_leaves_old_or_new(
    tmp_path: Path, kind: str, error: type[BaseException]
) -> None:
    failed = 0
    for at in range(60):
        out = tmp_path / f"out{at}"
        old = made(out, kind)
        new = NEW | (FOREIGN if kind == "shared" else {})
        with pytest.MonkeyPatch.context() as patch:
            steps = failing(patch, at, error)
            try:
                write(out, NEW)
            except error:
                failed += 1
                assert len(steps) > at
        if len(steps) <= at:
            break
        left = visible(out) if out.exists() else {}
        assert left in (old, new), f"step {at}: {steps}"
        write(out, NEW)
        assert visible(out) == new
        assert hidden(out) == set()
    assert visible(out) == new
    assert failed >= (12 if kind == "shared" else 4), "the failures were not injected"
    assert hidden(tmp_path) == set()


KILLED = """
import os, signal, sys
from pathlib import Path
from jaxsr import _files
os.fsync = lambda held: None
steps = 0
def wrap(owner, name):
    real = getattr(owner, name)
    def step(*args, **options):
        global steps
        if steps == at:
            os.kill(os.getpid(), signal.SIGKILL)
        steps += 1
        return real(*args, **options)
    setattr(owner, name, step)
for owner, name in ((os, "rename"), (os, "replace"), (os, "rmdir"), (_files, "_exchange")):
    wrap(owner, name)
for at, out in enumerate(sys.argv[1:]):
    child = os.fork()
    if child == 0:
        with _files.atomic_directory(Path(out)) as folder:
            for name in ("a.json", "b.toml", "c.html"):
                (folder / name).write_text("new " + name[0])
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.parametrize("kind", ["new", "alone", "shared"])
def test_a_kill_at_any_rename_leaves_old_or_new(tmp_path: Path, kind: str) -> None:
    outs = [tmp_path / f"out{at}" / "out" for at in range(16)]
    for out in outs:
        out.parent.mkdir()
        old = made(out, kind)
    new = NEW | (FOREIGN if kind == "shared" else {})
    done = subprocess.run(
        [sys.executable, "-c", KILLED, *map(str, outs)], cwd=ROOT, capture_output=True, text=True
    )
    statuses = [int(line) for line in done.stdout.split()]
    killed = statuses.index(0)
    assert set(statuses[:killed]) == {-signal.SIGKILL} and set(statuses[killed:]) == {0}
    for out in outs[:killed]:
        if kind != "shared":  # whoever reads meets one run's files, without any mending
            assert (visible(out) if out.exists() else {}) in (old, new)
        mend_directory(out)
        assert (visible(out) if out.exists() else {}) in (old, new)
        assert (hidden(out) if out.exists() else set()) == hidden(out.parent) == set()
    # Alone: the check's folder away, the exchange, the old files away. Shared: also each of four
    # files, the backup in place and away.
    assert killed >= {"new": 2, "alone": 3, "shared": 8}[kind]
    assert visible(outs[-1]) == new


WRITER = """
import sys, time
from pathlib import Path
from jaxsr._files import atomic_directory
out, number = Path(sys.argv[1]), 0
print(flush=True)
while True:
    number += 1
    with atomic_directory(out) as folder:
        for name in "abcdef":
            (folder / name).write_text(str(number) * 50_000)
        if number % 2:
            (folder / "odd").write_text(str(number) * 50_000)
"""


def runs_of(out: Path) -> set[str]:
    """Return which runs' files stand in `out`; each run's are complete, or this fails."""
    texts = visible(out)
    texts.pop("notes.txt", None)
    runs = {text[: len(text) // 50_000] for text in texts.values()}
    for text in texts.values():
        assert text == text[: len(text) // 50_000] * 50_000
    if runs:
        (number,) = runs
        assert set(texts) == set("abcdef") | ({"odd"} if int(number) % 2 else set())
    return runs


def kill_at_random(out: Path, kills: int, seed: int, shared: bool) -> None:
    rng = np.random.default_rng(seed)
    out.mkdir()
    if shared:
        (out / "notes.txt").write_text("mine")
    for _ in range(kills):
        command = [sys.executable, "-c", WRITER, str(out)]
        writer = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE)
        assert writer.stdout is not None and writer.stdout.readline()
        time.sleep(rng.uniform(0.0, 0.3))
        writer.kill()
        writer.communicate()
        if not shared:
            runs_of(out)
        mend_directory(out)
        runs_of(out)
        assert hidden(out) == hidden(out.parent) == set()
    assert runs_of(out), "no run came to its end"


@pytest.mark.parametrize("shared", [False, True])
def test_kills_at_random_moments(tmp_path: Path, shared: bool) -> None:
    kill_at_random(tmp_path / "out", 3, 0, shared)


@pytest.mark.slow
@pytest.mark.parametrize("shared", [False, True])
def test_fifty_kills_at_random_moments(tmp_path: Path, shared: bool) -> None:
    kill_at_random(tmp_path / "out", 50, 1, shared)


def test_a_reader_never_meets_files_of_two_runs(tmp_path: Path) -> None:
    out = tmp_path / "out"
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(out)], cwd=ROOT)
    reads, end = 0, time.monotonic() + 2.0
    while time.monotonic() < end:
        try:
            folder = os.open(out, os.O_RDONLY)  # as one who has opened the folder sees it
        except FileNotFoundError:
            continue
        names = [name for name in os.listdir(folder) if name[0] != "."]
        try:
            parts = [os.open(name, os.O_RDONLY, dir_fd=folder) for name in names]
        except FileNotFoundError:  # removed with the old folder while it was being read
            parts = []
        texts = set()
        for part in parts:
            texts.add(os.read(part, 16))
            os.close(part)
        os.close(folder)
        assert len(texts) <= 1
        reads += bool(texts)
    writer.kill()
    writer.wait()
    assert reads > 10


def test_litter_of_the_dead_is_swept_and_that_of_the_living_stays(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(out, OLD)
    code = (
        "import os, signal, sys; from pathlib import Path; from jaxsr import _staging;"
        "a = _staging.staging_folder(Path(sys.argv[1])); a.__enter__();"
        "b = _staging.staging_file(Path(sys.argv[1])); b.__enter__();"
        "print(1, flush=True); sys.stdin.read()"
    )
    living = [
        subprocess.Popen(
            [sys.executable, "-c", code, str(place)],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        for place in (tmp_path, out)
    ]
    for process in living:
        assert process.stdout is not None and process.stdout.readline() == b"1\n"
    mend_directory(out)
    assert len(hidden(tmp_path)) == len(hidden(out)) == 2
    for process in living:
        process.kill()
        process.communicate()
    write(out, NEW)
    assert hidden(tmp_path) == hidden(out) == set()


def test_a_half_removed_backup_is_not_rolled_back(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(out, NEW)
    (out / ".jaxsr-staging-killed").mkdir()
    (out / ".jaxsr-staging-killed" / "a.json").write_text("old a")
    mend_directory(out)
    assert visible(out) == NEW and hidden(out) == set()


def test_links_to_results_stay_links(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    (tmp_path / "link").symlink_to("far")
    for files in (OLD, NEW):
        write(tmp_path / "link", files)
        assert (tmp_path / "link").is_symlink() and visible(tmp_path / "far") == files
    assert hidden(tmp_path) == hidden(tmp_path / "far") == set()


def test_where_folders_cannot_change_places_files_are_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    write(out, OLD)
    monkeypatch.setattr(_files, "_exchange", lambda one, other: False)
    same = out.stat().st_ino
    write(out, NEW)
    assert visible(out) == NEW and out.stat().st_ino == same
    assert hidden(out) == hidden(tmp_path) == set()


def test_a_folder_that_somebody_is_in_stays_the_same_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(out, OLD)
    same = out.stat().st_ino
    guest = subprocess.Popen(["sleep", "60"], cwd=out)
    write(out, NEW)
    guest.kill()
    guest.wait()
    assert visible(out) == NEW and out.stat().st_ino == same and hidden(out) == set()
    out.chmod(0o2770)
    write(out, OLD)
    assert visible(out) == OLD and out.stat().st_mode & 0o7777 == 0o2770


@pytest.mark.parametrize("number", [errno.EIO, errno.EFBIG, errno.EDQUOT, errno.ENOSPC])
def test_a_disk_that_fails_is_one_line(
    tmp_path: Path, number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(held: int) -> None:
        raise OSError(number, os.strerror(number))

    for kind in ("new", "alone", "shared"):
        out = tmp_path / kind
        old = made(out, kind)
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", full)
            with pytest.raises(InputError, match="cannot be written"):
                write(out, NEW)
        with pytest.raises(InputError, match="cannot be written"), atomic_directory(out):
            raise OSError(number, os.strerror(number))
        assert (visible(out) if out.exists() else {}) == old
        assert hidden(tmp_path) == set()
    # What else is missing is no fault of the disk.
    with pytest.raises(FileNotFoundError), atomic_directory(tmp_path / "new"):
        open(tmp_path / "absent")


def test_a_body_that_fails_writes_nothing(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(Injected), atomic_directory(out) as folder:
        (folder / "a.json").write_text("half")
        raise Injected
    assert list(tmp_path.iterdir()) == []


def test_directories_inside_results(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="flat"), atomic_directory(tmp_path / "out") as folder:
        (folder / "inner").mkdir()
    assert list(tmp_path.iterdir()) == []


def test_unwritable_places_are_refused_early(tmp_path: Path) -> None:
    # Permission bits do not bind root: a path below a regular file, and /proc, do.
    file = tmp_path / "file"
    file.write_text("")
    for path in (file / "out", file / "deep" / "out", Path("/proc/out")):
        with pytest.raises(InputError, match="cannot be written"):
            check_writable_directory(path)
        with pytest.raises(InputError, match="cannot be written"):
            atomic_write_text(path, "text")
    with pytest.raises(InputError, match="not a directory"):
        check_writable_directory(file)
    check_writable(tmp_path / "a" / "b" / "c.csv")
    assert list(tmp_path.iterdir()) == [file]


def test_names_and_links_that_cannot_be_are_refused_early(tmp_path: Path) -> None:
    (tmp_path / "dangling").symlink_to(tmp_path / "absent")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    long = tmp_path / ("x" * 256)
    deep = tmp_path.joinpath(*["x" * 200] * 21)
    for path in (tmp_path / "dangling", tmp_path / "loop", long, long / "out", deep):
        for place in (path, path / "out"):
            with pytest.raises(InputError, match="cannot be written"):
                check_writable_directory(place)
        with pytest.raises(InputError, match="cannot be written"):
            check_writable(path / "run.csv")
    with pytest.raises(InputError, match="null"):
        check_writable_directory(tmp_path / "a\0b")
    with pytest.raises(InputError, match="no plain file"):
        check_writable(Path("/dev/null"))
    assert {path.name for path in tmp_path.iterdir()} == {"dangling", "loop"}
    longest = tmp_path / ("x" * 255)
    check_writable(longest)
    atomic_write_text(longest, "text")
    check_writable_directory(tmp_path / ("y" * 255))
    write(tmp_path / ("y" * 255), NEW)


def test_text_is_replaced_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "m.toml"
    atomic_write_text(path, "old\n")
    with monkeypatch.context() as patch:
        failing(patch, 0, KeyboardInterrupt)
        with pytest.raises(KeyboardInterrupt):
            atomic_write_text(path, "new\n")
    assert path.read_text() == "old\n" and list(tmp_path.iterdir()) == [path]
    atomic_write_text(path, "naïve\n")
    assert path.read_bytes() == "naïve\n".encode()


def test_checksum(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"abc" * 100_000)
    assert sha256(tmp_path / "x") == hashlib.sha256(b"abc" * 100_000).hexdigest()


class Colour(enum.StrEnum):
    RED = "red"


@dataclass(frozen=True)
class Point:
    x: float
    y: Any


def test_json_is_plain() -> None:
    obj = {
        "nan": float("nan"),
        "array": np.array([[1.0, np.nan], [np.inf, 2.0]]),
        "scalars": (np.float64(0.1), np.float32(0.5), np.int64(3), np.bool_(True), None),
        "point": Point(np.float64("-inf"), Colour.RED),
        "path": Path("a/b"),
        "set": {"b", "a"},
        "micro": "µ",
        1: "key",
    }
    assert json.loads(dump_json(obj), parse_constant=pytest.fail) == {
        "nan": None,
        "array": [[1.0, None], [None, 2.0]],
        "scalars": [0.1, 0.5, 3, True, None],
        "point": {"x": None, "y": "red"},
        "path": "a/b",
        "set": ["a", "b"],
        "micro": "µ",
        "1": "key",
    }
    with pytest.raises(TypeError, match="object"):
        dump_json([object()])
