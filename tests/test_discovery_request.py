"""What a discovery is asked: in groups, and by the keywords of earlier versions."""

from __future__ import annotations

import inspect
import warnings

import numpy as np
import pytest

import jaxsr
from jaxsr import Prior, Roles, Run
from jaxsr.discovery.request import asked

T = np.linspace(0.0, 4.0, 200)
FALL = jaxsr.Recording("fall", T, {"x": np.exp(-T), "dx": -np.exp(-T)})
SHORT = jaxsr.SearchConfig(population=20, generations=2)


def test_groups_and_keywords_ask_for_the_same() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = jaxsr.discover(
            [FALL],
            Roles(["x"], derivatives=["dx"], autonomous=True),
            prior=Prior(modes=1),
            config=SHORT,
            run=Run(seed=3),
        )
    with pytest.warns(DeprecationWarning, match="write discover") as caught:
        before = jaxsr.discover(
            [FALL],
            states=["x"],
            derivatives=["dx"],
            autonomous=True,
            modes=1,
            config=SHORT,
            seed=3,
        )
    assert str(found) == str(before)
    assert found.provenance["seed"] == before.provenance["seed"] == 3
    text = str(caught[0].message)
    assert text.startswith("derivatives, autonomous, modes of discover()")
    assert "Roles(states=..., derivatives=..., autonomous=...)" in text
    assert "prior=Prior(modes=...), run=Run(seed=...)" in text
    assert caught[0].filename == __file__


def test_states_and_seed_may_stand_alone() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        roles, prior, run = asked(None, None, None, {"states": ["x"], "seed": 3})
        assert roles == Roles(["x"]) and prior == Prior() and run == Run(seed=3)
        assert asked(None, None, Run(seed=3), {"states": ["x"]})[2] == run
    with pytest.warns(DeprecationWarning, match=r"^order of discover\(\) will not stand alone"):
        asked(None, None, None, {"states": ["x"], "order": 2})


def test_every_keyword_of_earlier_versions_has_a_place() -> None:
    earlier = {
        *("states", "derivatives", "order", "inputs", "time", "autonomous", "columns"),
        *("treatment", "units", "known", "guesses", "validation", "held_out", "signs"),
        *("bind_units", "modes", "checkpoint", "every", "seed", "budget", "progress", "command"),
    }
    places = [inspect.signature(kind).parameters for kind in (Roles, Prior, Run)]
    assert sorted(name for place in places for name in place) == sorted(earlier)
    assert len(inspect.signature(jaxsr.discover).parameters) <= 10


def test_a_keyword_beside_its_group_or_unknown_is_refused() -> None:
    with pytest.raises(TypeError, match=r"'order' beside a Roles; write it in Roles\(...\)"):
        asked(Roles(["x"]), None, None, {"order": 2})
    with pytest.raises(TypeError, match="unexpected keyword argument 'stats'"):
        asked(None, None, None, {"stats": ["x"]})
    with pytest.raises(jaxsr.InputError, match="states are missing"):
        jaxsr.discover([FALL])
