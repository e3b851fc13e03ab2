"""Hostile model files end in a model that is written and read back, or in one clear line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from fuzz_models import VALID, hostile, outcome, toml, wrong_types

SCRIPT = Path(__file__).with_name("fuzz_models.py")

COUNT = int(os.environ.get("JAXSR_FUZZ", "4000"))
"""Files of the long run; 20,000 take some minutes."""


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


def test_the_script_tells_what_is_wrong_and_what_it_cost() -> None:
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "0", "20"], capture_output=True, text=True, check=True
    )
    *wrong, totals = map(json.loads, done.stdout.splitlines())
    assert wrong == [] and 0.0 < totals["seconds"] < 10.0 and 0.0 < totals["megabytes"] < 500.0


@pytest.mark.slow
def test_many_hostile_files() -> None:
    run(range(1_000, 1_000 + COUNT))
