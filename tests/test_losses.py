"""Losses of temperatures and levels, and none where none is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from store_plants import BODY, CIRCUIT, LEAK, LOSSES, TANKS, WHOLE

from jaxsr.diagnosis import diagnose
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.dissipative import dissipative
from jaxsr.diagnosis.mechanisms.losses import losses, surroundings
from jaxsr.diagnosis.mechanisms.site import Site, sites_of
from jaxsr.models import Model, Simulator, apply_edit, parse_model

WARM = {"Th": np.linspace(40.0, 90.0, 21), "Tb": np.linspace(30.0, 60.0, 21)}


def site(model: Model, state: str, low: float = 1.0, high: float = 9.0) -> Site:
    scale = {s: WARM.get(s, np.linspace(low, high, 21)) for s in model.states}
    return next(s for s in sites_of(model, scale) if s.state == state)


def offered(of: Site) -> list[Candidate]:
    return list(losses(of))


def test_surroundings_are_told_by_shifting_everything_that_is_compared() -> None:
    assert surroundings(site(BODY, "Tb")) == ("Ta",)
    assert surroundings(site(BODY, "Th")) == ()  # it exchanges with a state alone
    assert surroundings(site(TANKS, "h1")) == ()
    written = replace(BODY, equations={**BODY.equations, "Tb": "h/Cb*Th - (h + k)/Cb*Tb + k*Ta/Cb"})
    assert surroundings(site(written, "Tb")) == ("Ta",)
    fixed = parse_model(
        """
[model]
states = ["T"]
inputs = ["P"]
outputs = ["y"]
[equations]
T = "(P - k*(T - T0)**1.2)/C"
[readings]
y = "T"
[parameters]
k = 1.0
C = 100.0
T0 = 20.0
"""
    )
    assert surroundings(site(fixed, "T", 30.0, 60.0)) == ("T0",)


def test_losses_are_those_of_stores() -> None:
    found = {c.label for c in offered(site(BODY, "Tb"))}
    names = "linear_stiffness", "quadratic_drag", "power_law_drag"
    assert found == {f"{name}@equation:Tb" for name in names}
    assert [c.label for c in offered(site(TANKS, "h2"))]
    electrical = replace(CIRCUIT, units={"i": "A", "uc": "V", "u": "V"})
    assert not offered(site(electrical, "i")) and not offered(site(electrical, "uc"))
    assert not offered(site(CIRCUIT, "i", -2.0, 2.0))  # what changes its sign is no store
    motor = replace(BODY, units={"Th": "m/s", "Tb": "rad/s"})
    assert not offered(site(motor, "Th")) and not offered(site(motor, "Tb"))


def test_radiation_counts_from_absolute_zero() -> None:
    (warm,) = [c for c in offered(site(BODY, "Tb")) if "radiates" in c.sentence]
    edit = warm.edit(BODY, warm.names(BODY.symbols), {"kd": 2e-8, "p": 4.0})
    assert "(Tb + 273.15)**p - (Ta + 273.15)**p" in edit.changes["equations.Tb"]
    assert apply_edit(BODY, edit).parameters["p"].bounds is None
    scale = {s: np.linspace(290.0, 350.0, 21) for s in BODY.states}
    hot = next(s for s in sites_of(BODY, scale) if s.state == "Tb")
    (kelvin,) = [c for c in offered(hot) if "radiates" in c.sentence]
    assert kelvin.terms == (("Tb", "- {kd}*(Tb**{p} - Ta**{p})"),)
    levels = replace(BODY, units={"Th": "m", "Tb": "m", "Ta": "m"})
    assert not [c for c in offered(site(levels, "Tb")) if "radiates" in c.sentence]


def _named(name: str, seed: int) -> None:
    plant = LOSSES[name]
    found = diagnose(Simulator(plant.model), plant.recordings(seed), budget=1000.0)
    assert found.document["verdict"] == "structure"
    (finding,) = found.document["findings"]
    assert finding["site"] == "equation:Tb"
    assert finding["mechanism"] in ("quadratic_drag", "power_law_drag")


@pytest.mark.parametrize("seed", range(3))
def test_a_leak_in_proportion_is_no_power_of_the_level(seed: int) -> None:
    found = diagnose(Simulator(LEAK.model), LEAK.recordings(seed), budget=1000.0).document
    (finding,) = found["findings"]
    assert (finding["mechanism"], finding["site"]) == ("linear_stiffness", "equation:h1")
    low, high = finding["parameters"]["k1"]["ci95"]
    assert low < 0.2 < high and high - low < 0.05


def _nothing(name: str, seed: int) -> None:
    plant = WHOLE[name]
    found = diagnose(Simulator(plant.model), plant.recordings(seed), budget=1000.0)
    # The free values are off by 10 to 20 %.
    assert found.document["verdict"] in ("nothing", "parameter")
    assert all(f["mechanism"] == "wrong_value" for f in found.document["findings"])


@pytest.mark.long
@pytest.mark.parametrize("name", ["square", "radiation"])
def test_losses_of_a_temperature_are_named(name: str) -> None:
    _named(name, 0)


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(WHOLE))
def test_nothing_is_lost_where_nothing_is_missing(name: str) -> None:
    _nothing(name, 0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 10))
@pytest.mark.parametrize("name", sorted(LOSSES))
def test_losses_of_a_temperature_are_named_over_seeds(name: str, seed: int) -> None:
    _named(name, seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 10))
@pytest.mark.parametrize("name", sorted(WHOLE))
def test_nothing_is_lost_where_nothing_is_missing_over_seeds(name: str, seed: int) -> None:
    _nothing(name, seed)


def test_surroundings_may_be_a_number() -> None:
    number = replace(BODY, equations={**BODY.equations, "Tb": "(h*(Th - Tb) - k*(Tb - 21.5))/Cb"})
    of = site(number, "Tb")
    assert surroundings(of) == ("21.5",)
    told = {term for c in offered(of) for _, term in c.terms if c.mechanism == "quadratic_drag"}
    assert "- {kd}*(Tb - 21.5)*Abs(Tb - 21.5)" in told


def test_a_store_alone_is_offered_no_law_twice() -> None:
    text = """
[model]
states = ["T"]
inputs = ["P"]
outputs = ["y"]
[equations]
T = "(P - k*(T - 20))/C"
[readings]
y = "T"
[parameters]
k = 1.0
C = 100.0
"""
    of = site(parse_model(text), "T", 30.0, 60.0)
    terms = [c.terms for c in (*dissipative(of), *losses(of)) if len(c.parameters) == 1]
    assert len(set(terms)) == len(terms)


def test_what_exchanges_with_a_store_alone_leaks_to_the_surroundings_of_that() -> None:
    told = {t for c in offered(site(BODY, "Th")) for _, t in c.terms if c.mechanism[-4:] == "drag"}
    assert {"- {kd}*Th*Abs(Th)", "- {kd}*(Th - Ta)*Abs(Th - Ta)"} <= told
    apart = replace(BODY, units={"Th": "K", "Tb": "m"})
    assert not any("Ta" in t for c in offered(site(apart, "Th")) for _, t in c.terms)
