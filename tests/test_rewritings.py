"""EMPS, Silverbox and a robot's joint: the same findings however their models are written.

The slow test runs the ways in ``JAXSR_REWRITINGS`` (``0,1,2``; all ten by default) in processes of
their own, with a budget of 60 s of processor time.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from benchmarks.model_writings import DATASETS, EMPS, SILVERBOX, UR10E, WAYS, rewriting
from benchmarks.rewritings import (
    BUDGET,
    BUNDLED,
    SAME,
    Answer,
    diagnosed,
    places,
    summary,
    task_of,
)
from jaxsr.datasets import fetch
from jaxsr.models import Simulator, parse_model

CHOSEN = [n for n in os.environ.get("JAXSR_REWRITINGS", "").split(",") if n]


@pytest.mark.parametrize("dataset", DATASETS)
def test_ten_ways_are_one_model(dataset: str) -> None:
    """With the parameters' true values every way gives the accelerations of the first."""
    ways = {"emps": EMPS, "silverbox": SILVERBOX, "ur10e": UR10E}[dataset]
    rng = np.random.default_rng(0)
    q, v, *u = rng.normal(size=7)
    rates = []
    for number, way in enumerate(ways):
        simulator = Simulator(parse_model(rewriting(dataset, number).text))
        model = simulator.model
        sign = -1.0 if way.reading[0].startswith("-") else 1.0
        values = simulator.values({**way.values})
        x = tuple(sign * (v if name == way.velocity else q) for name in model.states)
        rate = simulator.rates(0.3, x, tuple(u[: len(model.inputs)]), values)
        rates.append(sign * float(rate[model.states.index(way.velocity)]))
    np.testing.assert_allclose(rates, rates[0], rtol=2e-3)


def test_seeds_and_start_values_differ() -> None:
    for dataset in DATASETS:
        drawn = [rewriting(dataset, number) for number in range(WAYS)]
        assert {r.seed for r in drawn} == {0, 1, 2}
        assert len({r.text for r in drawn}) == WAYS


def _row(
    mechanism: str, site: str, family: str = "inertial", p: float = 0.9, **also: object
) -> dict:
    row = {"family": family, "mechanism": mechanism, "site": site, "probability": p}
    return {"alternatives": [], **row, **also}


def test_findings_are_named_alike_in_every_writing() -> None:
    rows = [
        _row("wrong_value", "parameter:M", "parameter"),
        _row("gravity", "equation:xd"),
        _row("clock_skew", "output:y", "measurement"),
    ]
    found = places(rows, "xd")
    assert found == ("clock_skew@output", "constant_force@equation:velocity")


def test_equals_are_named_together_whichever_is_told() -> None:
    force, bias = _row("constant_force", "equation:v"), _row("sensor_bias", "output:r")
    both = ("constant_force@equation:velocity or sensor_bias@output",)
    for told, other in ((force, bias), (bias, force)):
        for p, expected in ((0.5, both), (0.4, places([told], "v"))):
            rival = {**other, "probability": p}
            row = {**told, "probability": 1.0 - p, "alternatives": [rival]}
            assert places([row], "v") == expected


def test_only_sound_runs_with_the_same_findings_count() -> None:
    def row(findings: list[str], trouble: str = "", status: int = 0) -> dict:
        answer = Answer(status, "structure", tuple(findings), trouble, 1.0)
        return {**vars(answer), "findings": findings}

    runs = {
        BUNDLED: row(["a@x", "b@y"]),
        "0": row(["b@y", "a@x"]),
        "1": row(["a@x"]),
        "2": row(["a@x", "b@y"], "RuntimeWarning: overflow"),
        "3": row(["a@x", "b@y"], status=-9),
    }
    expected = {"ways": 4, "sound": 2, "same_findings": 1, "alike": 1, "same_verdict": 2}
    assert summary(runs) == expected


@pytest.mark.slow
@pytest.mark.parametrize("dataset", DATASETS)
def test_the_findings_do_not_depend_on_the_writing(
    dataset: str, recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JAXSR_DATA_DIR", str(recordings))
    fetch(dataset, tmp_path)
    numbers = CHOSEN or [str(number) for number in range(WAYS)]
    runs = {}
    for way in (BUNDLED, *numbers):
        answer = diagnosed(task_of(dataset, way, tmp_path), BUDGET)
        runs[way] = {**vars(answer), "findings": list(answer.findings)}
    rates = summary(runs)
    told = "\n".join(f"{way}: {row}" for way, row in runs.items())
    assert rates["sound"] == len(numbers), told
    assert rates["same_findings"] >= SAME * len(numbers) - 1e-9, told
