"""Tanks of which the upper one is not measured: one recording, overflows at hard edges."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnosis_systems import TANKS

from jaxsr import diagnose
from jaxsr.diagnosis.judging.plausible import plausible
from jaxsr.diagnosis.mechanisms.elastic import elastic
from jaxsr.diagnosis.mechanisms.memory import overflows
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import neutral_values
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.reduced import STIFF_STEPS, lean
from jaxsr.models import Simulator, parse_model
from jaxsr.models.least_squares import Fit
from jaxsr.models.rollout import Stepping
from jaxsr.recordings import Recording

STEP, EDGE, PART = 4.0, 6.0, 0.6


def recording(seed: int) -> Recording:
    """The upper tank is full at `EDGE`, and `PART` of what runs over falls into the lower one."""
    rng = np.random.default_rng(seed)
    drive = np.repeat(rng.uniform(0.5, 4.5, 70), 10)
    fine, upper, lower, level = 200, 4.0, 4.0, np.empty(drive.size)
    for k, u in enumerate(drive):
        level[k] = lower
        for _ in range(fine):
            flow = 0.055 * np.sqrt(upper)
            rise = upper + (0.065 * u - 0.06 * np.sqrt(upper)) * STEP / fine
            over, upper = max(rise - EDGE, 0.0), min(rise, EDGE)
            lower += (flow - 0.07 * np.sqrt(max(lower, 0.0))) * STEP / fine + PART * over
    time = STEP * np.arange(drive.size)
    return Recording("run.csv", time, {"u": drive, "y": level + 0.01 * rng.normal(size=level.size)})


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_an_upper_tank_that_no_sensor_sees_overflows_in_part_into_the_lower(seed: int) -> None:
    """One recording, estimated as a whole: starts of the hidden level would absorb what spills."""
    found = diagnose(Simulator(parse_model(TANKS)), [recording(seed)], seed=0)
    row = found.findings[0]
    assert (row["mechanism"], row["site"]) == ("overflow", "equation:h1")
    values = row["parameters"]
    # The scale of the level that is not seen is held by k1; the edge is not quite hard.
    assert values["xo"]["value"] == pytest.approx(EDGE, rel=0.05)
    assert values["part"]["value"] == pytest.approx(PART, rel=0.05)
    train = found.fit["train"]
    assert train["explained"][-1] < 0.1 * train["recalibrated"][-1]


def entry_at(super_model: SuperModel, members: tuple[int, ...], **values: float) -> Entry:
    """An entry whose members have these constants."""
    theta = neutral_values(super_model)
    order = list(super_model.model.parameters)
    for number in members:
        for name, full in super_model.names[number].items():
            theta[order.index(full)] = values[name]
    none = np.zeros((0, 1, 2, 1))
    fit = Fit(theta, np.zeros((2, 1)), 1.0, np.ones((1, 2, 1)), np.zeros(0, int), none, none, True)
    return Entry(members, fit, np.ones(12))


def levels() -> SuperModel:
    """Every overflow of the upper tank."""
    model = parse_model(TANKS)
    site = sites_of(model, {s: np.linspace(1.0, 9.0, 21) for s in model.states})[0]
    return SuperModel.build(model, list(overflows(site, STEP)))


def test_an_estimate_may_end_at_a_hard_edge_and_at_no_other_bound() -> None:
    super_model = levels()
    stepping = SimpleNamespace(widths=())
    arena: Any = SimpleNamespace(
        super_model=super_model, problem=SimpleNamespace(stepping=stepping)
    )
    highest = super_model.candidates[0].parameters[0].high
    inside = entry_at(super_model, (0,), ko=0.5 * highest, xo=7.0)
    assert plausible(arena, inside)
    assert plausible(arena, entry_at(super_model, (0,), ko=highest, xo=7.0))
    assert not plausible(arena, entry_at(super_model, (0,), ko=0.0, xo=7.0))
    far = super_model.candidates[0].parameters[1].high
    assert not plausible(arena, entry_at(super_model, (0,), ko=0.5 * highest, xo=far))
    assert not plausible(arena, inside.lost())


def test_an_edge_is_as_hard_whatever_the_cross_section() -> None:
    """Equations of volumes, A h' = ..., and of levels, h' = ..., tell the same."""
    model = parse_model(TANKS)
    rows = "\n".join(f'{s} = {{ {s} = "250.0" }}' for s in model.states)
    volumes = parse_model(TANKS.replace("[parameters]", f"[inertia]\n{rows}\n[parameters]"))
    hardest = []
    for one in (model, volumes):
        site = sites_of(one, {s: np.linspace(1.0, 9.0, 21) for s in one.states})[0]
        hardest.append(next(overflows(site, STEP)).parameters[0].high)
    assert hardest[1] == pytest.approx(250.0 * hardest[0])


def test_sets_that_may_be_steep_leave_the_explicit_method() -> None:
    super_model = levels()
    simulator = Simulator(super_model.model)
    for substeps in (1, 4):
        stepping = Stepping("rk4", substeps)
        steep = lean(super_model, simulator, stepping, (0,)).stepping
        assert (steep.method, steep.substeps) == ("rodas3", max(substeps, STIFF_STEPS))
        assert lean(super_model, simulator, stepping, ()).stepping == stepping


@pytest.mark.long
def test_a_second_flow_below_a_place_is_found_where_a_sensor_shows_the_level() -> None:
    """A second inlet opens below a level of 3; no overflow, whose flow is above its edge, is it."""
    found = diagnose(Simulator(parse_model(TANK)), [drained(s) for s in (1, 2)], seed=0)
    (row,) = found.findings
    assert (row["mechanism"], row["site"]) == ("piecewise_stiffness", "equation:h")
    assert row["parameters"]["qs"]["value"] == pytest.approx(3.0, rel=0.02)
    assert row["parameters"]["ks"]["value"] == pytest.approx(0.03, rel=0.05)


def test_a_hidden_level_is_offered_none() -> None:
    model = parse_model(TANKS)
    scale = {s: np.linspace(1.0, 9.0, 21) for s in model.states}
    seen: Any = SimpleNamespace(signals={})
    shown, hidden = (sites_of(model, scale, m)[0] for m in (seen, None))
    assert {c.mechanism for c in elastic(shown)} == {"piecewise_stiffness"}
    assert list(elastic(hidden)) == []


TANK = """
[model]
states = ["h"]
inputs = ["u"]
outputs = ["y"]
input_hold = "zero"
[equations]
h = "kin*u - kout*sqrt(Max(h, 0))"
[readings]
y = "h"
[parameters]
kin = { value = 0.06, bounds = [0.01, 0.3] }
kout = { value = 0.06, bounds = [0.01, 0.3] }
"""


def drained(seed: int) -> Recording:
    """A tank with an inlet that opens below a level of 3 in proportion to how far below."""
    rng = np.random.default_rng(seed)
    drive = np.repeat(rng.uniform(0.5, 3.2, 40), 10)
    fine, h, level = 40, 3.0, np.empty(drive.size)
    for k, u in enumerate(drive):
        level[k] = h
        for _ in range(fine):
            rate = 0.06 * u - 0.06 * np.sqrt(max(h, 0.0)) - 0.03 * min(h - 3.0, 0.0)
            h += rate * STEP / fine
    time = STEP * np.arange(drive.size)
    y = level + 0.002 * rng.normal(size=level.size)
    return Recording(f"{seed}.csv", time, {"u": drive, "y": y})
