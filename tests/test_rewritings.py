"""EMPS, Silverbox and a robot's joint: the same findings however their models are written.

The slow test runs the ways in ``JAXSR_REWRITINGS`` (``0,1,2``; all ten by default) in processes of
their own, with a budget of 60 s of processor time.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import diagnosis_schema
import numpy as np
import pytest
from form_running import crash
from rewritings import DATASETS, WAYS, rewriting

from jaxsr.datasets import fetch
from jaxsr.models import Simulator, parse_model

ROOT = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get("JAXSR_SHARED", ROOT.parent / "shared"))
RECORDINGS = SHARED / "recordings"
CHOSEN = [int(n) for n in os.environ.get("JAXSR_REWRITINGS", "").split(",") if n]
BUDGET, PATIENCE = 60, 3600
ENVIRONMENT = {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg", "JAXSR_CLOCK": "processor"}
ROLES = {
    "emps": (["emps_train.csv"], ["emps_pulses.csv"]),
    "silverbox": ([f"silverbox_multisine_{k:02d}.csv" for k in (1, 2, 3)], ["silverbox_arrow.csv"]),
    "ur10e": (["ur10e_ident.csv"], ["ur10e_unloaded.csv"]),
}
VELOCITY = {"emps": "v", "silverbox": "v", "ur10e": "v1"}
SAME = {"gravity": "constant_force", "end_stop": "piecewise_stiffness"}
"""Mechanisms that the data of these recordings cannot tell apart."""

needs_recordings = pytest.mark.skipif(
    not RECORDINGS.is_dir(), reason="the real recordings (../shared/recordings) are absent"
)
Found = frozenset[tuple[str, str]]


@pytest.mark.parametrize("dataset", DATASETS)
def test_ten_ways_are_one_model(dataset: str) -> None:
    """With the parameters' true values every way gives the accelerations of the first."""
    from rewritings import EMPS, SILVERBOX, UR10E

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


@pytest.fixture(scope="module")
def fetched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    out = tmp_path_factory.mktemp("datasets")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JAXSR_DATA_DIR", str(RECORDINGS))
        for name in DATASETS:
            fetch(name, out / name)
    yield out


def _diagnosed(model: Path, data: list[Path], held: list[Path], velocity: str, seed: int) -> Found:
    """Run the command and return mechanisms and sites, the given file's own parameters aside."""
    out = model.parent / f"out_{model.stem}"
    arguments = ["diagnose", str(model), *map(str, data), "--held-out", *map(str, held)]
    arguments += ["--out", str(out), "--budget", str(BUDGET), "--seed", str(seed)]
    done = subprocess.run(
        [sys.executable, "-m", "jaxsr", *arguments],
        cwd=model.parent,
        env={**os.environ, **ENVIRONMENT},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert "Traceback" not in done.stderr, crash(done.stderr.rpartition("jaxsr: this is")[0])
    assert done.returncode == 0 and "Warning" not in done.stderr, done.stderr
    document = diagnosis_schema.strict_json((out / "diagnosis.json").read_text())
    found = set()
    for row in document["findings"]:
        if row["family"] != "parameter":
            site = row["site"].replace(f":{velocity}", ":velocity")
            kind = site.partition(":")[0]
            place = site if kind == "equation" else kind
            found.add((SAME.get(row["mechanism"], row["mechanism"]), place))
    return frozenset(found)


@needs_recordings
@pytest.mark.slow
@pytest.mark.parametrize("dataset", DATASETS)
def test_the_findings_do_not_depend_on_the_writing(
    dataset: str, fetched: Path, tmp_path: Path
) -> None:
    folder = fetched / dataset
    data, held = ([folder / name for name in names] for names in ROLES[dataset])
    bundled = _diagnosed(folder / f"{dataset}.toml", data, held, VELOCITY[dataset], 0)
    numbers = CHOSEN or list(range(WAYS))
    answers = {}
    for number in numbers:
        way = rewriting(dataset, number)
        own = way.write(tmp_path / f"{number}", [*data, *held])
        model = tmp_path / f"{number}" / "model.toml"
        split = own[: len(data)], own[len(data) :]
        try:
            answers[number] = _diagnosed(model, *split, way.velocity, way.seed)
        except AssertionError as error:
            answers[number] = str(error).splitlines()[0][:300]
        except subprocess.TimeoutExpired:
            answers[number] = "no end"
    lines = [f"{n}: {sorted(a) if isinstance(a, frozenset) else a}" for n, a in answers.items()]
    told = f"bundled: {sorted(bundled)}\n" + "\n".join(lines)
    crashed = [n for n, answer in answers.items() if isinstance(answer, str)]
    assert not crashed, told
    same = sum(answer == bundled for answer in answers.values())
    assert same >= 0.9 * len(numbers) - 1e-9, told
