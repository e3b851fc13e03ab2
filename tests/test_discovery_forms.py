"""Any form of recording is answered by a whole document, or refused in one line."""

from __future__ import annotations

import json
import time
import tomllib
import warnings
from dataclasses import fields

import numpy as np
import pytest
from discovery_forms import FORMS, form, pendulum

import jaxsr
from jaxsr._progress import Budget
from jaxsr._result import InputError
from jaxsr.evolution import SearchConfig
from jaxsr.models.reading import read_model
from jaxsr.recordings import Recording

TINY = SearchConfig(population=20, refined=2, generations=2, restarts=0, patience=2)
FEW = ("whole", "10 % lost", "every 2nd q, every 10th v", "v equal to q", "all zero", "3 rows")


def answered(recordings, folder, **options):
    """Return the document of a discovery, or None where the recordings were refused."""
    options = {"states": ["q", "v"], "inputs": ["u"], "config": TINY} | options
    config = options.pop("config")
    parts = {
        kind: kind(**{f.name: options.pop(f.name) for f in fields(kind) if f.name in options})
        for kind in (jaxsr.Roles, jaxsr.Prior, jaxsr.Run)
    }
    assert not options
    roles, prior, run = parts.values()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            found = jaxsr.discover(recordings, roles, prior=prior, config=config, run=run)
        except InputError as error:
            assert "\n" not in str(error) and len(str(error)) < 600
            return None
        found.save(folder)
    text = (folder / "discovery.json").read_text()
    document = json.loads(text, parse_constant=_refused)
    assert [e["state"] for e in document["equations"]] == [e.state for e in found.equations]
    for equation in document["equations"]:
        assert "nan" not in equation["expression"] and "inf" not in equation["expression"]
        assert equation["train_mse"] is not None, equation["state"]
    assert document["verdict"] in ("law", "several", "undecided")
    assert bool(document["reason"]) == (document["verdict"] != "law")
    tomllib.loads((folder / "model.toml").read_text())
    read_model(folder / "model.toml")
    assert (folder / "report.html").stat().st_size > 1000
    return document


def _refused(constant):
    raise AssertionError(f"{constant} in the document")


@pytest.mark.long
@pytest.mark.parametrize("name", FEW)
def test_a_form_is_answered_or_refused(name, tmp_path):
    answered([form(name)], tmp_path / "out", budget=1.5)


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMS)
@pytest.mark.parametrize("order", [1, 2])
def test_every_form_is_answered_or_refused(name, order, tmp_path):
    states = ["q", "v"] if order == 1 else ["q"]
    for noise in (0.0, 0.003):
        answered(
            [form(name, noise=noise)],
            tmp_path / f"out{noise}",
            order=order,
            states=states,
            budget=4.0,
        )


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMS)
def test_a_form_beside_whole_recordings_and_held_out(name, tmp_path):
    whole = [pendulum(np.random.default_rng(k)) for k in range(2)]
    odd = form(name)
    answered([*whole, odd], tmp_path / "beside", budget=4.0)
    answered(whole, tmp_path / "judge", validation=[odd], held_out=[odd], budget=4.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMS)
def test_a_form_with_a_given_derivative(name, tmp_path):
    recording = form(name)
    rate = np.gradient(np.nan_to_num(recording.channels["v"]), recording.time)
    recording = Recording(name, recording.time, recording.channels | {"dv": rate})
    answered(
        [recording],
        tmp_path / "out",
        states=["v"],
        derivatives=["dv"],
        inputs=["q", "u"],
        budget=4.0,
    )


@pytest.mark.slow
def test_lost_samples_leave_the_law_as_it_is(tmp_path):
    config = SearchConfig(population=60, refined=4, generations=10, restarts=0, patience=3)
    for name in ("whole", "10 % lost"):
        document = answered([form(name, rows=600)], tmp_path / name, config=config, modes=1)
        law = {t["expression"]: t["coefficient"] for t in document["equations"][1]["terms"]}
        assert law["sin(q)"] == pytest.approx(-9.0, abs=0.2)
        assert law["u"] == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_the_budget_holds_whatever_the_number_of_states(monkeypatch):
    # processor time: beside other work the clock on the wall tells of that, too
    monkeypatch.setattr(time, "monotonic", time.thread_time)
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 10.0, 1500)
    waves = {f"x{k}": np.sin((1.0 + 0.3 * k) * t) + 0.01 * rng.normal(size=1500) for k in range(8)}
    began = time.thread_time()
    found = jaxsr.discover(
        [Recording("a", t, waves)],
        jaxsr.Roles(list(waves)),
        run=jaxsr.Run(budget=Budget(8.0, began)),
    )
    assert time.thread_time() - began < 1.1 * 8.0
    assert len(found.equations) == 8
    assert found.provenance["stopped_by"] == "budget"
