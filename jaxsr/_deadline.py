"""A time limit on steps that are too long to be waited for."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from contextvars import ContextVar
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


_limit: ContextVar[Callable[[], bool]] = ContextVar("limit", default=never)


@contextlib.contextmanager
def limited(expired: Callable[[], bool]) -> Iterator[None]:
    """Let everything inside the block that asks (`ask`) be left once ``expired()``.

    Limits around the block hold inside it too.
    """
    around = _limit.get()
    token = _limit.set(lambda: expired() or around())
    try:
        yield
    finally:
        _limit.reset(token)


@contextlib.contextmanager
def unlimited() -> Iterator[None]:
    """Let nothing inside the block be left: what cannot be done without, whatever limits hold."""
    token = _limit.set(never)
    try:
        yield
    finally:
        _limit.reset(token)


def ask() -> None:
    """Raise ``OutOfTime`` once the time of a block around is over (`limited`).

    For what is dear and knows no budget, such as one linearisation of a large model.
    """
    ensure(_limit.get())


@contextlib.contextmanager
def bounded(problem: Limited, expired: Callable[[], bool]) -> Iterator[None]:
    """Let every step of a problem inside the block raise ``OutOfTime`` once ``expired()``."""
    before, problem.expired = problem.expired, expired
    try:
        yield
    finally:
        problem.expired = before
