"""Files appear whole or not at all, whatever step fails."""

from __future__ import annotations

import enum
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
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
    sha256,
)
from jaxsr._result import InputError

OLD = {"a.json": "old a", "b.toml": "old b", "stale.png": "old figure"}
NEW = {"a.json": "new a", "b.toml": "new b", "c.html": "new c"}


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


@pytest.mark.parametrize("error", [Injected, KeyboardInterrupt])
@pytest.mark.parametrize("exists", [True, False])
def test_a_failure_at_any_step_leaves_old_or_new(
    tmp_path: Path, exists: bool, error: type[BaseException]
) -> None:
    failed = 0
    for at in range(60):
        out = tmp_path / f"out{at}"
        if exists:
            write(out, OLD)
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
        assert left == (OLD if exists else {}) or left == NEW, f"step {at}: {steps}"
        write(out, NEW)
        assert visible(out) == NEW
        assert hidden(out) == set()
    assert visible(out) == NEW
    assert failed >= (12 if exists else 4), "the failures were not injected"
    assert hidden(tmp_path) == set()


KILLED = """
import os, shutil, signal, sys
from pathlib import Path
from jaxsr._files import atomic_directory
at, out = int(sys.argv[1]), Path(sys.argv[2])
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
for name in ("rename", "replace"):
    wrap(os, name)
with atomic_directory(out) as folder:
    for name in ("a.json", "b.toml", "c.html"):
        (folder / name).write_text("new " + name[0])
"""


def test_a_kill_between_renames_is_mended_by_the_next_run(tmp_path: Path) -> None:
    root = Path(__file__).resolve().parents[1]
    killed = 0
    for at in range(8):
        out = tmp_path / f"out{at}"
        write(out, OLD)
        done = subprocess.run([sys.executable, "-c", KILLED, str(at), str(out)], cwd=root)
        if done.returncode == 0:
            break
        assert done.returncode == -signal.SIGKILL
        killed += 1

        # A next run that fails before it has anything new leaves the complete old or new files.
        with pytest.raises(Injected), atomic_directory(out):
            raise Injected
        assert visible(out) in (OLD, NEW)
    assert killed == 6  # backup in place, four files and the list of names, backup away
    assert visible(out) == NEW


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
