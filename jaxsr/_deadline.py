"""A time limit on steps that are too long to be waited for."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Protocol


class OutOfTime(Exception):
    """A step was left in the middle, for its time is over: who began it takes what it had."""


class Limited(Protocol):
    """What may be stopped in the middle of a step."""

    @property
    def expired(self) -> Callable[[], bool]:
        """Whether the time is over."""
        ...

    @expired.setter
    def expired(self, value: Callable[[], bool]) -> None: ...


def never() -> bool:
    """Return False: no limit."""
    return False


def ensure(expired: Callable[[], bool]) -> None:
    """Raise ``OutOfTime`` once ``expired()``."""
    if expired():
        raise OutOfTime


@contextlib.contextmanager
def bounded(problem: Limited, expired: Callable[[], bool]) -> Iterator[None]:
    """Let every step of a problem inside the block raise ``OutOfTime`` once ``expired()``."""
    before, problem.expired = problem.expired, expired
    try:
        yield
    finally:
        problem.expired = before
