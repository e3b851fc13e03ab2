"""Modes by ``discover``: found, written, simulated, and not invented."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxsr
from jaxsr import Simulator
from jaxsr._progress import Budget, Silent
from jaxsr.discovery.laws import laws
from jaxsr.evolution import SearchConfig
from jaxsr.expressions import parse, to_numpy
from jaxsr.models.simulation import simulate_to_csv


class Ground:
    """The event of a fall to height zero, at which an integration ends."""

    terminal = True
    direction = -1

    def __call__(self, _: float, state: np.ndarray) -> float:
        return state[0]


QUICK = SearchConfig(population=60, generations=6, restarts=0, patience=3)
STEP = 0.01


def hop(start: tuple[float, float], seconds: float = 2.0) -> jaxsr.Recording:
    """A mass that falls on a damped spring of length 1."""

    def rate(t: float, s: np.ndarray) -> list[float]:
        push = -200.0 * (s[0] - 1.0) - 2.0 * s[1] if s[0] <= 1.0 else 0.0
        return [s[1], push - 9.81]

    t = np.arange(0.0, seconds + 1e-9, STEP)
    y, v = solve_ivp(rate, (0.0, seconds), start, t_eval=t, max_step=1e-3, rtol=1e-9, atol=1e-11).y
    dv = np.array([rate(0.0, s)[1] for s in zip(y, v, strict=True)])
    return jaxsr.Recording(f"drop {start[0]}", t, {"y": y, "v": v, "dy": v, "dv": dv})


@pytest.fixture(scope="module")
def found() -> jaxsr.Discovery:
    data = [hop((1.3, 0.0)), hop((1.2, -1.0))]
    return jaxsr.discover(data, states=["y", "v"], derivatives=["dy", "dv"], config=QUICK)


@pytest.mark.long
def test_two_modes_are_found_with_their_laws_and_their_guard(found) -> None:
    stance, flight = sorted(found.modes, key=str)
    assert str(flight).startswith("y > ")
    assert flight["y"].expression == "v" and flight["v"].complexity == 1
    laws = {"flight": "-9.81", "stance": "-9.81 - 200*(y - 1.0) - 2*v"}
    values = {"y": np.array([0.8, 0.95]), "v": np.array([-1.0, 0.5])}
    for mode, name in ((flight, "flight"), (stance, "stance")):
        right = to_numpy(parse(laws[name]))(values)
        assert to_numpy(mode["v"].term)(values) == pytest.approx(right, rel=1e-6)
    guard = found.hybrid.regions[0][0][0]
    assert guard.variable == parse("y", ("y",))
    assert guard.threshold == pytest.approx(1.0, abs=0.02)


@pytest.mark.long
def test_the_files_say_modes_and_switching_and_the_model_runs(found, tmp_path: Path) -> None:
    found.save(tmp_path / "out")
    document = json.loads((tmp_path / "out" / "discovery.json").read_text())
    assert [m["guard"].split()[0] for m in document["modes"]] == ["y", "y"]
    assert [e["state"] for e in document["modes"][0]["equations"]] == ["y", "v"]
    assert document["equations"][1]["expression"].startswith("Piecewise(")
    (single,) = document["one_law"]
    assert single["state"] == "v" and "Piecewise" not in single["expression"]
    page = (tmp_path / "out" / "report.html").read_text()
    assert f"the best single law, of {single['complexity']} term" in page
    rows = document["switching"]["drop 1.3"]
    assert rows[0][0] == 0.0 and len(rows) > 3
    assert document["modes"][rows[0][2]]["guard"].startswith("y > ")
    inner = [b - a for part in document["switching"].values() for a, b, m in part[1:-1] if m == 0]
    shortest, median, longest = document["modes"][0]["dwell_s"]
    assert shortest == pytest.approx(min(inner)) and longest == pytest.approx(max(inner))
    assert median == pytest.approx(np.median(inner))
    assert (tmp_path / "out" / "mode_plane.png").exists()
    unseen = hop((1.25, 0.3), 1.0)
    table = simulate_to_csv(Simulator.from_file(tmp_path / "out" / "model.toml"), unseen)
    error = table["y"].to_numpy() - unseen.channels["y"]
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.std(unseen.channels["y"])


def test_clusters_are_told_by_their_submodel_and_events(found) -> None:
    table = found.hybrid.table
    assert 0 < len(table.mixed()) < len(table.clusters)
    pure = [row for row in table.rows if row.mode is not None]
    assert max(row.error for row in pure) < 1e-6
    split = next(row.split for row in table.rows if row.split is not None)
    assert split is not None and split[0] in ("y", "v", "t")


@pytest.mark.long
def test_one_mode_may_be_asked_for() -> None:
    data = [hop((1.3, 0.0), 1.0)]
    options = {"states": ["y", "v"], "derivatives": ["dy", "dv"], "config": QUICK}
    one = jaxsr.discover(data, modes=1, budget=2.0, **options)
    assert one.modes == () and one.hybrid is None
    assert one.to_dict()["modes"] == [] and one.to_dict()["switching"] == {}


@pytest.mark.long
def test_a_smooth_law_is_not_split() -> None:
    t = np.linspace(0.0, 6.0, 300)
    x = 1.5 * np.cos(1.3 * t) + 0.4 * np.sin(3.1 * t)
    data = [jaxsr.Recording("a", t, {"x": x, "dx": 2.0 / (1.0 + x**2) - np.tanh(x)})]
    law = jaxsr.discover(data, states=["x"], derivatives=["dx"], autonomous=True, config=QUICK)
    assert law.modes == ()


@pytest.mark.long
def test_impacts_become_events_of_the_model() -> None:
    t = np.linspace(0.0, 1.2, 300)
    fall, gone = np.sqrt(2.0 / 9.81), 0.8 * np.sqrt(2.0 * 9.81)
    s = t - fall
    x = np.where(s < 0.0, 1.0 - 4.905 * t**2, gone * s - 4.905 * s**2)
    v = np.where(s < 0.0, -9.81 * t, gone - 9.81 * s)
    data = []
    for number, height in enumerate((1.0, 1.4, 0.8)):  # the same motion on other scales of time
        r = np.sqrt(height)
        channels = {"x": height * x, "v": r * v, "dx": r * v, "dv": np.full_like(t, -9.81)}
        data.append(jaxsr.Recording(f"{number}", r * t, channels))
    law = jaxsr.discover(data, states=["x", "v"], derivatives=["dx", "dv"], autonomous=True)
    (event,) = law.model.events
    assert event.when == "x" and event.direction == -1
    factor = to_numpy(parse(event.reset["v"], ("v",)))({"v": np.array(1.0)})
    assert float(factor) == pytest.approx(-0.8, abs=1e-4)
    assert law.to_dict()["resets"][0]["when"] == "x"


@pytest.mark.slow
def test_modes_and_impacts_together_name_the_recordings_that_were_given() -> None:
    """A ball in a layer of oil: cut at its bounces, its modes are told by recording."""
    t = np.arange(0.0, 1.8, 0.004)

    def rates(_: float, y: np.ndarray) -> list[float]:
        return [y[1], -9.81 - (3.0 if y[0] > 0.5 else 0.2) * y[1]]

    data = []
    for name, height in (("one.csv", 1.0), ("two.csv", 1.4)):
        motion, start, now = [], [height, 0.0], 0.0
        event = Ground()
        while now < t[-1]:
            ask = t[t >= now]
            run = solve_ivp(
                rates, (now, t[-1]), start, t_eval=ask, events=event, max_step=1e-3, rtol=1e-9
            )
            motion += run.y.T.tolist() if run.t.size else []
            if run.status != 1:
                break
            now, start = run.t_events[0][0], [0.0, -0.8 * run.y_events[0][0][1]]
        x, v = np.array(motion).T
        dv = -9.81 - np.where(x > 0.5, 3.0, 0.2) * v
        data.append(jaxsr.Recording(name, t, {"x": x, "v": v, "dx": v, "dv": dv}))
    law = jaxsr.discover(data, states=["x", "v"], derivatives=["dx", "dv"], budget=120.0)
    document = law.to_dict()
    assert len(document["modes"]) == 2 and len(law.model.events) == 1
    assert sorted(document["switching"]) == ["one.csv", "two.csv"]
    for rows in document["switching"].values():
        assert rows[0][0] == 0.0 and rows[-1][1] == pytest.approx(t[-1])
        assert all(a[1] == b[0] and a[2] != b[2] for a, b in itertools.pairwise(rows))


class AtModes(Silent):
    """Interrupt a budget as the search for modes begins, the first or the second time."""

    def __init__(self, budget: Budget, turn: int) -> None:
        self._budget, self._left = budget, turn

    def stage(self, text: str) -> None:
        self._left -= text == "modes"
        if self._left == 0:
            self._budget.interrupt()


def test_an_interrupt_in_the_first_look_for_modes_keeps_what_was_found(tmp_path: Path) -> None:
    budget = Budget()
    law = jaxsr.discover(
        [hop((1.3, 0.0))],
        states=["y", "v"],
        derivatives=["dy", "dv"],
        config=QUICK,
        budget=budget,
        progress=AtModes(budget, 1),
    )
    assert law.provenance["stopped_by"] == "interrupted"
    assert [e.state for e in law.equations] == ["y", "v"]
    law.save(tmp_path / "out")
    document = json.loads((tmp_path / "out" / "discovery.json").read_text())
    assert document["provenance"]["stopped_by"] == "interrupted"
    unseen = hop((1.25, 0.3), 0.2)
    table = simulate_to_csv(Simulator.from_file(tmp_path / "out" / "model.toml"), unseen)
    assert np.isfinite(table["y"].to_numpy()).all()


def test_a_search_for_modes_cut_short_alone_is_told() -> None:
    """The equations are there, and an interrupt ends what looks for modes beside them."""
    budget = Budget()
    finder = SimpleNamespace(
        look=lambda _: SimpleNamespace(sure=False, laws={}),
        find=lambda *_: budget.interrupt(),
    )
    *found, ended = laws({}, cast(Any, None), cast(Any, finder), 0, budget, Silent())
    assert found == [[], None, None] and ended == "interrupted"


def test_an_interrupt_after_the_equations_is_told_and_keeps_them() -> None:
    budget, t = Budget(), np.linspace(0.0, 6.0, 300)
    x = 1.5 * np.cos(1.3 * t) + 0.4 * np.sin(3.1 * t)
    rate = 2.0 / (1.0 + x**2) - np.tanh(x) + 0.2 * np.floor(2.0 * x)
    law = jaxsr.discover(
        [jaxsr.Recording("a", t, {"x": x, "dx": rate})],
        states=["x"],
        derivatives=["dx"],
        autonomous=True,
        config=QUICK,
        budget=budget,
        progress=AtModes(budget, 2),
    )
    assert law.provenance["stopped_by"] == "interrupted"
    assert law.modes == () and [e.state for e in law.equations] == ["x"]
