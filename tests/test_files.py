"""Files appear whole or not at all, whatever step fails."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from whole_files import FOREIGN, NEW, OLD, hidden, made, visible, write

from jaxsr import _files
from jaxsr._files import (
    atomic_directory,
    atomic_write_text,
    check_writable,
    check_writable_directory,
    mend_directory,
)
from jaxsr._result import InputError

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(autouse=True)
def _quick_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not wait for the disk."""
    monkeypatch.setattr(os, "fsync", lambda held: None)


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
