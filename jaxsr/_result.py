"""Outcomes and errors that every layer shares."""

from __future__ import annotations

import enum


class InputError(ValueError):
    """Report wrong use or unreadable input in one line: what, where, remedy.

    Parameters
    ----------
    what : str
        What is wrong, with the offending value.
    where : str, optional
        File and key, e.g. ``model.toml [equations] v``.
    remedy : str, optional
        What to do about it.

    Notes
    -----
    The commands turn this error into exit status 2 and print the message.
    """

    def __init__(self, what: str, where: str = "", remedy: str = "") -> None:
        self.what, self.where, self.remedy = what, where, remedy
        parts = [f"{where}: " if where else "", what, f". {remedy}" if remedy else ""]
        super().__init__(" ".join("".join(parts).split()))


class StoppedBy(enum.StrEnum):
    """Why a search or a diagnosis ended (``provenance.stopped_by``)."""

    CONVERGED = "converged"
    BUDGET = "budget"
    INTERRUPTED = "interrupted"
    TARGET = "target"


class Verdict(enum.StrEnum):
    """The verdicts of a diagnosis (docs/files.md)."""

    NOTHING = "nothing"
    PARAMETER = "parameter"
    STRUCTURE = "structure"
    MEASUREMENT = "measurement"
    EXTERNAL_INPUT = "external_input"
    UNDECIDED = "undecided"
