"""Wrong values: the fewest that explain what re-calibration does."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from spring_plants import VALUES, given, recordings

from jaxsr.diagnosis import diagnose
from jaxsr.diagnosis.likelihood.posterior import posterior
from jaxsr.diagnosis.thinning import prepare_search
from jaxsr.models import Simulator


def off_by(seed: int) -> float:
    """20 to 50 %, too small and too large in turn."""
    size = np.random.default_rng(seed).uniform(0.2, 0.5)
    return 1.0 + (size if seed % 2 else -size)


def asked(wrong: str, seed: int, driven: bool) -> dict[str, Any]:
    model = given(wrong, off_by(seed), driven)
    found = diagnose(Simulator(model), recordings(seed, driven), budget=1000.0)
    assert found.document["verdict"] == "parameter"
    assert {f["mechanism"] for f in found.document["findings"]} == {"wrong_value"}
    return found.document


def check(wrong: str, seed: int, driven: bool) -> None:
    document = asked(wrong, seed, driven)
    (finding,) = document["findings"]
    assert finding["site"] == f"parameter:{wrong}"
    assert finding["probability"] > 0.9
    told = finding["parameters"][wrong]["value"]
    assert told == pytest.approx(VALUES[wrong], rel=0.05)
    parameters = finding["edit"]
    assert parameters[f"parameters.{wrong}"]["value"] == pytest.approx(told, rel=1e-3)


@pytest.mark.long
def test_a_factor_of_all_forces_is_one_wrong_mass() -> None:
    """The file fixes the mass and frees all that it is divided into: these would all be scaled."""
    document = asked("m", 0, driven=False)
    (finding,) = document["findings"]
    assert finding["site"] == "parameter:m" and finding["share"] == pytest.approx(1.0, abs=1e-3)
    low, high = finding["parameters"]["m"]["ci95"]
    assert low < VALUES["m"] < high
    for name in ("k", "k3", "c"):  # as given: nothing asks for others
        assert document["calibration"][name]["value"] == VALUES[name]
        # what re-calibration did instead does the same in the sensors
        pair = ["wrong_value@parameter:m", f"wrong_value@parameter:{name}"]
        (row,) = [r for r in document["confusable"] if r[:2] == pair]
        assert row[2] == pytest.approx(0.0, abs=0.1)


@pytest.mark.long
def test_the_explained_model_has_the_value_that_is_told() -> None:
    model = given("m", 1.4, driven=False)
    found = diagnose(Simulator(model), recordings(1, driven=False), budget=1000.0)
    explained = found.model.parameters
    assert explained["m"].value == pytest.approx(VALUES["m"], rel=0.01)
    assert explained["k"] == model.parameters["k"]
    train = found.document["fit"]["train"]
    assert train["explained"][-1] < 1.02 * train["recalibrated"][-1]


@pytest.mark.long
@pytest.mark.parametrize("wrong", ["k", "k3", "c"])
def test_the_evidence_tells_a_wrong_value_at_its_mode(wrong: str) -> None:
    """One linear step from the given values ends many deviations away, or frees another value.

    Of twelve values one leaves four deviations by chance in 1 of 1,300 draws.
    """
    for seed in range(4):
        model = given(wrong, off_by(seed))
        prepared, _ = prepare_search(model, recordings(seed), seconds=np.inf)
        found = posterior(model, prepared)
        assert found is not None
        (told,) = found.wrong
        assert told.name == wrong and told.probability > 0.99
        assert abs(told.value - VALUES[wrong]) < 4.0 * told.deviation


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("driven", [True, False])
@pytest.mark.parametrize("wrong", sorted(VALUES))
def test_one_wrong_value_is_told_as_one(wrong: str, driven: bool, seed: int) -> None:
    check(wrong, seed, driven)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_two_wrong_values_are_told_as_two(seed: int) -> None:
    model = given("k", off_by(seed))
    both = model.parameters | {"c": given("c", off_by(seed + 1)).parameters["c"]}
    found = diagnose(Simulator(replace(model, parameters=both)), recordings(seed), budget=1000.0)
    sites = {f["site"] for f in found.document["findings"]}
    assert sites == {"parameter:k", "parameter:c"}
