"""Hostile model files end in a model that is written and read back, or in one clear line."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from fuzz_models import VALID, hostile, toml, wrong_types
from hostile_values import LONG

from jaxsr._result import InputError
from jaxsr.models import model_text, parse_model

SECONDS = 2.0
COUNT = int(os.environ.get("JAXSR_FUZZ", "4000"))
"""Files of the long run; 20,000 take some minutes."""


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Fail what takes more processor time, and end what would never end."""

    def end(*_: Any) -> None:
        raise TimeoutError(f"no end after {5 * seconds} s")

    old = signal.signal(signal.SIGVTALRM, end)
    signal.setitimer(signal.ITIMER_VIRTUAL, 5 * seconds)
    began = time.process_time()
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, old)
    assert time.process_time() - began < seconds


def outcome(text: str) -> str:
    """Read a file and demand what every file must give; return the error's message."""
    with at_most(SECONDS):
        try:
            model = parse_model(text, "m.toml")
        except InputError as error:
            message = str(error)
            assert message.startswith("m.toml") and message.isprintable(), message
            assert len(message) < 500 and LONG[:81] not in message, message
            assert error.what
            return message
    assert parse_model(model_text(model), "m.toml") == model
    return ""


def run(seeds: range) -> int:
    """Read hostile files; return how many were read as models."""
    read = 0
    for seed in seeds:
        try:
            read += not outcome(hostile(seed))
        except BaseException as error:
            error.add_note(f"hostile file of seed {seed}")
            raise
    return read


def test_the_files_that_are_mutated_are_models() -> None:
    assert [outcome(toml(document)) for document in VALID] == [""] * len(VALID)


def test_hostile_files() -> None:
    assert 10 < run(range(400)) < 250


def test_every_wrong_type_at_every_key() -> None:
    refused = 0
    for path, text in wrong_types():
        try:
            refused += bool(outcome(text))
        except BaseException as error:
            error.add_note(f"at {path}")
            raise
    assert refused > 500


@pytest.mark.slow
def test_many_hostile_files() -> None:
    run(range(1_000, 1_000 + COUNT))
