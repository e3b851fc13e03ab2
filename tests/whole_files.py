"""Results of earlier and later runs, and what is seen of them."""

from __future__ import annotations

from pathlib import Path

from jaxsr import _files
from jaxsr._files import (
    atomic_directory,
)

OLD = {"a.json": "old a", "b.toml": "old b", "stale.png": "old figure"}
NEW = {"a.json": "new a", "b.toml": "new b", "c.html": "new c"}
FOREIGN = {"notes.txt": "mine"}


def write(out: Path, files: dict[str, str]) -> None:
    with atomic_directory(out) as folder:
        for name, text in files.items():
            (folder / name).write_text(text)


def visible(out: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in out.iterdir() if path.name[0] != "."}


def hidden(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir() if path.name[0] == "."} - {_files._MANIFEST}


def made(out: Path, kind: str) -> dict[str, str]:
    """Make `out` as an earlier run left it, alone or among files of others; return its files."""
    if kind == "new":
        return {}
    write(out, OLD)
    if kind == "alone":
        return OLD
    (out / "notes.txt").write_text("mine")
    return OLD | FOREIGN
