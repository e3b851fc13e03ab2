"""What ``jaxsr diagnose --resume`` makes of the diagnosis that a folder holds.

A search has no place where a start could be handed in: what is complete is not done again, and
what was stopped begins anew.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxsr._files import sha256
from jaxsr._result import InputError, StoppedBy

_STOPPED = (StoppedBy.BUDGET, StoppedBy.INTERRUPTED)
_TABLES = ("fit", "provenance")
_REMEDY = "Name another --out, or leave out --resume"


@dataclass(frozen=True)
class Asked:
    """What a command asks of a diagnosis.

    Parameters
    ----------
    command : str
        As it was typed.
    model : str
        Path of a model file.
    data, held_out : sequence of str
        Paths.
    version : str
        Of jaxsr.
    """

    command: str
    model: str
    data: Sequence[str]
    held_out: Sequence[str]
    version: str


def earlier(folder: Path) -> dict[str, Any] | None:
    """Return the diagnosis that a folder holds; None without one.

    Raises
    ------
    InputError
        It cannot be read.
    """
    path = folder / "diagnosis.json"
    if not path.exists():
        return None
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError("cannot be read", str(path), _REMEDY) from error
    held = document if isinstance(document, dict) else {}
    if "verdict" not in held or not all(isinstance(held.get(k), dict) for k in _TABLES):
        raise InputError("is no diagnosis", str(path), _REMEDY)
    return held


def why_anew(document: Mapping[str, Any], asked: Asked, folder: Path) -> str | None:
    """Return why an earlier diagnosis is done again; None where it came to its end.

    Held-out files are looked at only then: until a diagnosis is final they stay closed.

    Raises
    ------
    InputError
        It is of other files, or of other options.
    """
    provenance = document["provenance"]
    if _options(str(provenance.get("command"))) != _options(asked.command):
        raise InputError("holds the diagnosis of another command", str(folder), _REMEDY)
    same = _are(provenance.get("model_sha256"), [asked.model])
    if not (same and _are(provenance.get("data_sha256"), asked.data)):
        raise InputError("holds the diagnosis of other files", str(folder), _REMEDY)
    if provenance.get("stopped_by") in _STOPPED:
        return f"was ended before its time ({provenance['stopped_by']})"
    if provenance.get("version") != asked.version:
        return f"is by version {provenance.get('version')}"
    unseen = document["fit"].get("held_out") or {}
    if not _are(unseen.get("sha256"), asked.held_out):
        raise InputError("holds the diagnosis of other held-out files", str(folder), _REMEDY)
    return None


def _are(digests: Mapping[str, str] | None, paths: Sequence[str]) -> bool:
    """Return whether checksums are those of files."""
    return set((digests or {}).values()) == {sha256(Path(path)) for path in paths}


def _options(command: str) -> list[str]:
    """Return the words of a command, but for those in which a next one may differ."""
    words, out = iter(shlex.split(command)), []
    for word in words:
        if word == "--budget":
            next(words, None)
        elif word != "--resume" and not word.startswith("--budget="):
            out.append(word)
    return out
