"""Calculations of fields: interpreted at first, then replayed, or run by the register machine."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from typing import Any

from jaxsr.expressions.instructions import Instructions
from jaxsr.expressions.tape import Recording, Tape, UntraceableError

Environment = Mapping[str, Any]
TAPED_FROM = 8
"""Calls of a calculation that are interpreted before it is worth recording."""


class Calculations:
    """What fields share that differ by the values of their constants alone.

    Parameters
    ----------
    key : tuple
        Of what the fields have in common.
    """

    def __init__(self, key: tuple) -> None:
        self.key = key
        self._calls: dict[Hashable, int] = {}
        self._recordings: dict[Hashable, Recording | None] = {}
        self._tapes: dict[Hashable, Tape | None] = {}
        self._kept: dict[Hashable, Any] = {}

    def calculated(
        self, what: Hashable, calculation: Callable[[Environment], Any], env: Environment
    ) -> Any:
        """Return what a calculation comes to; `what` is its name here."""
        count = self._calls[what] = self._calls.get(what, 0) + 1
        if count <= TAPED_FROM:
            return calculation(env)
        if what not in self._tapes:
            recording = self._recorded(what, calculation, list(env))
            self._tapes[what] = None if recording is None else Tape(recording)
        tape = self._tapes[what]
        return calculation(env) if tape is None else tape(env)

    def instructed(
        self,
        what: Hashable,
        calculation: Callable[[Environment], Any],
        names: Sequence[str],
        by_sample: Collection[str],
    ) -> Instructions | None:
        """Return a calculation as instructions; None where it cannot be recorded, or made any."""
        recording = self._recorded(what, calculation, names)
        return None if recording is None else Instructions.of(recording, by_sample)

    def kept(self, key: Hashable, made: Callable[[], Any]) -> Any:
        """Return what was made under a key before, or make it."""
        if key not in self._kept:
            self._kept[key] = made()
        return self._kept[key]

    def _recorded(
        self, what: Hashable, calculation: Callable[[Environment], Any], names: Sequence[str]
    ) -> Recording | None:
        if what not in self._recordings:
            try:
                self._recordings[what] = Recording.of(calculation, names)
            except UntraceableError:
                self._recordings[what] = None
        return self._recordings[what]
