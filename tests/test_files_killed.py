"""Files appear whole or not at all, whenever a process is killed or reads."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from whole_files import FOREIGN, NEW, hidden, made, visible

from jaxsr._files import (
    mend_directory,
)

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(autouse=True)
def _quick_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not wait for the disk."""
    monkeypatch.setattr(os, "fsync", lambda held: None)


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


@pytest.mark.long
@pytest.mark.parametrize("shared", [False, True])
def test_kills_at_random_moments(tmp_path: Path, shared: bool) -> None:
    kill_at_random(tmp_path / "out", 3, 0, shared)


@pytest.mark.slow
@pytest.mark.parametrize("shared", [False, True])
def test_fifty_kills_at_random_moments(tmp_path: Path, shared: bool) -> None:
    kill_at_random(tmp_path / "out", 50, 1, shared)


@pytest.mark.long
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
